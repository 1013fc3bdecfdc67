"""A look into an ONNX file before a runtime opens it, and a model trimmed to the outputs that are needed.

Files are read as the messages of our onnx.proto, which name every place that can refer to operators, inner
graphs or other files, so that no runtime's own parser has to be trusted with a stranger's file.
"""

from collections.abc import Iterator
from typing import NamedTuple

from google.protobuf.message import DecodeError, Message
from lambent_core.errors import BundleError
from lambent_proto.v1 import onnx_pb2

_EXTERNAL = 1  # data_location of a tensor whose values lie in another file


class ExternalTensor(NamedTuple):
    """A tensor whose values lie in another file."""

    name: str
    location: str
    offset: int
    length: int


def _read(data: bytes) -> onnx_pb2.OnnxModel:
    try:
        return onnx_pb2.OnnxModel.FromString(data)
    except DecodeError as error:
        raise ValueError("no ONNX model") from error


def metadata(data: bytes) -> dict[str, str]:
    """Return the metadata properties of an ONNX model; raises ValueError when it is not one."""
    return {entry.key: entry.value for entry in _read(data).metadata_props}


def keep_outputs(data: bytes, names: set[str]) -> bytes:
    """Return the ONNX model with only the graph outputs `names` and the nodes that serve them.

    onnxruntime computes every node, asked for or not. Graphs with inner graphs keep all their nodes.
    """
    model = _read(data)
    graph = model.graph
    outputs = [output for output in graph.output if output.name in names]
    del graph.output[:]
    graph.output.extend(outputs)
    if not any(part.HasField("g") or part.graphs for node in graph.node for part in node.attribute):
        needed, serving = set(names), []
        # Nodes are in an order in which none comes before what it needs.
        for node in reversed(graph.node):
            if not needed.isdisjoint(node.output):
                needed.update(node.input)
                serving.append(node)
        del graph.node[:]
        graph.node.extend(reversed(serving))
    return model.SerializeToString()


def check_onnx(data: bytes, *, path: str, weights_bytes: int) -> list[ExternalTensor]:
    """Return the tensors a graph takes from models/weights.bin, of `weights_bytes` bytes.

    Raises BundleError for bytes that are not a model, a graph with training information, operators outside
    the ONNX standard, or data in any other file or beyond the end of that one.
    """
    try:
        model = _read(data)
        parts = list(_parts(model))
        tensors = [_external(part) for part in parts if isinstance(part, onnx_pb2.OnnxTensor)]
    except ValueError as error:
        raise BundleError(
            "bundle.graph_damaged", f'"{path}" is not a readable ONNX model', "fetch the bundle again"
        ) from error
    named = (onnx_pb2.OnnxNode, onnx_pb2.OnnxOperatorSet)
    domains = {part.domain for part in parts if isinstance(part, named)}
    if model.training_info or domains - {"", "ai.onnx"}:
        raise BundleError(
            "bundle.graph_operators",
            f'"{path}" uses operators beyond the ONNX standard: {sorted(domains)}',
            "use a bundle written by lambent",
        )
    external = [tensor for tensor in tensors if tensor is not None]
    for tensor in external:
        inside = min(tensor.offset, tensor.length) >= 0 and tensor.offset + tensor.length <= weights_bytes
        if tensor.location != "weights.bin" or not inside:
            raise BundleError(
                "bundle.external_data",
                f'"{path}" takes "{tensor.name}" from {tensor.location[:200]!r}, '
                f"bytes {tensor.offset} to {tensor.offset + tensor.length}",
                "only data inside models/weights.bin is allowed; do not use this bundle",
            )
    return external


def _parts(message: Message) -> Iterator[Message]:
    """Yield a message and every message inside it; protobuf reads at most 100 levels."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for inner in [value] if isinstance(value, Message) else value:
                yield from _parts(inner)


def _external(tensor: onnx_pb2.OnnxTensor) -> ExternalTensor | None:
    if not tensor.external_data and tensor.data_location != _EXTERNAL:
        return None
    stated = {entry.key: entry.value for entry in tensor.external_data}
    offset, length = int(stated.get("offset", 0)), int(stated.get("length", -1))
    return ExternalTensor(tensor.name, stated.get("location", ""), offset, length)

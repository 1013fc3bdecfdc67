"""Checks an ONNX file before a runtime opens it: its operators and external data.

Reads the wire format directly, so that neither the onnx package nor a runtime's parser has to be
trusted with an untrusted file. Only the fields named in `_CHILDREN` are followed.
"""

from dataclasses import dataclass, field

from lambent_relight.bundle.onnx_wire import Field, fields
from lambent_relight.errors import BundleError

_MAX_DEPTH = 64
# Message type -> {field number: message type of the child}.
_CHILDREN: dict[str, dict[int, str]] = {
    "model": {7: "graph", 8: "opset", 20: "training", 25: "function"},
    "function": {7: "node", 9: "opset", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "entry"},
    "opset": {},
    "training": {},
    "entry": {},
}


@dataclass
class ExternalTensor:
    """A tensor whose values are in another file."""

    name: str
    location: str = ""
    offset: int = 0
    length: int = -1


@dataclass
class OnnxSummary:
    """The operators and external data that a graph refers to."""

    domains: set[str] = field(default_factory=set)
    """Operator domains of nodes and imports; "" and "ai.onnx" are the standard."""
    external: list[ExternalTensor] = field(default_factory=list)
    has_training: bool = False


def _walk(data: memoryview, kind: str, summary: OnnxSummary, depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise ValueError("nested too deeply")
    children = _CHILDREN[kind]
    tensor = ExternalTensor(name="") if kind == "tensor" else None
    is_external = False
    for part in fields(data):
        number = part.number
        if kind == "training":
            summary.has_training = True
        if (kind, number) in (("node", 7), ("opset", 1)):
            summary.domains.add(part.text())
        if tensor is not None:
            if number == 8:
                tensor.name = part.text()
            elif number == 13:
                is_external = True
                _read_entry(part, tensor)
            elif number == 14:
                is_external = is_external or part.value == 1
        child = children.get(number)
        if child is not None and child != "entry":
            _walk(part.message(), child, summary, depth + 1)
    if tensor is not None and is_external:
        summary.external.append(tensor)


def _read_entry(entry: Field, tensor: ExternalTensor) -> None:
    texts = {part.number: part.text() for part in fields(entry.message()) if part.number in (1, 2)}
    key, value = texts.get(1, ""), texts.get(2, "")
    if key == "location":
        tensor.location = value
    elif key == "offset":
        tensor.offset = int(value)
    elif key == "length":
        tensor.length = int(value)


def summarise_onnx(data: bytes, *, path: str) -> OnnxSummary:
    """Return operators and external data of an ONNX model; raises BundleError if `data` is not one."""
    summary = OnnxSummary()
    try:
        _walk(memoryview(data), "model", summary, 0)
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise BundleError(
            "bundle.graph_damaged", f'"{path}" is not a readable ONNX model', "fetch the bundle again"
        ) from error
    return summary


def check_onnx(data: bytes, *, path: str, weights_bytes: int) -> list[ExternalTensor]:
    """Return the tensors a graph takes from models/weights.bin, of `weights_bytes` bytes.

    Raises BundleError for a graph with training information, operators outside the ONNX standard, or data
    in any other file or beyond the end of that one.
    """
    summary = summarise_onnx(data, path=path)
    if summary.has_training or summary.domains - {"", "ai.onnx"}:
        raise BundleError(
            "bundle.graph_operators",
            f'"{path}" uses operators beyond the ONNX standard: {sorted(summary.domains)}',
            "use a bundle written by lambent",
        )
    for tensor in summary.external:
        inside = min(tensor.offset, tensor.length) >= 0 and tensor.offset + tensor.length <= weights_bytes
        if tensor.location != "weights.bin" or not inside:
            raise BundleError(
                "bundle.external_data",
                f'"{path}" takes "{tensor.name}" from {tensor.location[:200]!r}, '
                f"bytes {tensor.offset} to {tensor.offset + tensor.length}",
                "only data inside models/weights.bin is allowed; do not use this bundle",
            )
    return summary.external

"""The part of the protobuf wire format that is needed to inspect and trim an ONNX file.

A message is a list of fields: a key (number and wire type), then a value. Raises ValueError or
IndexError for bytes that are no message. Source: protobuf encoding specification; the field numbers of
onnx.proto (ONNX 1.19), which are frozen by its compatibility rules.
"""

from collections.abc import Iterator
from dataclasses import dataclass

MODEL_GRAPH, MODEL_METADATA = 7, 14
GRAPH_NODE, GRAPH_OUTPUT, VALUE_NAME = 1, 12, 1
NODE_INPUT, NODE_OUTPUT, NODE_ATTRIBUTE, ATTRIBUTE_GRAPHS = 1, 2, 5, (6, 11)


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message."""

    number: int
    value: int | memoryview
    """The number itself, or the bytes of text, a message or a fixed-size value."""
    raw: memoryview
    """Key and value as they stand in the message."""

    def message(self) -> memoryview:
        """Return the bytes of a message field."""
        if isinstance(self.value, int):
            raise ValueError("a number where a message belongs")
        return self.value

    def text(self) -> str:
        """Return a text field."""
        return bytes(self.message()).decode("utf-8")


def fields(data: memoryview) -> Iterator[Field]:
    """Yield the fields of a message in order."""
    position = 0
    while position < len(data):
        start = position
        key, position = _varint(data, position)
        number, wire = key >> 3, key & 7
        if wire == 0:
            value, position = _varint(data, position)
            yield Field(number, value, data[start:position])
            continue
        if wire == 2:
            size, position = _varint(data, position)
        elif wire in (1, 5):
            size = 8 if wire == 1 else 4
        else:
            raise ValueError(f"wire type {wire}")
        end = position + size
        if end > len(data):
            raise ValueError("a field runs over the end")
        yield Field(number, data[position:end], data[start:end])
        position = end


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
        if shift > 63:
            raise ValueError("a number is too long")


def _encode_varint(value: int) -> bytes:
    encoded = bytearray()
    while value >= 0x80:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def keep_outputs(data: bytes, names: set[str]) -> bytes:
    """Return the ONNX model with only the graph outputs `names` and the nodes that serve them.

    onnxruntime computes every node, needed or not. Graphs with inner graphs keep all their nodes.
    """
    model = bytearray()
    for field in fields(memoryview(data)):
        if field.number != MODEL_GRAPH:
            model += field.raw
            continue
        graph = b"".join(_serving(list(fields(field.message())), names))
        model += _encode_varint(MODEL_GRAPH << 3 | 2) + _encode_varint(len(graph)) + graph
    return bytes(model)


def _serving(parts: list[Field], names: set[str]) -> list[memoryview]:
    """Return the fields of a graph without other outputs than `names` and without nodes only those need."""
    kept = [p for p in parts if p.number != GRAPH_OUTPUT or _value_name(p) in names]
    if any(_has_inner_graph(p) for p in parts if p.number == GRAPH_NODE):
        return [p.raw for p in kept]
    needed, serving = set(names), []
    # Nodes stand in an order in which none comes before what it needs.
    for part in reversed(kept):
        if part.number == GRAPH_NODE:
            node = list(fields(part.message()))
            if needed.isdisjoint(f.text() for f in node if f.number == NODE_OUTPUT):
                continue
            needed.update(f.text() for f in node if f.number == NODE_INPUT)
        serving.append(part.raw)
    return serving[::-1]


def _has_inner_graph(node: Field) -> bool:
    attributes = [field for field in fields(node.message()) if field.number == NODE_ATTRIBUTE]
    return any(part.number in ATTRIBUTE_GRAPHS for field in attributes for part in fields(field.message()))


def _value_name(output: Field) -> str:
    return next((field.text() for field in fields(output.message()) if field.number == VALUE_NAME), "")


def metadata(data: bytes) -> dict[str, str]:
    """Return the metadata properties of an ONNX model."""
    entries: dict[str, str] = {}
    for field in fields(memoryview(data)):
        if field.number == MODEL_METADATA:
            texts = {part.number: part.text() for part in fields(field.message()) if part.number in (1, 2)}
            entries[texts.get(1, "")] = texts.get(2, "")
    return entries

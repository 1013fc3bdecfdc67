"""Building ONNX graphs node by node, with their large tensors in one file beside them.

The graphs keep to operators that every runtime has, the browser's graphics interface included: nothing is
computed in 64-bit integers, there is no remainder, bit or sign operation, no loop and no shape arithmetic.
64-bit integers appear only where ONNX wants axes and shapes, as constants. Opset 18, format version 9.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

OPSET, IR_VERSION = 18, 9
ALIGNMENT_BYTES = 256
WEIGHTS_NAME = "weights.bin"


@dataclass(frozen=True, kw_only=True, slots=True)
class StoredTensor:
    """Where a tensor lies in the weight file; little endian, row-major."""

    name: str
    values: NDArray[np.float32] | NDArray[np.float16]
    offset_bytes: int


@dataclass(slots=True)
class WeightFile:
    """The tensors of all graphs, each once, at multiples of 256 bytes."""

    half_tables: bool = False
    """Tables of feature grids are float16; graphs look rows up in them and compute in float32."""
    tensors: dict[str, StoredTensor] = field(default_factory=dict)
    size_bytes: int = 0

    def add(self, name: str, values: NDArray[np.float32], dtype: str = "<f4") -> StoredTensor:
        """Return the place of a tensor, kept as `dtype`; the same name must always bring the same values."""
        values = np.ascontiguousarray(values, dtype=dtype)
        if name in self.tensors:
            assert np.array_equal(self.tensors[name].values, values), f"two tensors are called {name}"
            return self.tensors[name]
        offset = self.size_bytes + -self.size_bytes % ALIGNMENT_BYTES
        self.tensors[name] = StoredTensor(name=name, values=values, offset_bytes=offset)
        self.size_bytes = offset + values.nbytes
        return self.tensors[name]

    def to_bytes(self) -> bytes:
        """Return the contents of the file."""
        data = bytearray(self.size_bytes)
        for tensor in self.tensors.values():
            data[tensor.offset_bytes : tensor.offset_bytes + tensor.values.nbytes] = tensor.values.tobytes()
        return bytes(data)


class Value:
    """A tensor of a graph under construction; arithmetic adds nodes."""

    __slots__ = ("graph", "name")
    __array_ufunc__ = None
    """Makes numpy leave `array - value` to this class."""

    def __init__(self, graph: "GraphBuilder", name: str) -> None:
        self.graph, self.name = graph, name

    def __add__(self, other: "Operand") -> "Value":
        return self.graph.node("Add", self, other)

    def __sub__(self, other: "Operand") -> "Value":
        return self.graph.node("Sub", self, other)

    def __rsub__(self, other: "Operand") -> "Value":
        return self.graph.node("Sub", self.graph.value(other), self)

    def __mul__(self, other: "Operand") -> "Value":
        return self.graph.node("Mul", self, other)

    def __truediv__(self, other: "Operand") -> "Value":
        return self.graph.node("Div", self, other)

    def __rtruediv__(self, other: "Operand") -> "Value":
        return self.graph.node("Div", self.graph.value(other), self)

    def __neg__(self) -> "Value":
        return self.graph.node("Neg", self)


Operand = Value | float | NDArray[Any]


class GraphBuilder:
    """A graph whose first axis is free and called `row_axis` ("ray" or "point")."""

    def __init__(self, name: str, row_axis: str, weights: WeightFile) -> None:
        self.name, self.row_axis, self.weights = name, row_axis, weights
        self._inputs: list[onnx.ValueInfoProto] = []
        self._nodes: list[onnx.NodeProto] = []
        self._initializers: dict[str, onnx.TensorProto] = {}
        self._constants: dict[tuple[str, tuple[int, ...], bytes], Value] = {}
        self._part = ""

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Begin the names of the nodes that are added meanwhile with `name/`; parts may lie in parts."""
        outer = self._part
        self._part = f"{outer}{name}/"
        try:
            yield
        finally:
            self._part = outer

    def input(self, name: str, size: int) -> Value:
        """Add a float32 input [row, size]."""
        self._inputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [self.row_axis, size]))
        return Value(self, name)

    def fixed_input(self, name: str, shape: Sequence[int]) -> Value:
        """Add a float32 input that all rows share."""
        self._inputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, list(shape)))
        return Value(self, name)

    def node(self, operator: str, *inputs: Operand, **attributes: Any) -> Value:
        """Add a node with one output and return that; numbers and arrays become constants."""
        output = f"{self._part}{operator.lower()}_{len(self._nodes)}"
        names = [self.value(item).name for item in inputs]
        self._nodes.append(helper.make_node(operator, names, [output], name=output, **attributes))
        return Value(self, output)

    def value(self, operand: Operand) -> Value:
        """Return an operand as a tensor of the graph; Python numbers become float32."""
        if isinstance(operand, Value):
            return operand
        array = np.asarray(operand, dtype=None if isinstance(operand, np.ndarray) else np.float32)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            name = _constant_name(array, len(self._constants))
            self._initializers[name] = numpy_helper.from_array(array, name)
            self._constants[key] = Value(self, name)
        return self._constants[key]

    def weight(self, name: str, values: NDArray[np.float32]) -> Value:
        """Return a float32 tensor that lies in the weight file."""
        return self._stored(name, values, TensorProto.FLOAT)

    def rows_of_table(self, name: str, values: NDArray[np.float32], rows: Value) -> Value:
        """Return rows of a table in the weight file as float32, [..., n] for row numbers [...]."""
        if not self.weights.half_tables:
            return self.node("Gather", self.weight(name, values), rows)
        table = self._stored(name, values, TensorProto.FLOAT16)
        return self.node("Cast", self.node("Gather", table, rows), to=TensorProto.FLOAT)

    def _stored(self, name: str, values: NDArray[np.float32], kind: int) -> Value:
        if name not in self._initializers:
            stored = self.weights.add(name, values, "<f2" if kind == TensorProto.FLOAT16 else "<f4")
            tensor = TensorProto(name=name, data_type=kind, dims=values.shape)
            tensor.data_location = TensorProto.EXTERNAL
            place = {
                "location": WEIGHTS_NAME,
                "offset": stored.offset_bytes,
                "length": stored.values.nbytes,
            }
            for key, value in place.items():
                tensor.external_data.add(key=key, value=str(value))
            self._initializers[name] = tensor
        return Value(self, name)

    def column(self, value: Value, index: int) -> Value:
        """Return one column of [row, n] as [row, 1]."""
        return self.node("Gather", value, np.array([index], np.int32), axis=1)

    def concat(self, values: Sequence[Value]) -> Value:
        """Return the values side by side, along the last axis."""
        return self.node("Concat", *values, axis=-1)

    def reduce(self, operator: str, value: Value, axis: int = -1, *, keep: bool = True) -> Value:
        """Return "ReduceSum", "ReduceMax" or "ReduceMin" along one axis."""
        return self.node(operator, value, np.array([axis], np.int64), keepdims=int(keep))

    def reshape(self, value: Value, *shape: int) -> Value:
        """Return the value in another shape; one size may be -1."""
        return self.node("Reshape", value, np.array(shape, np.int64))

    def unsqueeze(self, value: Value, axis: int) -> Value:
        """Return the value with a new axis of size 1."""
        return self.node("Unsqueeze", value, np.array([axis], np.int64))

    def minimum(self, a: Value, b: Operand) -> Value:
        """Return the smaller of two values; written out because "Min" is missing in some runtimes."""
        b = self.value(b)
        return self.node("Where", self.node("Less", a, b), a, b)

    def maximum(self, a: Value, b: Operand) -> Value:
        """Return the larger of two values."""
        b = self.value(b)
        return self.node("Where", self.node("Less", a, b), b, a)

    def at_least(self, value: Value, floor: float) -> Value:
        """Return the value, or `floor` where it is smaller."""
        return self.node("Clip", value, floor)

    def finish(
        self, outputs: Mapping[str, tuple[Value, int]], metadata: Mapping[str, str]
    ) -> onnx.ModelProto:
        """Return the model, checked, with outputs [row, size] by name."""
        infos = []
        for name, (value, size) in outputs.items():
            self._nodes.append(helper.make_node("Identity", [value.name], [name], name=f"output/{name}"))
            infos.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [self.row_axis, size]))
        graph = helper.make_graph(
            self._nodes, self.name, self._inputs, infos, list(self._initializers.values())
        )
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
            producer_name="lambent",
        )
        helper.set_model_props(model, dict(metadata))
        return model


def _constant_name(array: NDArray[Any], number: int) -> str:
    """Return a name that says what a constant is: a number with its value, axes or a shape, or an array."""
    if array.dtype.kind == "f" and array.size == 1:
        return f"number_{array.item():.6g}_{number}"
    return f"{'axes' if array.dtype == np.int64 else 'array'}_{number}"

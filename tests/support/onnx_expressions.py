"""Arithmetic that builds ONNX nodes as it is written, and the same functions for numpy arrays.

A scene that is written once against `NumpyOps` / `OnnxOps` exists both as a reference and as a graph.
"""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper

OPSET, IR_VERSION = 18, 9


class NumpyOps:
    """The functions a scene is written with, on arrays."""

    sqrt, abs, sign, minimum, maximum, where = np.sqrt, np.abs, np.sign, np.minimum, np.maximum, np.where

    @staticmethod
    def constant(values):
        return np.asarray(values, np.float64)

    @staticmethod
    def sum(a):
        return a.sum(axis=-1, keepdims=True)

    @staticmethod
    def largest(a):
        return a.max(axis=-1, keepdims=True)

    @staticmethod
    def smallest(a):
        return a.min(axis=-1, keepdims=True)

    @staticmethod
    def both(a, b):
        return a & b


class Value:
    """The result of a node."""

    def __init__(self, ops: OnnxOps, name: str) -> None:
        self.ops, self.name = ops, name

    def __add__(self, other):
        return self.ops.node("Add", self, other)

    def __sub__(self, other):
        return self.ops.node("Sub", self, other)

    def __rsub__(self, other):
        return self.ops.node("Sub", other, self)

    def __mul__(self, other):
        return self.ops.node("Mul", self, other)

    def __truediv__(self, other):
        return self.ops.node("Div", self, other)

    def __rtruediv__(self, other):
        return self.ops.node("Div", other, self)

    def __gt__(self, other):
        return self.ops.node("Greater", self, other)

    def __lt__(self, other):
        return self.ops.node("Less", self, other)

    def __ge__(self, other):
        return self.ops.node("GreaterOrEqual", self, other)

    def __neg__(self):
        return self.ops.node("Neg", self)

    __radd__, __rmul__ = __add__, __mul__


class OnnxOps:
    """The same functions, each of which adds a node to a graph."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: dict[str, np.ndarray] = {}

    def constant(self, values) -> Value:
        name = f"c{len(self.constants)}"
        self.constants[name] = np.asarray(values, np.float32)
        return Value(self, name)

    def node(self, kind: str, *inputs, **attributes) -> Value:
        names = [(i if isinstance(i, Value) else self.constant(i)).name for i in inputs]
        output = f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, names, [output], **attributes))
        return Value(self, output)

    def _over_axis(self, kind: str, a: Value) -> Value:
        axes = f"axes{len(self.nodes)}"
        self.constants[axes] = np.array([1], np.int64)
        return self.node(kind, a, Value(self, axes), keepdims=1)

    def sum(self, a):
        return self._over_axis("ReduceSum", a)

    def largest(self, a):
        return self._over_axis("ReduceMax", a)

    def smallest(self, a):
        return self._over_axis("ReduceMin", a)

    def sqrt(self, a):
        return self.node("Sqrt", a)

    def abs(self, a):
        return self.node("Abs", a)

    def sign(self, a):
        return self.node("Sign", a)

    def minimum(self, a, b):
        return self.node("Min", a, b)

    def maximum(self, a, b):
        return self.node("Max", a, b)

    def where(self, condition, a, b):
        return self.node("Where", condition, a, b)

    def both(self, a, b):
        return self.node("And", a, b)

    def model(self, axis: str, inputs: list[str], outputs: dict[str, tuple[Value, int]]) -> onnx.ModelProto:
        """Return a model with inputs [axis, 3]; outputs are name -> (value, width)."""
        names = []
        for name, (value, _) in outputs.items():
            self.nodes.append(helper.make_node("Identity", [value.name], [name]))
            names.append(name)

        def info(name: str, width: int):
            return helper.make_tensor_value_info(name, TensorProto.FLOAT, [axis, width])

        graph = helper.make_graph(
            self.nodes,
            "analytic",
            [info(name, 3) for name in inputs],
            [info(name, outputs[name][1]) for name in names],
            [onnx.numpy_helper.from_array(values, name) for name, values in self.constants.items()],
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)

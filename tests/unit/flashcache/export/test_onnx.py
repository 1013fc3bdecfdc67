"""The graph builder and the weight file."""

import numpy as np
import onnxruntime
import pytest
from flashcache.export.onnx import GraphBuilder, Value, WeightFile


def evaluate(graph: GraphBuilder, result: Value, size: int, folder, **inputs: np.ndarray) -> np.ndarray:
    """Return what onnxruntime makes of a graph with one output."""
    model = graph.finish({"result": (result, size)}, {})
    (folder / "weights.bin").write_bytes(graph.weights.to_bytes())
    (folder / "graph.onnx").write_bytes(model.SerializeToString())
    session = onnxruntime.InferenceSession(folder / "graph.onnx", providers=["CPUExecutionProvider"])
    return session.run(["result"], inputs)[0]


def test_arithmetic_is_that_of_numpy_whichever_side_the_array_is_on(tmp_path):
    graph = GraphBuilder("arithmetic", "row", WeightFile())
    x = graph.input("x", 2)
    row = np.array([[3.0, -1.0]], np.float32)
    values = np.array([[1.0, 2.0], [-4.0, 0.5]], np.float32)
    result = (row - x) * 2.0 + (1.0 / x) / row - (-x)
    found = evaluate(graph, result, 2, tmp_path, x=values)
    assert np.allclose(found, (row - values) * 2.0 + (1.0 / values) / row + values)


def test_smaller_and_larger_are_taken_per_element(tmp_path):
    graph = GraphBuilder("extremes", "row", WeightFile())
    x = graph.input("x", 2)
    result = graph.minimum(x, np.array([[1.0, 2.0]], np.float32)) + graph.maximum(x, 0.5)
    values = np.array([[0.0, 5.0], [7.0, -1.0]], np.float32)
    expected = np.minimum(values, [[1.0, 2.0]]) + np.maximum(values, 0.5)
    assert np.allclose(evaluate(graph, result, 2, tmp_path, x=values), expected)


def test_equal_constants_are_stored_once():
    graph = GraphBuilder("constants", "row", WeightFile())
    assert graph.value(2.0).name == graph.value(np.array(2.0, np.float32)).name
    assert graph.value(2.0).name != graph.value(np.array([2.0], np.float32)).name
    assert graph.value(np.array([1], np.int32)).name != graph.value(np.array([1], np.int64)).name


def test_nodes_are_named_after_their_parts_and_constants_after_what_they_are():
    graph = GraphBuilder("names", "row", WeightFile())
    x = graph.input("x", 2)
    with graph.part("outer"):
        first = x * 0.5
        with graph.part("inner.layers.0"):
            second = graph.reduce("ReduceSum", first + np.array([1.0, 2.0], np.float32))
    model = graph.finish({"result": (second + 1.0, 1)}, {})
    names = [node.name for node in model.graph.node]
    assert names == [
        *("outer/mul_0", "outer/inner.layers.0/add_1", "outer/inner.layers.0/reducesum_2"),
        *("add_3", "output/result"),
    ]
    constants = [tensor.name for tensor in model.graph.initializer]
    assert constants == ["number_0.5_0", "array_1", "axes_2", "number_1_3"]


def test_weights_come_from_the_file_beside_the_graph(tmp_path):
    weights = WeightFile()
    weights.add("other", np.zeros(3, np.float32))
    graph = GraphBuilder("weights", "row", weights)
    x = graph.input("x", 2)
    matrix = np.arange(6, dtype=np.float32).reshape(2, 3)
    result = graph.node("MatMul", x, graph.weight("matrix", matrix))
    values = np.array([[1.0, 2.0]], np.float32)
    assert np.allclose(evaluate(graph, result, 3, tmp_path, x=values), values @ matrix)
    assert weights.tensors["matrix"].offset_bytes == 256
    assert weights.size_bytes == 256 + matrix.nbytes == len(weights.to_bytes())


def test_graphs_share_a_tensor_of_the_same_name_and_refuse_another():
    weights = WeightFile()
    first = weights.add("table", np.ones(4, np.float32))
    assert weights.add("table", np.ones(4, np.float32)) is first
    with pytest.raises(AssertionError, match="table"):
        weights.add("table", np.zeros(4, np.float32))

"""The relight graph against its formula, and the formula against baked relighting."""

import numpy as np
import onnx
import onnxruntime
import pytest
from flashcache.export.onnx import WeightFile
from flashcache.export.relight_graph import relight, relight_graph

FORBIDDEN = {"BitwiseXor", "BitwiseAnd", "Mod", "Min", "Max", "Loop", "Scan", "Softplus", "Einsum"}


def inputs(count, num_direct, num_visibility):
    rng = np.random.default_rng(0)
    return {
        "transfer_direct": rng.normal(0.0, 0.4, (count, num_direct)).astype(np.float32),
        "transfer_indirect": rng.normal(0.0, 0.1, (count, 27)).astype(np.float32),
        "visibility": rng.normal(0.5, 0.5, (count, num_visibility)).astype(np.float32),
        "sh_reflect": rng.normal(0.0, 0.3, (count, num_visibility)).astype(np.float32),
        "light_sh": rng.normal(0.0, 1.0, (num_direct, 3)).astype(np.float32),
        "albedo_diffuse": rng.uniform(0.0, 1.0, (count, 3)).astype(np.float32),
        "spec_prefiltered": rng.uniform(0.0, 3.0, (count, 3)).astype(np.float32),
    }


@pytest.mark.parametrize("sizes", [(49, 16), (25, 9)])
@pytest.mark.parametrize("count", [1, 1000])
def test_the_graph_computes_its_formula_for_any_number_of_pixels(sizes, count):
    graph = relight_graph(*sizes, WeightFile(), {})
    onnx.checker.check_model(graph, full_check=True)
    session = onnxruntime.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    feed = inputs(count, *sizes)
    (found,) = session.run(None, feed)
    expected = relight(**{name: values.astype(np.float64) for name, values in feed.items()})
    np.testing.assert_allclose(found, expected, atol=1e-5, rtol=1e-5)


def test_the_graph_keeps_to_operators_that_every_runtime_has():
    graph = relight_graph(49, 16, WeightFile(), {}).graph
    assert not {node.op_type for node in graph.node} & FORBIDDEN
    assert len(graph.node) < 25
    assert all(tensor.data_location != onnx.TensorProto.EXTERNAL for tensor in graph.initializer)


def test_a_white_plane_in_white_light_shines_as_bright_as_the_light():
    feed = inputs(1, 49, 16)
    feed = {name: np.zeros_like(values) for name, values in feed.items()}
    feed["light_sh"][0] = np.sqrt(4.0 * np.pi)
    feed["transfer_direct"][0, 0] = np.sqrt(np.pi) / 2.0
    feed["albedo_diffuse"][:] = 1.0
    np.testing.assert_allclose(relight(**feed), 1.0, rtol=1e-6)


def test_red_indirect_transfer_lights_the_red_channel_alone():
    feed = {name: np.zeros_like(values) for name, values in inputs(1, 49, 16).items()}
    feed["light_sh"][:] = 1.0
    feed["transfer_indirect"].reshape(9, 3)[:, 0] = 1.0
    feed["albedo_diffuse"][:] = np.pi
    np.testing.assert_allclose(relight(**feed), [[9.0, 0.0, 0.0]], rtol=1e-6)

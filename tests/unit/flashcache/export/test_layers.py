"""Parts of the model as graph nodes, where the small model of the conformance tests does not reach."""

import numpy as np
import onnxruntime
import pytest
import torch
from flashcache.encoding.directional import positional_encoding
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.export import layers
from flashcache.export.onnx import GraphBuilder, WeightFile
from flashcache.geometry.contraction import contract
from flashcache.kernels import reference


def evaluate(build, values: torch.Tensor, size: int, folder) -> np.ndarray:
    """Return what onnxruntime makes of `build(graph, input)` for `values`."""
    graph = GraphBuilder("part", "row", WeightFile())
    result = build(graph, graph.input("x", values.shape[1]))
    model = graph.finish({"result": (result, size)}, {})
    (folder / "weights.bin").write_bytes(graph.weights.to_bytes())
    (folder / "graph.onnx").write_bytes(model.SerializeToString())
    session = onnxruntime.InferenceSession(folder / "graph.onnx", providers=["CPUExecutionProvider"])
    return session.run(["result"], {"x": values.numpy()})[0]


@pytest.mark.parametrize(("log2_table_size", "finest"), [(19, 2048), (12, 2048), (17, 300)])
def test_grids_equal_the_reference_up_to_the_largest_row_numbers(log2_table_size, finest, tmp_path):
    """Corners of the cube reach the largest coordinates: an overflow of 32 bits would read another row."""
    config = HashGridConfig(
        base_resolution=finest, finest_resolution=finest, num_features=1, log2_table_size=log2_table_size
    )
    grid = HashGrid(config)
    torch.nn.init.normal_(grid.table)
    generator = torch.Generator().manual_seed(0)
    z = torch.cat(
        [
            torch.rand(500, 3, generator=generator) * 2.2 - 1.1,
            1.0 - torch.rand(500, 3, generator=generator) * 4.0 / finest,
            torch.tensor([[1.0, 1.0, 1.0], [-1.0, -1.0, -1.0], [1.0, -1.0, 1.0], [9.0, 0.0, -9.0]]),
        ]
    )
    found = evaluate(lambda graph, x: layers.hash_grid(graph, "grid", grid, x), z, 1, tmp_path)
    expected = reference.encode(z, grid.table.detach(), grid.layout).numpy()
    assert np.abs(found - expected).max() < 5e-6


@pytest.mark.parametrize("beta", [1.0, 10.0])
def test_softplus_neither_overflows_nor_loses_small_values(beta, tmp_path):
    x = torch.tensor([[-200.0], [-3.0], [-1e-3], [0.0], [1e-3], [3.0], [200.0]])
    found = evaluate(lambda graph, x: layers.softplus(graph, x, beta), x, 1, tmp_path)
    assert np.allclose(found, torch.nn.functional.softplus(x, beta=beta), atol=1e-7)


def test_contraction_equals_torch_inside_and_outside(tmp_path):
    x = torch.tensor([[0.1, 0.2, 0.3], [3.0, 0.0, 0.0], [-20.0, 5.0, 1.0], [0.0, 0.0, 0.0]])
    found = evaluate(lambda graph, x: layers.contract(graph, x, 1.5), x, 3, tmp_path)
    assert np.allclose(found, contract(x, 1.5), atol=1e-6)


@pytest.mark.parametrize("num_frequencies", [0, 1, 3])
def test_frequencies_come_in_the_order_of_torch(num_frequencies, tmp_path):
    x = torch.tensor([[0.3, -0.7, 1.1]])
    size = 3 + 6 * num_frequencies
    found = evaluate(
        lambda graph, x: layers.positional_encoding(graph, x, num_frequencies), x, size, tmp_path
    )
    assert np.allclose(found, positional_encoding(x, num_frequencies), atol=1e-6)


def test_a_vanishing_vector_stays_finite(tmp_path):
    x = torch.tensor([[0.0, 0.0, 0.0], [0.0, -3.0, 4.0]])
    found = evaluate(layers.normalise, x, 3, tmp_path)
    assert np.allclose(found, [[0.0, 0.0, 0.0], [0.0, -0.6, 0.8]])


def test_sines_and_cosines_are_exact_to_float32_far_beyond_a_turn(tmp_path):
    x = torch.linspace(-1000.0, 1000.0, 20_001)[:, None]
    x = torch.cat([x, torch.linspace(-7.0, 7.0, 20_001)[:, None]])
    found = evaluate(
        lambda graph, angles: graph.concat(layers.sine_and_cosine(graph, angles)), x, 2, tmp_path
    )
    exact = x.double()
    assert np.abs(found[:, :1] - exact.sin().numpy()).max() < 2e-7
    assert np.abs(found[:, 1:] - exact.cos().numpy()).max() < 2e-7

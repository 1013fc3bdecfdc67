"""Tiles of outputs and rows give the products that numpy gives."""

import numpy as np
import pytest
from lambent_relight.fused.tiles import BLOCK, STRIDE, affine


@pytest.mark.parametrize("num_outputs", [1, 2, 3, 4, 5, 7, 13, 64])
@pytest.mark.parametrize("num_inputs", [1, 2, 33])
def test_a_layer_of_any_size_is_the_product_and_nothing_else_is_written(num_outputs, num_inputs):
    rng = np.random.default_rng(num_outputs)
    weights = rng.normal(size=(num_outputs, num_inputs)).astype(np.float32)
    bias = rng.normal(size=num_outputs).astype(np.float32)
    source = rng.normal(size=(num_inputs, STRIDE)).astype(np.float32)
    out = np.full((num_outputs + 1, STRIDE), 7.0, np.float32)
    affine(weights, bias, source, out)
    expected = weights.astype(np.float64) @ source + bias[:, None]
    np.testing.assert_allclose(out[:-1, :BLOCK], expected[:, :BLOCK], rtol=0, atol=1e-5)
    assert (out[:, BLOCK:] == 7.0).all()
    assert (out[-1] == 7.0).all()

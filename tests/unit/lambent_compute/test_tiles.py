"""Products of small matrices with tiles of 64 columns, for sizes that fit the registers and others."""

import numpy as np
import pytest
from lambent_compute import tiles


@pytest.mark.parametrize("relu", [False, True])
@pytest.mark.parametrize("outputs", [1, 2, 3, 6, 7, 17, 64])
@pytest.mark.parametrize("inputs", [1, 5, 32])
def test_a_layer_is_the_product_with_its_weights_plus_its_bias(inputs, outputs, relu):
    rng = np.random.default_rng(inputs * 100 + outputs)
    parameters = rng.standard_normal(10 + outputs * inputs + outputs).astype(np.float32)
    source = rng.standard_normal((inputs + 2, 3 * tiles.COLUMNS)).astype(np.float32)
    result = np.full((outputs + 3, tiles.COLUMNS), 7.0, np.float32)
    layer = np.array([10, 10 + outputs * inputs, inputs, outputs])
    tiles.affine(parameters, layer, source, tiles.COLUMNS, result, 2, relu)
    weight = parameters[10:-outputs].reshape(outputs, inputs).astype(np.float64)
    wanted = weight @ source[:inputs, tiles.COLUMNS : 2 * tiles.COLUMNS] + parameters[-outputs:, None]
    if relu:
        wanted = np.maximum(wanted, 0.0)
    np.testing.assert_allclose(result[2:-1], wanted, rtol=1e-5, atol=1e-5)
    assert (result[[0, 1, -1]] == 7.0).all()


def test_what_is_no_number_stays_none_behind_a_floor():
    parameters = np.array([np.nan, 0.0], np.float32)
    result = np.zeros((1, tiles.COLUMNS), np.float32)
    tiles.affine(parameters, np.array([0, 1, 1, 1]), np.ones_like(result), 0, result, 0, True)
    assert np.isnan(result).all()

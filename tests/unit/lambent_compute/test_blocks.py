"""Networks of a block of rows, against numpy in double precision."""

import numba
import numpy as np
import pytest
from lambent_compute import blocks
from lambent_compute.blocks import LINEAR, RELU, SOFTPLUS, Networks
from lambent_compute.tiles import COLUMNS

ACTIVATIONS = {
    LINEAR: lambda x, _: x,
    RELU: lambda x, _: np.maximum(x, 0.0),
    SOFTPLUS: lambda x, sharpness: np.logaddexp(0.0, sharpness * x) / sharpness,
}


@numba.njit
def answer(parameters, layers, sharpness, inputs, column, first, second):
    networks = Networks(parameters, layers)
    return blocks.run(networks, 0, len(layers), sharpness, inputs, len(inputs), column, first, second).copy()


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("joins", [False, True])
def test_layers_follow_one_another_and_inputs_may_join_again(activation, joins):
    rng, num_inputs = np.random.default_rng(3), 5
    sizes = [(7, num_inputs), (6, 7 + num_inputs * joins), (3, 6)]
    parameters, layers, weights = [], [], []
    for index, (outputs, size) in enumerate(sizes):
        weight, bias = rng.standard_normal((outputs, size)), rng.standard_normal(outputs)
        offset = sum(map(len, parameters))
        last = index == len(sizes) - 1
        layers.append(
            (
                offset,
                offset + weight.size,
                size,
                outputs,
                LINEAR if last else activation,
                joins and index == 1,
            )
        )
        parameters += [weight.ravel(), bias]
        weights.append((weight.astype(np.float32).astype(np.float64), bias.astype(np.float32)))
    inputs = rng.standard_normal((num_inputs, COLUMNS + 40)).astype(np.float32)
    first, second = np.zeros((2, 12, COLUMNS + 16), np.float32)
    sharpness = np.float32(3.0)
    table = np.array(layers, np.int64)
    flat = np.concatenate(parameters).astype(np.float32)
    found = answer(flat, table, sharpness, inputs, 40, first, second)
    wanted = read = inputs[:, 40:].astype(np.float64)
    for index, (weight, bias) in enumerate(weights):
        wanted = np.concatenate([wanted, read]) if joins and index == 1 else wanted
        wanted = weight @ wanted + bias[:, None]
        wanted = ACTIVATIONS[int(table[index, 4])](wanted, 3.0)
    np.testing.assert_allclose(found[:3, :COLUMNS], wanted, rtol=1e-5, atol=1e-5)


def test_frequencies_are_sines_and_then_cosines_of_every_channel():
    rng = np.random.default_rng(4)
    tile = np.zeros((2 + 3 * 11, COLUMNS), np.float32)
    tile[2:5] = rng.uniform(-2.0, 2.0, (3, COLUMNS))
    blocks.encode_frequencies(tile, 2, 3, 5)
    scaled = np.concatenate([2.0**octave * tile[2:5].astype(np.float64) for octave in range(5)])
    assert np.abs(tile[5:] - np.concatenate([np.sin(scaled), np.cos(scaled)])).max() < 2e-7
    assert not tile[:2].any()


@pytest.mark.parametrize("length", [0.0, 0.3, 1.0, 4.0, 1e6])
def test_contracted_points_are_those_of_the_formula(length):
    direction = np.array([2.0, -1.0, 2.0]) / 3.0
    x, y, z = (np.float32(value) for value in 2.0 * length * direction)
    found = np.array(blocks.contract(x, y, z, np.float32(0.5)))
    wanted = direction * (length if length <= 1.0 else 2.0 - 1.0 / length)
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-7)

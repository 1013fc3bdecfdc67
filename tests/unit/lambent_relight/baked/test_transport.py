"""Stored planes, coarse texels, shadow directions."""

import numpy as np
import pytest
from lambent_relight.baked.light import shadow_weights
from lambent_relight.baked.transport import (
    coarse_blocks,
    dequantised,
    quantised,
    shadow_directions,
)


def test_a_byte_per_value_is_off_by_half_a_step_at_most():
    values = np.random.default_rng(0).normal(size=(5, 400)) * [[1e-4], [1.0], [30.0], [0.0], [2.0]]
    steps, scales, offsets = quantised(values)
    assert steps.dtype == np.int8
    found = dequantised(steps.tobytes(), scales, offsets)
    bound = 0.5 * np.array(scales)[:, None] + 1e-5 * np.abs(values).max(axis=1, keepdims=True) + 1e-12
    assert (np.abs(found - values) <= bound).all()
    np.testing.assert_allclose(np.array(scales[:3]) * 254.0, np.ptp(values[:3], axis=1), rtol=1e-6)


def test_coarse_texels_are_blocks_in_the_order_of_their_place():
    size = 5
    index = np.array([0, 1, 2, 4, 6, 10, 14, 24], np.int32)
    first, parent = coarse_blocks(size, index)
    # (0,0) holds 0, 1 and 6; (0,1) holds 2; (0,2) holds 4; (1,0) holds 10; (1,2) holds 14; (2,2) holds 24.
    assert parent.tolist() == [0, 0, 1, 2, 0, 3, 4, 5]
    assert index[first].tolist() == [0, 2, 4, 10, 14, 24]


def test_shadow_directions_are_unit_and_even():
    directions = shadow_directions()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(directions.mean(axis=0), 0.0, atol=2e-3)
    cosine = directions @ directions.T - 2.0 * np.eye(256)
    nearest_deg = np.degrees(np.arccos(cosine.max(axis=1)))
    assert 8.0 < nearest_deg.min() < nearest_deg.max() < 16.0


@pytest.mark.parametrize("seed", range(5))
def test_the_bits_of_a_light_are_those_around_it_and_change_smoothly(seed):
    rng = np.random.default_rng(seed)
    light = rng.normal(size=3)
    light /= np.linalg.norm(light)
    near, weight = shadow_weights(light)
    assert weight.sum() == pytest.approx(1.0)
    assert (weight >= 0.0).all()
    assert np.degrees(np.arccos(shadow_directions()[near] @ light)).max() < 32.0
    moved = light + 1e-4 * rng.normal(size=3)
    other, changed = shadow_weights(moved / np.linalg.norm(moved))
    before, after = np.zeros(256), np.zeros(256)
    before[near], after[other] = weight, changed
    assert np.abs(before - after).max() < 5e-3

"""The turns of a light and their description."""

import numpy as np
import pytest
import torch
from flashcache.encoding.turns import LightTurns, describe
from support.turning_light import TURNS, about, flat


def test_on_the_circle_the_description_is_linear_in_three_harmonics_of_the_angle():
    degrees = np.linspace(0.0, 360.0, 48, endpoint=False)
    rotations = np.stack([about((0.3, -0.2, 1.0), angle) for angle in degrees])
    codes = describe(torch.from_numpy(rotations)).numpy()
    waves = [wave(k * np.radians(degrees)) for k in (1, 2, 4) for wave in (np.cos, np.sin)]
    basis = np.stack([np.ones_like(degrees), *waves], axis=1)
    residual = codes - basis @ np.linalg.lstsq(basis, codes, rcond=None)[0]
    assert np.abs(residual).max() < 1e-12
    assert np.linalg.matrix_rank(codes) == 7


def test_turning_to_the_light_and_back_changes_nothing():
    turns, index = LightTurns(flat(TURNS)), torch.tensor([0, 1, 2, 2])
    vectors = torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    there = turns.to_light(vectors, index)
    torch.testing.assert_close(turns.to_world(there[:, None], index)[:, 0], vectors)
    torch.testing.assert_close(there[0], vectors[0])
    torch.testing.assert_close(there[2], torch.from_numpy(TURNS[1]).float() @ vectors[2])


def test_a_known_turn_is_found_and_a_new_one_added():
    turns = LightTurns(flat(TURNS))
    assert turns.index_of(torch.from_numpy(TURNS[1])) == 2
    new = torch.from_numpy(about((1.0, 0.0, 0.0), 20.0))
    assert turns.index_of(new) == turns.index_of(new) == 3
    torch.testing.assert_close(turns.code(torch.tensor([3])), describe(new[None].float()))


def test_light_number_zero_is_the_reference():
    with pytest.raises(AssertionError, match="reference"):
        LightTurns(flat(TURNS)[1:])

"""Maps of other programs: each convention against that program's own formula."""

import numpy as np
import pytest
from lambent_core.directions import normalise, uv_of_directions
from lambent_core.errors import EnvironmentFileError
from lambent_relight.environment.axes import QUARTER_TURNS, from_axes
from lambent_relight.environment.maps import environment_from_array

DIRECTIONS = normalise(np.random.default_rng(0).normal(size=(400, 3)))


def y_up(directions):
    """Return our directions in a world with y up, as glTF has it."""
    return directions[:, 0], directions[:, 2], -directions[:, 1]


def blender(directions):
    x, y, z = directions.T
    return 0.5 - np.arctan2(y, x) / (2 * np.pi), np.arccos(z) / np.pi


def threejs(directions):
    x, y, z = y_up(directions)
    # Its v runs upwards.
    return np.arctan2(z, x) / (2 * np.pi) + 0.5, 1.0 - (np.arcsin(y) / np.pi + 0.5)


def mitsuba(directions):
    x, y, z = y_up(directions)
    return np.arctan2(x, -z) / (2 * np.pi) % 1.0, np.arccos(y) / np.pi


def skylibs(directions):
    x, y, z = y_up(directions)
    return (1 + np.arctan2(x, -z) / np.pi) / 2, np.arccos(y) / np.pi


FORMULAS = {"blender": blender, "threejs": threejs, "mitsuba": mitsuba, "skylibs": skylibs}


@pytest.mark.parametrize("width", [64, 50])
@pytest.mark.parametrize("axes", FORMULAS)
def test_light_comes_from_where_the_other_program_sees_it(axes, width):
    image = np.random.default_rng(1).random((32, width, 3))
    theirs = environment_from_array(image)
    u, v = FORMULAS[axes](DIRECTIONS)
    # Their map looked up at their coordinates: our look-up at the direction of the same map position.
    expected = theirs.lookup(directions_at(u, v))
    found = from_axes(theirs, axes).lookup(DIRECTIONS)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def directions_at(u, v):
    azimuth = np.pi - 2 * np.pi * u
    return np.stack(
        [np.cos(azimuth) * np.sin(np.pi * v), np.sin(azimuth) * np.sin(np.pi * v), np.cos(np.pi * v)], axis=-1
    )


def test_the_look_up_of_the_test_is_the_inverse_of_ours():
    np.testing.assert_allclose(directions_at(*uv_of_directions(DIRECTIONS)), DIRECTIONS, atol=1e-9)
    assert set(FORMULAS) == set(QUARTER_TURNS)


def test_an_unknown_convention_is_refused_with_the_known_ones():
    with pytest.raises(EnvironmentFileError, match=r"environment\.unknown_axes.*maya.*blender, threejs"):
        from_axes(environment_from_array(np.ones((4, 8, 3))), "maya")

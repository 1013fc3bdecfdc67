"""Channels of the desktop viewer that need no bundle: grading, depth, and doubts at the surface."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
from lambent.desktop.channels import channel_names, graded, object_positions, shown_channel
from lambent_core.colour import srgb_from_linear
from lambent_relight import RelitPicture
from lambent_relight.bundle.uncertainty import UncertaintyGrid


def picture(**images):
    names = [field.name for field in fields(RelitPicture) if field.name not in ("num_samples", "bounces")]
    arrays = dict.fromkeys(names, np.zeros((2, 3, 1), np.float32)) | images
    return RelitPicture(**arrays, num_samples=0)


def grid():
    """Return doubts that grow along x from 0 to 1, and numbers of views that grow to 10."""
    along = np.linspace(0.0, 1.0, 11, dtype=np.float32)
    values = np.zeros((11, 1, 1, 2), np.float32)
    values[:, 0, 0, 0], values[:, 0, 0, 1] = along, 10.0 * along
    return UncertaintyGrid(
        np.array([-0.05, -1.0, -1.0]), np.array([1.05, 1.0, 1.0]), values, ("albedo", "views")
    )


def test_radiance_is_exposed_mapped_and_encoded():
    radiance = np.array([[0.1, 0.2, 0.4]], np.float32)
    np.testing.assert_allclose(graded(radiance, exposure_ev=1.0), srgb_from_linear(2.0 * radiance), atol=1e-6)
    assert graded(radiance, tone_mapping="neutral")[0, 2] < graded(radiance)[0, 2]


def test_doubts_are_offered_where_the_bundle_has_them():
    with_grid = SimpleNamespace(uncertainty=grid)
    assert channel_names(with_grid)[-2:] == ("uncertainty: albedo", "uncertainty: views")
    without = SimpleNamespace(uncertainty=lambda: None)
    assert not [name for name in channel_names(without) if "uncertainty" in name]


@pytest.mark.parametrize(("name", "top"), [("albedo", "1 yellow"), ("views", "10 yellow")])
def test_doubts_are_looked_up_at_the_surface_and_coloured_from_violet_to_yellow(name, top):
    coverage = np.ones((2, 3, 1), np.float32)
    coverage[1] = 0.0
    positions = np.zeros((2, 3, 3))
    positions[0, :, 0] = (0.0, 0.5, 1.0)
    positions[1] = np.nan
    image, legend = shown_channel(
        picture(coverage=coverage), f"uncertainty: {name}", lambda: positions, grid()
    )
    expected = np.array([[68, 1, 84], [33, 145, 140], [253, 231, 37]]) / 255.0
    np.testing.assert_allclose(image[0], expected, atol=1e-4)
    assert legend.endswith(top)


def test_positions_are_those_of_the_object_before_it_was_turned():
    eye = np.array([0.0, -4.0, 0.0])
    directions = np.array([[0.0, 1.0, 0.0], [0.6, 0.8, 0.0]])
    distance = np.array([[[3.0], [5.0]]], np.float32)
    found = object_positions(directions, eye, distance, 0.0)
    np.testing.assert_allclose(found[0], [[0.0, -1.0, 0.0], [3.0, 0.0, 0.0]], atol=1e-6)
    # Turned by +90 degrees, what is now at -y was at -x, and what is at +x was at -y.
    turned = object_positions(directions, eye, distance, 90.0)
    np.testing.assert_allclose(turned[0], [[-1.0, 0.0, 0.0], [0.0, -3.0, 0.0]], atol=1e-6)


def test_depth_is_spread_over_what_is_seen_and_says_so():
    distance = np.array([[[2.0], [3.0], [4.0]], [[0.0], [0.0], [0.0]]], np.float32)
    coverage = (distance > 0.0).astype(np.float32)
    image, legend = shown_channel(picture(distance=distance, coverage=coverage), "depth", lambda: None, None)
    np.testing.assert_allclose(image[0, :, 0], [1.0, 0.5, 0.0], atol=1e-6)
    assert legend == "2 white, 4 black"

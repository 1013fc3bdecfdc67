"""The truth in place of what a model found, at the points that a camera sees."""

import argparse
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.data.scene import View
from flashcache.evaluation.relighting import MapLight
from flashcache.evaluation.views import render_relit
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from oracle_geometry import surface_points
from oracle_points import ROWS, Replaced, albedo_ratio, pixels_of, relit, with_truth
from support.lit_sphere import BOTTOM, RADIUS, TOP
from support.measured_sphere import METALNESS, ROUGHNESS, measured_views
from support.sphere_model import sphere_model

BOTH = Replaced(normals=True, materials=True)
RATIO = torch.tensor([2.0, 1.0, 0.5])


@pytest.fixture(scope="module")
def model() -> InverseModel:
    return sphere_model().requires_grad_(False)


@pytest.fixture(scope="module")
def view() -> View:
    return measured_views(side=24)[5]


@pytest.fixture(scope="module")
def points(view: View) -> ShadingPoints:
    """Return the points that whole pixels see, with normals that are wrong."""
    whole = view.truth["albedo"][..., 3] > 0.99
    positions = torch.tensor(surface_points(view)[whole], dtype=torch.float32)
    up = torch.tensor([0.0, 0.0, 1.0]).expand_as(positions)
    return ShadingPoints(positions, up, -up, torch.zeros(len(positions), dtype=torch.int64))


def test_a_point_appears_in_the_pixel_that_sees_it(view: View, points: ShadingPoints):
    whole = (view.truth["albedo"][..., 3] > 0.99).reshape(-1)
    assert pixels_of(view, points.positions).tolist() == whole.nonzero()[0].tolist()


def test_what_is_replaced_is_true_and_the_rest_the_models(
    model: InverseModel, view: View, points: ShadingPoints
):
    found, materials = with_truth(model, points, view, BOTH, RATIO)
    clear = points.positions[:, 2].abs() > 0.1  # Pixels that see one half only.
    height = points.positions[clear, 2:]
    albedo = torch.where(height > 0.0, torch.tensor(TOP), torch.tensor(BOTTOM)) / RATIO
    assert torch.allclose(materials.albedo[clear], albedo, atol=1e-5)
    assert torch.allclose(materials.alpha, torch.tensor(ROUGHNESS**2))
    assert torch.allclose(materials.metalness, torch.tensor(METALNESS))
    outward = torch.nn.functional.normalize(points.positions, dim=-1)
    assert (found.normal * outward).sum(dim=-1).min() > 0.99
    assert found.positions is points.positions

    same, own = with_truth(model, points, view, ROWS["as trained"], RATIO)
    assert torch.equal(same.normal, points.normal)
    assert torch.equal(own.albedo, model.materials(points.positions).albedo)


def test_points_beside_the_true_object_keep_what_the_model_says(
    model: InverseModel, view: View, points: ShadingPoints
):
    right = torch.tensor(view.camera.camera_to_world[:3, 0], dtype=torch.float32)
    beside = points._replace(positions=points.positions + 2.2 * RADIUS * right)
    found, materials = with_truth(model, beside, view, BOTH, RATIO)
    assert torch.equal(found.normal, beside.normal)
    assert torch.equal(materials.metalness, model.materials(beside.positions).metalness)


def test_as_trained_is_what_an_evaluation_renders(model: InverseModel, view: View):
    sky = np.linspace(0.2, 2.0, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
    arguments = argparse.Namespace(directions=32, antialias=1)
    light, ratio = MapLight.from_image(sky, torch.device("cpu")), torch.ones(3)
    wanted = render_relit(model, view.camera, sky, num_directions=32)
    found = relit(model, view, light, ROWS["as trained"], ratio, arguments, indirect=True)
    np.testing.assert_array_equal(found.rgb, wanted.rgb)
    other = relit(model, view, light, BOTH, ratio, arguments, indirect=True)
    assert np.abs(other.rgb - wanted.rgb).mean() > 0.1 * wanted.rgb.mean()


def test_the_ratio_turns_found_into_true_albedo(model: InverseModel, view: View):
    ratio = albedo_ratio(model, (view,), antialias=1)
    assert ratio.shape == (3,)
    brighter = {**view.truth, "albedo": view.truth["albedo"] * np.float32([3.0, 3.0, 3.0, 1.0])}
    again = albedo_ratio(model, (replace(view, truth=brighter),), antialias=1)
    assert torch.allclose(again, 3.0 * ratio)

"""Points lie on the surface, and the photographs that see them are the right ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.evaluation.surface_points import (
    MAX_VIEWS,
    SurfacePoints,
    join,
    outer_points,
    photographed_points,
    seen_points,
)
from flashcache.physical.incident import Incident
from support.lit_sphere import camera, lit_sphere
from support.shading import unoccluded
from support.sphere_model import RADIUS, sphere_model
from support.statistics import assert_mean

SCENE = replace(lit_sphere(16, side=16), lights=("sky",))
CAMERAS = [view.camera for view in SCENE.train]


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=("sky",)).requires_grad_(False)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def on_sphere(count: int) -> SurfacePoints:
    normal = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator(5)), dim=-1)
    return SurfacePoints(RADIUS * normal, normal)


def test_photographed_points_lie_on_the_surface_that_faces_the_cameras(model):
    found = photographed_points(model, CAMERAS[:1], 40, generator())
    assert len(found.positions) == 40
    np.testing.assert_allclose(found.positions.norm(dim=1), RADIUS, atol=0.08)
    towards = torch.tensor(CAMERAS[0].position).float()
    assert (found.positions @ towards).min() > 0.0


def test_cameras_that_look_away_show_no_points(model):
    away = replace(CAMERAS[0], camera_to_world=CAMERAS[0].camera_to_world @ np.diag([1.0, -1.0, -1.0, 1.0]))
    assert len(photographed_points(model, [away], 10, generator()).positions) == 0


def test_outer_points_cover_the_surface_evenly(model):
    found = outer_points(model, 200, generator())
    assert len(found.positions) == 200
    distance = found.positions.norm(dim=1)
    # The small model samples a ray at eight points only, and overlooks the ball on some lines.
    on_it = (distance - RADIUS).abs() < 0.08
    assert on_it.float().mean() > 0.7
    assert_mean(found.positions[on_it], torch.zeros(3))


def test_only_cameras_that_a_point_faces_see_it(model):
    points = on_sphere(60)
    found, total = seen_points(model, points, SCENE, unoccluded, generator())
    eyes = np.stack([cam.position for cam in CAMERAS])
    offset = eyes[None] - points.positions.numpy()[:, None]
    cosine = (offset * points.normal.numpy()[:, None]).sum(-1) / np.linalg.norm(offset, axis=-1)
    np.testing.assert_array_equal(total, (cosine > 0.05).sum(axis=1))
    facing = (found.omega_o * points.normal[:, None]).sum(-1)
    assert (facing[found.visibility > 0.0] > 0.05).all()
    assert found.omega_o.shape[1] == MAX_VIEWS


def test_chosen_photographs_stand_for_all_that_see_the_point(model):
    found, total = seen_points(model, on_sphere(60), SCENE, unoccluded, generator())
    np.testing.assert_allclose(found.visibility.sum(dim=1), total, rtol=1e-5)
    assert total.max() > 0


def test_a_point_outside_the_picture_is_not_seen(model):
    close = replace(camera(0.0, 0.0, side=8), focal_x=200.0, focal_y=200.0)
    scene = replace(SCENE, train=(replace(SCENE.train[0], camera=close),))
    edge, middle = torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    points = join([SurfacePoints(RADIUS * normal, middle) for normal in (edge, middle)])
    _, total = seen_points(model, points, scene, unoccluded, generator())
    assert total.tolist() == [0.0, 1.0]


def test_what_stands_between_hides_a_point(model):
    def wall(rays):
        opacity = torch.where(rays.directions[:, 0] > 0.0, 1.0, 0.25)
        return Incident(torch.zeros_like(rays.origins), opacity, opacity)

    points = on_sphere(60)
    found, total = seen_points(model, points, SCENE, wall, generator())
    _, clear = seen_points(model, points, SCENE, unoccluded, generator())
    # Towards +x nothing passes, elsewhere three quarters do.
    assert (found.omega_o[found.visibility > 0.0][:, 0] <= 0.0).all()
    assert (total <= 0.75 * clear + 1e-5).all()


def test_a_photograph_in_every_light_counts(model):
    two = sphere_model(lights=("sky", "lamp")).requires_grad_(False)
    views = tuple(
        replace(view, images={"sky": view.images["sky"], "lamp": view.images["sky"]}) for view in SCENE.train
    )
    scene = replace(SCENE, lights=("sky", "lamp"), train=views)
    found, total = seen_points(two, on_sphere(30), scene, unoccluded, generator())
    _, single = seen_points(model, on_sphere(30), SCENE, unoccluded, generator())
    np.testing.assert_allclose(total, 2.0 * single)
    assert set(found.light_index[found.visibility > 0.0].tolist()) == {0, 1}

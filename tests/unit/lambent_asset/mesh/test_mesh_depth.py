"""Distances of mesh and volume, on a ball."""

import numpy as np
import pytest
import torch
from flashcache.evaluation.gbuffer import camera_rays
from lambent_asset.mesh.mesh import Mesh, extract_mesh
from lambent_asset.mesh.mesh_depth import depth_agreement, median_distance
from lambent_asset.mesh.mesh_settling import settled_mesh
from lambent_core.scene import View
from support.sphere_model import sphere_model
from support.square_views import square_camera


@pytest.fixture(scope="module")
def model():
    return sphere_model()


@pytest.fixture(scope="module")
def views():
    places = {"front": (0.0, -3.0, 0.5), "side": (3.0, 0.0, 0.5)}
    return tuple(
        View(
            name=name,
            camera=square_camera(place, 48, 110.0),
            images={},
        )
        for name, place in places.items()
    )


@pytest.fixture(scope="module")
def mesh(model):
    return settled_mesh(model, extract_mesh(model, (-0.8,) * 3, (0.8,) * 3, 24))


def test_half_of_the_weights_lie_before_the_median(model, views):
    rays = camera_rays(model, views[0].camera, torch.device("cpu"))
    rays = rays.select((rays.far > rays.near).nonzero()[:, 0])
    with torch.no_grad():
        geometry = model.nerf.trace(rays, generator=None)
    opacity, distance = median_distance(model, rays).T
    edges = geometry.samples.distances
    share = ((distance[:, None] - edges[:, :-1]) / (edges[:, 1:] - edges[:, :-1])).clamp(0.0, 1.0)
    before = (share * geometry.weights).sum(dim=-1)
    assert torch.allclose(opacity, geometry.opacity, atol=1e-6)
    assert torch.allclose(before, 0.5 * opacity, atol=1e-4)


def test_a_mesh_that_is_moved_away_from_a_camera_is_away_by_as_many_pixels(model, views, mesh):
    here = depth_agreement(model, mesh.vertices, mesh.faces, views)
    assert here.median < here.p95 < here.worst_p95 + 0.01
    shift = np.float32([0.0, 0.2, 0.0])
    moved = depth_agreement(model, mesh.vertices + shift, mesh.faces, views[:1])
    # 0.2 units away at 2.5 units and 110 pixels of focal length are 8.8 pixels, more where it is oblique.
    assert moved.worst_view == "front"
    assert moved.median == pytest.approx(0.2 / 2.55 * 110.0, rel=0.25)
    assert moved.median > 5.0 * here.median > 0.0


def test_a_mesh_that_no_view_shows_has_no_distance(model, views, mesh):
    away = Mesh(mesh.vertices + np.float32([50.0, 0.0, 0.0]), mesh.faces, mesh.cell)
    assert depth_agreement(model, away.vertices, away.faces, views[:1]) is None

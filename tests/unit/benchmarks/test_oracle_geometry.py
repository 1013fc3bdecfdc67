"""The surface that stands in for a scene's meshes, on a sphere whose maps are known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from support.lit_sphere import BOTTOM, RADIUS, TOP
from support.measured_sphere import METALNESS, ROUGHNESS, measured_view, measured_views

from benchmarks.oracle_geometry import Proxy, fuse, pixel_of, pixel_rays, single_surface

BOX = ((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8))
CELL = 1.6 / 40


@pytest.fixture(scope="module")
def proxy() -> Proxy:
    views = measured_views()
    return fuse(views, views, *BOX, resolution=40)


def test_a_pixels_centre_lies_in_that_pixel():
    camera = measured_views(1)[0].camera
    points = camera.position + 2.5 * pixel_rays(camera).reshape(-1, 3)
    assert np.array_equal(pixel_of(camera, points), np.arange(len(points)))


def test_points_beside_and_behind_the_camera_lie_in_no_pixel():
    camera = measured_views(1)[0].camera
    behind = camera.position + camera.camera_to_world[:3, 2]
    beside = camera.position + 9.0 * camera.camera_to_world[:3, 0] - camera.camera_to_world[:3, 2]
    assert pixel_of(camera, np.stack([behind, beside])).tolist() == [-1, -1]


def test_the_fused_surface_lies_on_the_true_one_to_a_fraction_of_a_cell(proxy: Proxy):
    error = np.linalg.norm(proxy.vertices, axis=-1) - RADIUS
    assert np.abs(error).max() < CELL
    assert np.median(np.abs(error)) < 0.1 * CELL


def test_the_fused_surface_is_closed_and_faces_outwards(proxy: Proxy):
    edges = np.concatenate([proxy.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    there, back = (set(map(tuple, one.tolist())) for one in (edges, edges[:, ::-1]))
    assert len(there ^ back) == 0
    corners = proxy.vertices[proxy.faces]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.02)


def test_vertices_have_the_true_normals_and_materials(proxy: Proxy):
    radial = proxy.vertices / np.linalg.norm(proxy.vertices, axis=-1, keepdims=True)
    assert np.degrees(np.arccos((radial * proxy.normals).sum(axis=-1).clip(-1.0, 1.0))).mean() < 2.0
    assert proxy.perceptual_roughness == pytest.approx(ROUGHNESS, abs=1e-5)
    assert proxy.metalness == pytest.approx(METALNESS, abs=1e-5)
    for side, albedo in ((1.0, TOP), (-1.0, BOTTOM)):
        inside = side * proxy.vertices[:, 2] > 0.15
        assert np.abs(proxy.albedo[inside] - albedo).max() < 1e-5


def test_only_pixels_of_one_surface_count():
    view = measured_view("test_000", 0.0, 0.3, 48)
    distance = view.truth["distance"].copy()
    distance[20] += 0.3 * (distance[20] > 0.0)  # A row between two surfaces: a mean that lies on neither.
    spoilt = replace(view, truth={**view.truth, "distance": distance})
    clean, mixed = single_surface(view), single_surface(spoilt)
    assert clean[20, 20:28].all()
    assert not mixed[20, 20:28].any()
    assert mixed[24:30, 20:28].all()
    assert not clean[view.truth["albedo"][..., 3] == 0.0].any()


def test_what_no_view_sees_is_solid_within_the_outlines():
    views = measured_views()
    upper = [view for view in views if view.camera.position[2] > 0.5]
    found = fuse(upper, views, *BOX, resolution=40)
    assert found.vertices[:, 2].min() == pytest.approx(-RADIUS, abs=2.5 * CELL)
    assert found.seen_share < 1.0

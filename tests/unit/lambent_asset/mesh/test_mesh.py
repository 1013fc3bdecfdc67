"""The mesh of a trained density, on a ball."""

import math

import numpy as np
import pytest
import torch
import trimesh
from lambent_asset.mesh.mesh import (
    Mesh,
    data_resolution,
    extract_mesh,
    occupied_box,
    without_hidden,
)
from lambent_asset.mesh.mesh_decimation import simplified
from lambent_core.errors import WorkerError
from support.sphere_model import BOUND, RADIUS, sphere_model


@pytest.fixture(scope="module")
def model():
    return sphere_model()


@pytest.fixture(scope="module")
def mesh(model):
    return extract_mesh(model, (-0.8,) * 3, (0.8,) * 3, 40)


def signed_volume(mesh) -> float:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume


def test_vertices_lie_on_the_ball(mesh):
    radii = np.linalg.norm(mesh.vertices, axis=1)
    assert abs(radii.mean() - RADIUS) < 0.06
    assert radii.std() < 0.02


@torch.no_grad()
def test_a_ray_along_the_meshs_outline_is_about_half_hidden(model):
    coarse = extract_mesh(model, (-0.8,) * 3, (0.8,) * 3, 24)
    points = torch.zeros(4001, 3)
    points[:, 0] = float(np.linalg.norm(coarse.vertices, axis=1).mean())
    points[:, 1] = torch.linspace(-1.0, 1.0, len(points))
    depth = float(model.nerf.density.density(points).mean()) * 2.0
    assert 0.3 < 1.0 - math.exp(-depth) < 0.7


def test_triangles_face_outwards_and_enclose_the_balls_volume(mesh):
    radius = float(np.linalg.norm(mesh.vertices, axis=1).mean())
    assert signed_volume(mesh) == pytest.approx(4.0 / 3.0 * math.pi * radius**3, rel=0.05)


def test_a_simplified_ball_keeps_its_volume_and_its_orientation(mesh):
    few = simplified(mesh, 400)
    assert 300 < len(few.faces) <= 400
    assert few.faces.max() == len(few.vertices) - 1
    assert signed_volume(few) == pytest.approx(signed_volume(mesh), rel=0.03)
    assert simplified(mesh, 10**6).faces.shape == mesh.faces.shape


def test_triangles_without_area_are_dropped(mesh):
    vertices = np.concatenate([mesh.vertices, mesh.vertices[:1]])
    flat = np.array([[0, len(mesh.vertices), 1]])
    found = simplified(Mesh(vertices, np.concatenate([mesh.faces, flat]), mesh.cell), 10**6)
    assert len(found.faces) == len(mesh.faces)
    assert len(found.vertices) == len(mesh.vertices)


def test_pieces_inside_another_are_left_out(mesh):
    inner = mesh.vertices * np.float32(0.5)
    beside = mesh.vertices + np.float32([3.0, 0.0, 0.0])
    count = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, inner, beside])
    faces = np.concatenate([mesh.faces, mesh.faces + count, mesh.faces + 2 * count])
    kept, triangles = without_hidden(vertices, faces)
    assert len(triangles) == 2 * len(mesh.faces)
    assert np.array_equal(kept, np.concatenate([mesh.vertices, beside]))


def test_cells_are_no_finer_than_the_density_or_the_photographs_are(model):
    box = (-0.5,) * 3, (0.5, 0.5, 0.5)
    # The density of the model has 16 voxels over 2 scene units.
    assert data_resolution(model, *box, pixel_size=0.0, limit=1000) == 8
    assert data_resolution(model, (-4.0,) * 3, (4.0,) * 3, pixel_size=0.0, limit=1000) == 64
    assert data_resolution(model, (-4.0,) * 3, (4.0,) * 3, pixel_size=0.5, limit=1000) == 32
    assert data_resolution(model, (-4.0,) * 3, (4.0,) * 3, pixel_size=0.0, limit=20) == 20


def test_the_occupied_box_encloses_the_ball_with_a_margin(model):
    low, high = occupied_box(model)
    cell = 2.0 * BOUND / 64
    for a, b in zip(low, high, strict=True):
        assert -RADIUS - 5 * cell < a < -RADIUS
        assert RADIUS < b < RADIUS + 5 * cell


def test_floaters_are_removed(model, monkeypatch):
    ball = model.nerf.density.density

    def with_floater(positions: torch.Tensor) -> torch.Tensor:
        apart = (positions - torch.tensor([0.75, 0.75, 0.75])).norm(dim=-1)
        return ball(positions) + 500.0 * (apart < 0.035)

    monkeypatch.setattr(model.nerf.density, "density", with_floater)
    assert occupied_box(model)[1][0] < 0.7
    mesh = extract_mesh(model, (-0.9,) * 3, (0.9,) * 3, 40)
    assert np.linalg.norm(mesh.vertices, axis=1).max() < 0.7
    assert mesh.faces.max() == len(mesh.vertices) - 1


def test_matter_that_touches_the_box_is_closed_there(model):
    mesh = extract_mesh(model, (-0.8,) * 3, (0.8, 0.8, 0.0), 40)
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight
    assert signed_volume(mesh) > 0.0


def test_empty_space_is_refused_with_what_to_do(model, monkeypatch):
    monkeypatch.setattr(model.nerf.density, "density", lambda positions: torch.zeros(len(positions)))
    with pytest.raises(WorkerError, match="train with more steps") as raised:
        occupied_box(model)
    assert raised.value.code == "export.no_surface"

"""Vertices settled in a density whose surface is known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lambent_asset.mesh.mesh import extract_mesh
from lambent_asset.mesh.mesh_settling import (
    END_DEPTH,
    NUM_PLACES,
    end_of_rays,
    own_matter,
    settled_mesh,
    without_folds,
)
from support.sphere_model import sphere_model

CELL = 0.02
RATE = 100.0


class Layer(torch.nn.Module):
    """Matter whose density rises as `exp(RATE depth)` below z = 0, and optionally a floor's below a gap."""

    def __init__(self, ceiling: float = math.inf) -> None:
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))
        self.ceiling = ceiling
        self.nerf = SimpleNamespace(density=SimpleNamespace(density=self.density))

    def density(self, points: torch.Tensor) -> torch.Tensor:
        z = points[:, 2]
        return torch.exp((-RATE * z).clamp(-40.0, 8.0)) + 1e4 * (z > self.ceiling)


def upwards(count: int) -> np.ndarray:
    return np.tile(np.array([0.0, 0.0, 1.0]), (count, 1))


def test_the_end_of_a_ray_is_where_the_depth_of_an_exponential_layer_is_reached():
    """The depth above z is exp(-RATE z) / RATE."""
    expected = -math.log(RATE * END_DEPTH) / RATE
    heights = np.linspace(-0.01, 0.01, 9) + expected
    points = np.stack([0.0 * heights, 0.0 * heights, heights], axis=-1)
    found = heights - end_of_rays(Layer(), points, upwards(9), CELL)
    # Half the distance between samples.
    assert np.abs(found - expected).max() < 0.5 * 4.0 * CELL / NUM_PLACES


def test_another_surface_above_a_gap_does_not_pull_a_vertex_up():
    points = np.zeros((1, 3))
    alone = end_of_rays(Layer(), points, upwards(1), CELL)
    # The ceiling is within the reach of the search, which begins 1.5 cells above the point.
    near = end_of_rays(Layer(ceiling=1.2 * CELL), points, upwards(1), CELL)
    assert near == pytest.approx(alone, abs=1e-3 * CELL)


def test_own_matter_ends_where_density_rises_again():
    density = torch.tensor([[9.0, 1.0, 2.0, 4.0, 5.0, 1.0]])
    assert own_matter(density, 4).tolist() == [[0.0, 1.0, 2.0, 4.0, 5.0, 1.0]]


def test_thin_matter_settles_in_its_middle_and_nothing_stays_where_it_is():
    class Sheet(Layer):
        def density(self, points: torch.Tensor) -> torch.Tensor:
            return 20.0 * ((points[:, 2] + 0.01).abs() < 0.004)

    found = end_of_rays(Sheet(), np.zeros((1, 3)), upwards(1), CELL)
    assert found == pytest.approx([0.01], abs=0.1 * CELL)

    class Nothing(Layer):
        def density(self, points: torch.Tensor) -> torch.Tensor:
            return torch.zeros(len(points))

    assert end_of_rays(Nothing(), np.zeros((1, 3)), upwards(1), CELL) == 0.0


def test_a_settled_ball_has_the_depth_of_a_ray_everywhere_and_no_slivers():
    model = sphere_model()
    mesh = extract_mesh(model, (-0.8,) * 3, (0.8,) * 3, 24)
    found = settled_mesh(model, mesh)
    outwards = found.vertices / np.linalg.norm(found.vertices, axis=1, keepdims=True)
    left = end_of_rays(model, found.vertices, outwards, mesh.cell)
    before = end_of_rays(model, mesh.vertices, outwards, mesh.cell)
    assert np.abs(left).max() < 0.15 * mesh.cell < np.abs(before).min()
    a, b, c = (found.vertices[found.faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    middle = a + b + c
    cosine = (flat * middle).sum(-1) / np.linalg.norm(middle, axis=1)
    assert cosine.min() > 0.97


def test_a_move_that_turns_a_triangle_over_is_taken_back():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [5.0, 5.0, 0.0]])
    moved = vertices.copy()
    moved[2] = [0.0, -1.0, 0.0]
    moved[3] = [6.0, 6.0, 0.0]
    found = without_folds(vertices, moved, np.array([[0, 1, 2], [1, 3, 2]]))
    assert np.array_equal(found[2], vertices[2])
    fine = without_folds(vertices, vertices + 0.1, np.array([[0, 1, 2]]))
    assert np.array_equal(fine, vertices + 0.1)

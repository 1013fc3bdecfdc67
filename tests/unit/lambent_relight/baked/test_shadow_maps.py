"""Shadows from depth maps, compared with rays over the disc of a light."""

import numpy as np
import pytest
from lambent_relight.baked.mesh import AtlasMesh
from lambent_relight.baked.shadow_maps import SIDE, light_axes, pattern_turns, shadow_map
from lambent_relight.tracing.mesh_rays import MeshRays
from support.quad_surface import Quad

GROUND = Quad((-2.0, -2.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0))
PLATE = Quad((-0.5, -0.5, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
TEXEL = 2.0 * np.linalg.norm([2.0, 2.0, 0.5]) / SIDE


def mesh_of(*quads):
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices = [np.array(quad.corner) + corners @ np.array([quad.u, quad.v]) for quad in quads]
    faces = [np.array([[0, 1, 2], [0, 2, 3]]) + 4 * number for number in range(len(quads))]
    vertices = np.concatenate(vertices).astype(np.float32)
    return AtlasMesh(
        vertices, np.concatenate(faces).astype(np.int32), np.zeros((len(vertices), 2), np.float32)
    )


def ball(rows=64):
    polar, azimuth = np.meshgrid(
        np.linspace(0.0, np.pi, rows + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rows + 1), indexing="ij"
    )
    vertices = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1
    )
    number = np.arange(vertices[..., 0].size).reshape(rows + 1, -1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    vertices = vertices.reshape(-1, 3).astype(np.float32)
    return AtlasMesh(vertices, faces.astype(np.int32), np.zeros((len(vertices), 2), np.float32))


def unit(*values):
    return np.array(values, np.float64) / np.linalg.norm(values)


def on_ground(count, seed=0):
    at = np.random.default_rng(seed).uniform(-1.6, 1.6, (count, 2))
    position = np.concatenate([at, np.zeros((count, 1))], axis=1).astype(np.float32)
    return position, np.tile(np.float32([0.0, 0.0, 1.0]), (count, 1))


def traced(mesh, position, direction, radius_rad, rays=256):
    """Return the share of a disc's directions that is free at points."""
    first, second, towards = light_axes(direction)
    away = np.tan(radius_rad) * np.sqrt((np.arange(rays) + 0.5) / rays)
    angle = np.arange(rays) * np.pi * (3.0 - np.sqrt(5.0))
    disc = towards + (away * np.cos(angle))[:, None] * first + (away * np.sin(angle))[:, None] * second
    disc /= np.linalg.norm(disc, axis=1, keepdims=True)
    found = MeshRays(mesh.vertices, mesh.faces)
    start = np.repeat(position + np.float32([0.0, 0.0, 1e-3]), rays, axis=0)
    return 1.0 - found(start, np.tile(disc, (len(position), 1))).blocked.reshape(-1, rays).mean(axis=1)


@pytest.mark.parametrize("direction", [unit(0.3, -0.2, 1.0), unit(0.0, 0.0, 1.0), unit(-0.9, 0.5, 0.8)])
@pytest.mark.parametrize("radius_deg", [0.25, 2.0, 6.0])
def test_the_shadow_of_a_plate_is_that_of_rays_over_the_lights_disc(direction, radius_deg):
    mesh = mesh_of(GROUND, PLATE)
    position, normal = on_ground(1500)
    radius = np.radians(radius_deg)
    turns = [pattern_turns(np.arange(1500) + 7 * k, np.arange(1500) * 3 + k) for k in range(8)]
    shadow = shadow_map(mesh, direction, radius)
    found = np.mean([shadow.shares(position, normal, turn) for turn in turns], axis=0)
    expected = traced(mesh, position, direction, radius)
    assert expected.min() < 0.05
    assert (expected > 0.95).mean() > 0.5
    # Where neither says penumbra they agree; inside it the width follows from the mean blocker alone.
    assert np.abs(found - expected).mean() < 0.02
    certain = ((expected == 0.0) | (expected == 1.0)) & (np.abs(found - expected) > 0.5)
    assert certain.mean() < 0.005


def test_shadows_begin_where_things_touch():
    wall = Quad((0.0, -2.0, 0.0), (0.0, 4.0, 0.0), (0.0, 0.0, 1.0))
    mesh = mesh_of(GROUND, wall)
    shadow = shadow_map(mesh, unit(1.0, 0.0, 1.0), np.radians(0.5))
    behind = np.float32([[-6.0 * TEXEL, y, 0.0] for y in np.linspace(-1.5, 1.5, 50)])
    before = behind * np.float32([-1.0, 1.0, 1.0])
    up = np.tile(np.float32([0.0, 0.0, 1.0]), (50, 1))
    turn = pattern_turns(np.arange(50), np.arange(50))
    assert shadow.shares(behind, up, turn).max() < 0.05
    assert shadow.shares(before, up, turn).min() > 0.95


@pytest.mark.parametrize("radius_deg", [0.25, 3.0, 8.0])
def test_a_ball_does_not_shadow_the_side_that_faces_the_light(radius_deg):
    mesh, direction = ball(), unit(0.3, 0.5, 0.7)
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(4000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal[normal @ direction > 0.15].astype(np.float32)
    turn = pattern_turns(np.arange(len(normal)), np.arange(len(normal)))
    found = shadow_map(mesh, direction, np.radians(radius_deg)).shares(normal, normal, turn)
    assert (found > 0.99).mean() > 0.99
    away = -normal
    assert shadow_map(mesh, direction, 0.01).shares(away, away, turn).max() == 0.0


def test_level_ground_does_not_shadow_itself_under_low_light():
    mesh = mesh_of(GROUND)
    position, normal = on_ground(2000)
    turn = pattern_turns(np.arange(2000), np.arange(2000))
    for height in (0.9, 0.4, 0.2, 0.1):
        shadow = shadow_map(mesh, unit(1.0, 0.4, height), np.radians(4.0))
        assert (shadow.shares(position, normal, turn) == 1.0).mean() > 0.999, height

"""Ambient occlusion, where the truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.textures.surface_occlusion import bake_occlusion, cosine_directions
from support.atlas_box import atlas_box

BOX = atlas_box(32)


def above(threshold: float):
    """Return visibility that is blocked in all directions higher than `threshold`."""

    def secondary(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        blocked = (direction[:, 2:] > threshold).astype(np.float32)
        return blocked, np.ones_like(blocked)

    return secondary


def test_directions_are_unit_and_their_mean_is_two_thirds_of_the_normal():
    normals = np.random.default_rng(1).normal(size=(20, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    found = cosine_directions(normals, 256)
    assert np.allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-5)
    assert ((found * normals[:, None]).sum(-1) > 0.0).all()
    assert np.allclose(found.mean(axis=1), 2.0 / 3.0 * normals, atol=0.02)


def test_what_blocks_the_upper_half_takes_all_from_the_top_and_half_from_the_sides():
    found = bake_occlusion(BOX, above(0.0), origin_offset=0.0, num_points=10_000, num_rays=64)
    height = BOX.texel_normals[:, 2]
    assert found[height > 0.5].max() == 0.0
    assert found[height < -0.5].min() == 1.0
    assert abs(found[np.abs(height) < 0.5].mean() - 0.5) < 0.01


def test_unmeasured_texels_take_the_value_of_neighbours_that_face_their_way():
    full = bake_occlusion(BOX, above(0.3), origin_offset=0.0, num_points=10_000, num_rays=64)
    few = bake_occlusion(BOX, above(0.3), origin_offset=0.0, num_points=120, num_rays=64)
    assert few.shape == full.shape
    assert np.abs(few - full).max() < 0.08


def test_rays_start_above_the_surface():
    seen = []

    def secondary(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.append(origin)
        return np.zeros((len(origin), 1), np.float32), np.ones((len(origin), 1), np.float32)

    bake_occlusion(BOX, secondary, origin_offset=0.25, num_points=10_000, num_rays=2)
    wanted = BOX.positions + 0.25 * BOX.texel_normals
    assert np.allclose(np.concatenate(seen)[::2], wanted, atol=1e-6)


def test_a_single_texel_can_be_measured():
    one = replace(
        BOX,
        texel_index=BOX.texel_index[:1],
        positions=BOX.positions[:1],
        texel_normals=np.float32([[0.0, 0.0, 1.0]]),
    )
    found = bake_occlusion(one, above(2.0), origin_offset=0.0, num_points=1, num_rays=4)
    assert found.tolist() == pytest.approx([1.0])

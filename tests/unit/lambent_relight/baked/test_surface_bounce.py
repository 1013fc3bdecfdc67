"""Light between the places of a surface where it was baked."""

import numpy as np
import pytest
from lambent_relight.baked.mesh import AtlasMesh
from lambent_relight.baked.scene import baked_scene
from lambent_relight.baked.surface_bounce import SurfaceBlocks
from support.baked_bundle import SCENE, baked_transport


@pytest.fixture(scope="module")
def blocks(tmp_path_factory):
    transport, mesh = baked_transport(SCENE, 16, tmp_path_factory.mktemp("blocks") / "rays")
    return SurfaceBlocks(baked_scene(AtlasMesh(**mesh), transport))


def on_triangles(blocks, count=400, seed=0):
    """Return positions [n, 3], face normals [n, 3] and uv [n, 2] of random points of the mesh."""
    mesh, rng = blocks._scene.mesh, np.random.default_rng(seed)
    face = mesh.faces[rng.integers(0, len(mesh.faces), count)]
    weight = rng.dirichlet(np.ones(3), count)[..., None]
    corners = mesh.vertices[face]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return (corners * weight).sum(axis=1), normal, (mesh.uv[face] * weight).sum(axis=1)


def test_what_is_linear_on_every_side_of_a_box_stays_linear_between_blocks(blocks):
    position, normal, uv = on_triangles(blocks)
    around = blocks.around(position, normal, uv)
    assert around.known.all()
    np.testing.assert_allclose(around.weight.sum(axis=1), 1.0, rtol=1e-5)
    # Inside a side all four blocks exist, each with its first texel in its corner; the last are repeated.
    size, place = blocks._scene.transport.size, blocks._scene.transport.texel_index[blocks.texel]
    whole = (place // size % 2 == 0) & (place % size % 2 == 0)
    inside = (around.weight.min(axis=1) > 1e-4) & whole[around.block].all(axis=1)
    assert inside.mean() > 0.5
    found = around.mean(blocks.position)
    np.testing.assert_allclose(found[inside], position[inside], atol=2e-3 * blocks.side)
    assert np.linalg.norm(found - position, axis=1).max() < 1.5 * blocks.side


def test_blocks_of_another_side_have_no_part(blocks):
    position, normal, uv = on_triangles(blocks, seed=1)
    around = blocks.around(position, normal, uv)
    facing = blocks._scene.normal[blocks.texel]
    # The mean of the normals of the blocks that take part is the point's own, exactly.
    np.testing.assert_allclose(around.mean(facing), normal, atol=1e-4)


def test_points_away_from_the_surface_or_facing_elsewhere_are_not_known(blocks):
    position, normal, uv = on_triangles(blocks, seed=2)
    lifted = position + 10.0 * blocks.side * normal
    assert not blocks.around(lifted, normal, uv).known.any()
    assert not blocks.around(position, -normal, uv).known.any()
    assert (blocks.around(lifted, normal, uv).mean(blocks.position) == 0.0).all()


def test_a_side_of_a_block_is_two_texels_of_the_surface(blocks):
    # Of 16 x 16 texels on every side, of both boxes: a mean of their squares.
    areas = [2.0 * 2.0] * 2 + [2.0 * 0.2] * 4 + [0.8 * 0.8] * 6
    assert blocks.side == pytest.approx(2.0 * np.sqrt(np.mean(areas)) / 16, rel=1e-3)

"""The base colour of an edited mesh keeps the pixels of the file's pictures."""

import numpy as np
import pytest
from lambent_asset.given_mesh import fine_albedo as module
from lambent_asset.given_mesh.fine_albedo import albedo_size, fine_albedo
from lambent_asset.given_mesh.glb_maps import Maps
from lambent_asset.mesh.atlas import Unwrapped
from support.given_glb import SQUARE, SQUARE_FACES, SQUARE_UV, given_mesh

RNG = np.random.default_rng(7)


def maps(picture=None, factor=(1.0, 1.0, 1.0)):
    return Maps(
        albedo_factor=np.float32(factor),
        perceptual_roughness_factor=1.0,
        metalness_factor=0.0,
        albedo=picture,
    )


def given(*materials):
    """Return one square per material; each has the whole of its picture."""
    count = len(materials)
    vertices = np.concatenate([SQUARE + np.float32([2.0 * k, 0.0, 0.0]) for k in range(count)])
    faces = np.concatenate([SQUARE_FACES.astype(np.int32) + 4 * k for k in range(count)])
    parts = {"part_of_face": np.repeat(np.arange(count, dtype=np.int32), 2), "has_uv": (True,) * count}
    return given_mesh(vertices, faces, np.tile(SQUARE_UV, (count, 1)), maps=materials, **parts)


def boxes(mesh, *places):
    """Return charts with each square in a box (left, top, side) of the atlas."""
    uv = np.concatenate([np.float32([left, top]) + side * SQUARE_UV for left, top, side in places])
    return Unwrapped(np.arange(len(mesh.vertices)), mesh.faces, uv.astype(np.float32))


def test_a_picture_on_its_own_atlas_comes_back_pixel_by_pixel(monkeypatch):
    monkeypatch.setattr(module, "ROWS_AT_ONCE", 7)
    picture = RNG.random((40, 40, 3)).astype(np.float32)
    mesh = given(maps(picture))
    found = fine_albedo(mesh, boxes(mesh, (0.0, 0.0, 1.0)), np.zeros((4, 4, 3), np.float32), 40)
    np.testing.assert_allclose(found, picture, atol=1e-4)


def test_parts_lie_on_their_charts_and_gutters_repeat_the_nearest():
    picture = RNG.random((16, 16, 3)).astype(np.float32)
    mesh = given(maps(picture), maps(factor=(0.1, 0.2, 0.3)))
    found = fine_albedo(
        mesh, boxes(mesh, (0.0, 0.0, 0.25), (0.5, 0.5, 0.25)), np.zeros((4, 4, 3), np.float32), 64
    )
    np.testing.assert_allclose(found[:16, :16], picture, atol=1e-4)
    np.testing.assert_allclose(found[32:48, 32:48], np.broadcast_to([0.1, 0.2, 0.3], (16, 16, 3)), atol=1e-6)
    np.testing.assert_allclose(found[:16, 20], picture[:, 15], atol=1e-4)
    np.testing.assert_allclose(found[60, 60], [0.1, 0.2, 0.3], atol=1e-6)


def test_parts_of_the_model_are_interpolated_and_do_not_repeat_at_the_border():
    ramp = np.broadcast_to(np.linspace(0.0, 1.0, 8, dtype=np.float32)[None, :, None], (8, 8, 3))
    mesh = given(None)
    found = fine_albedo(mesh, boxes(mesh, (0.0, 0.0, 1.0)), np.ascontiguousarray(ramp), 32)
    expected = np.clip((np.arange(32) + 0.5) / 4.0 - 0.5, 0.0, 7.0) / 7.0
    np.testing.assert_allclose(found[5, :, 1], expected, atol=1e-5)


def test_a_much_larger_picture_is_averaged_down():
    board = np.indices((64, 64)).sum(axis=0)[..., None] % 2 * np.uint8(255)
    mesh = given(maps(np.repeat(board, 3, axis=2).astype(np.uint8)))
    found = fine_albedo(mesh, boxes(mesh, (0.0, 0.0, 1.0)), np.zeros((4, 4, 3), np.float32), 16)
    np.testing.assert_allclose(found, 0.5, atol=1e-5)


@pytest.mark.parametrize(
    ("sides", "kept", "expected"),
    [
        (((100, 300), (200, 200)), True, 304),
        (((30, 40), (30, 40), (20, 5)), False, 64),
        (((4, 4),), True, 32),
        ((), True, 32),
        (((513, 2),), True, 512),
    ],
)
def test_the_size_is_that_of_the_pictures(sides, kept, expected):
    pictures = [maps(np.zeros((*side, 3), np.uint8)) for side in sides]
    assert albedo_size(given(None, maps(), *pictures), kept_uv=kept, least=32, most=512) == expected

"""Maps of a glTF material: texels where they are, factors, colour encoding, smaller versions."""

import numpy as np
import pytest
from lambent_asset.given_mesh.glb_file import read_glb
from lambent_asset.given_mesh.glb_maps import LEAST_ROUGHNESS, sampled
from lambent_core.colour import linear_from_srgb
from support.given_glb import GlbWriter, glb_file

RNG = np.random.default_rng(3)


def centres(height, width):
    row, column = np.mgrid[0:height, 0:width]
    return np.stack([(column + 0.5) / width, (row + 0.5) / height], axis=-1).reshape(-1, 2)


def material(tmp_path, pictures, **factors):
    def change(writer: GlbWriter) -> None:
        writer.mesh(material=writer.material(pictures, **factors))

    (maps,) = read_glb(glb_file(tmp_path / "a.glb", change)).maps
    return maps


def test_a_texel_is_looked_up_at_its_centre_and_pictures_repeat():
    picture = RNG.random((4, 6, 3)).astype(np.float32)
    places = centres(4, 6)
    np.testing.assert_allclose(sampled(picture, places).reshape(4, 6, 3), picture, atol=1e-6)
    away = places + np.array([2.0, -3.0])
    np.testing.assert_allclose(sampled(picture, away), sampled(picture, places), atol=1e-5)
    between = sampled(picture, np.array([[1.0 / 6.0, 0.5 / 4.0]]))
    np.testing.assert_allclose(between[0], 0.5 * (picture[0, 0] + picture[0, 1]), atol=1e-6)


def test_factors_multiply_and_colours_are_linear(tmp_path):
    colour, packed = RNG.integers(0, 256, (2, 4, 4, 3), dtype=np.uint8)
    maps = material(
        tmp_path,
        {"baseColorTexture": colour, "metallicRoughnessTexture": packed},
        baseColorFactor=[0.5, 1.0, 0.25, 1.0],
        roughnessFactor=0.5,
        metallicFactor=0.75,
    )
    places = centres(4, 4)
    expected = linear_from_srgb(colour.reshape(-1, 3) / 255.0) * [0.5, 1.0, 0.25]
    np.testing.assert_allclose(maps.albedo_at(places), expected, atol=1e-6)
    roughness, metalness = maps.gloss_at(places)
    values = packed.reshape(-1, 3) / 255.0
    np.testing.assert_allclose(roughness[:, 0], np.maximum(0.5 * values[:, 1], LEAST_ROUGHNESS), atol=1e-6)
    np.testing.assert_allclose(metalness[:, 0], 0.75 * values[:, 2], atol=1e-6)
    assert maps.normal_at(places) is None


def test_without_pictures_factors_are_the_material_and_gltfs_defaults_hold(tmp_path):
    maps = material(tmp_path, {}, baseColorFactor=[0.2, 0.3, 0.4, 1.0])
    np.testing.assert_allclose(maps.albedo_at(centres(1, 2)), [[0.2, 0.3, 0.4]] * 2)
    roughness, metalness = maps.gloss_at(centres(1, 1))
    assert (roughness.item(), metalness.item()) == (1.0, 1.0)


def test_the_scale_of_a_normal_map_bends_and_keeps_z(tmp_path):
    def change(writer: GlbWriter) -> None:
        number = writer.material({"normalTexture": np.full((2, 2, 3), (255, 128, 255), np.uint8)})
        writer.document["materials"][number]["normalTexture"]["scale"] = 0.5
        writer.mesh(material=number)

    (maps,) = read_glb(glb_file(tmp_path / "a.glb", change)).maps
    np.testing.assert_allclose(maps.normal_at(np.array([[0.5, 0.5]])), [[0.5, 0.002, 1.0]], atol=1e-3)


def test_a_picture_much_larger_than_the_atlas_is_averaged_in_linear_light(tmp_path):
    board = np.indices((64, 64)).sum(axis=0) % 2 * np.uint8(255)
    maps = material(tmp_path, {"baseColorTexture": np.repeat(board[..., None], 3, axis=2).astype(np.uint8)})
    fitting = maps.reduced(16)
    assert fitting.albedo.shape == (16, 16, 3)
    np.testing.assert_allclose(fitting.albedo, 0.5, atol=1e-6)
    assert maps.reduced(40).albedo.shape == (64, 64, 3)


def test_levels_are_averaged_as_what_they_stand_for_and_take_a_byte(tmp_path):
    colour, bent = RNG.integers(0, 256, (2, 12, 8, 3), dtype=np.uint8)
    maps = material(tmp_path, {"baseColorTexture": colour, "normalTexture": bent})
    assert maps.albedo.dtype == maps.normal.dtype == np.uint8
    fitting = maps.reduced(4)
    blocks = linear_from_srgb(colour / 255.0).reshape(6, 2, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(fitting.albedo, blocks, atol=1e-6)
    blocks = (2.0 * (bent / 255.0) - 1.0).reshape(6, 2, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(fitting.normal, blocks, atol=1e-6)
    assert fitting.num_pixels == 2 * 6 * 4


def test_pictures_without_texture_coordinates_are_no_material(tmp_path):
    def change(writer: GlbWriter) -> None:
        number = writer.material({"baseColorTexture": np.zeros((2, 2, 3), np.uint8)})
        writer.mesh(uv=None, material=number)

    mesh = read_glb(glb_file(tmp_path / "a.glb", change))
    assert mesh.maps == (None,)
    assert mesh.has_uv == (False,)


@pytest.mark.parametrize("factor", [float("nan"), "much"])
def test_factors_that_are_no_numbers_are_refused(tmp_path, factor):
    with pytest.raises(Exception, match=r"mesh_file\.unreadable"):
        material(tmp_path, {}, roughnessFactor=factor)

"""Albedo textures from photographs of a printed box."""

import weakref
from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.textures import photo_albedo
from lambent_asset.textures.photo_albedo import albedo_texture, automatic_size, fine_texels
from support.atlas_box import SIZES, atlas_box
from support.printed_box import INK, PAPER, around, open_scene, photograph, sky, stripes

SIZE = 256
BOX = atlas_box(64)
MODEL = np.broadcast_to(0.5 * (PAPER + INK), (len(BOX.texel_index), 3))
"""What a model knows that cannot tell the stripes apart."""
SCENE = open_scene(BOX, MODEL)


@pytest.fixture(scope="module")
def views():
    return [photograph(BOX, SCENE, camera, stripes, sky()) for camera in around(8, 200)]


@pytest.fixture(scope="module")
def fine():
    return fine_texels(BOX, SIZE)


def made(views, scene=SCENE, size=SIZE):
    return albedo_texture(BOX, scene, size, lambda: views, "sky", sky())


def errors(texture, fine, paint=stripes) -> np.ndarray:
    """Return the mean error of the channels of texels that are not at an edge of the box."""
    inside = np.sort((SIZES / 2.0 - np.abs(fine.positions)), axis=1)[:, 1] > 0.2
    found = np.abs(texture.reshape(-1, 3)[fine.index] - paint(fine.positions)).mean(axis=1)
    return found[inside]


def test_fine_texels_lie_on_the_surface_whatever_the_size(fine):
    outermost = np.abs(fine.positions / (SIZES / 2.0)).max(axis=1)
    np.testing.assert_allclose(outermost, 1.0, atol=1e-4)
    # The same places in units of the atlas as the coarse texels have.
    assert len(fine.index) / SIZE**2 == pytest.approx(len(BOX.texel_index) / BOX.size**2, rel=0.05)


def test_texels_are_moved_with_the_model_s_surface():
    moved = replace(BOX, positions=BOX.positions + np.float32(0.05) * BOX.texel_normals)
    found = fine_texels(moved, SIZE).positions
    away = np.abs(found) - np.abs(fine_texels(BOX, SIZE).positions)
    np.testing.assert_allclose(np.abs(away).max(axis=1), 0.05, atol=1e-4)


def test_the_texture_has_the_print_that_the_model_lacks(views, fine):
    texture, figures = made(views)
    found = errors(texture, fine)
    assert figures["texture_photograph_share"] > 0.8
    # At the edges of stripes a texel shows both sides; inside them only the level is uncertain.
    assert np.median(found) < 0.02
    assert found.mean() < 0.25 * np.abs(stripes(fine.positions) - MODEL[0]).mean()


def test_gutters_repeat_the_chart_beside_them(views, fine):
    texture, _ = made(views)
    covered = np.zeros(SIZE * SIZE, bool)
    covered[fine.index] = True
    known = {tuple(value) for value in texture.reshape(-1, 3)[covered]}
    assert {tuple(value) for value in texture.reshape(-1, 3)[~covered]} <= known


def test_what_no_photograph_shows_is_the_model_s(views, fine):
    above = [view for view in views if view.camera.position[2] > 0.0]
    texture, _ = made(above)
    bottom = fine.positions[:, 2] < -1.49
    np.testing.assert_allclose(
        texture.reshape(-1, 3)[fine.index][bottom], np.tile(MODEL[0], (bottom.sum(), 1)), atol=1e-5
    )
    top = fine.positions[:, 2] > 1.49
    assert np.median(np.abs(texture.reshape(-1, 3)[fine.index] - stripes(fine.positions))[top]) < 0.03


def test_without_photographs_the_texture_is_the_model_s():
    texture, figures = made([])
    np.testing.assert_allclose(texture, np.broadcast_to(MODEL[0], texture.shape), atol=1e-5)
    assert figures["texture_photograph_share"] == 0.0


def test_broad_colours_stay_the_model_s(views, fine):
    brown = np.broadcast_to(MODEL * np.float32([1.2, 1.0, 0.7]), MODEL.shape)
    texture, _ = made(views, open_scene(BOX, brown))
    mean = texture.reshape(-1, 3)[fine.index].mean(axis=0)
    np.testing.assert_allclose(mean, brown[0], rtol=0.03)


def dark(positions):
    return 0.3 * stripes(positions)


def glossy_box():
    """Return a glossy, dark box, which reflects as much as it scatters, and its photographs."""
    glossy = open_scene(BOX, 0.3 * MODEL, roughness=0.5)
    return glossy, [photograph(BOX, glossy, camera, dark, sky()) for camera in around(8, 200)]


def test_reflections_are_not_printed(fine):
    """Without the reflection, contrast would be halved."""
    glossy, shown = glossy_box()
    texture, _ = made(shown, glossy)
    assert np.median(errors(texture, fine, dark)) < 0.02


def test_a_metal_s_colour_is_its_reflectance(fine):
    metal = open_scene(BOX, MODEL, roughness=0.6, metal=1.0)
    shown = [photograph(BOX, metal, camera, stripes, sky()) for camera in around(8, 200)]
    texture, _ = made(shown, metal)
    assert np.median(errors(texture, fine)) < 0.02


def test_a_light_that_turns_with_the_camera_is_turned_back(fine):
    shown = []
    for camera in around(8, 200):
        x, y = camera.camera_to_world[:2, 2] / np.linalg.norm(camera.camera_to_world[:2, 2])
        turn = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
        shown.append(photograph(BOX, SCENE, camera, stripes, sky(), turn))
    texture, _ = made(shown)
    assert np.median(errors(texture, fine)) < 0.02


def test_bad_photographs_are_outvoted(views, fine):
    good = errors(made(views)[0], fine)

    def with_image(view, image):
        return replace(view, images={"sky": image})

    def stained(view):
        image = view.images["sky"].copy()
        image[60:120, 70:130, :3] *= 4.0
        return with_image(view, image)

    def blurred(view):
        image = view.images["sky"]
        return with_image(view, np.mean([np.roll(image, k, axis=1) for k in range(-4, 5)], axis=0))

    def shifted(view):
        return with_image(view, np.roll(view.images["sky"], 12, axis=0))

    for harm in (stained, blurred, shifted):
        found = errors(made([harm(views[0]), *views[1:]])[0], fine)
        alone = errors(made([harm(view) for view in views])[0], fine)
        assert found.mean() < good.mean() + 0.25 * (alone.mean() - good.mean()), harm.__name__


def test_clipped_pixels_are_left_to_other_photographs(views, fine):
    flags = np.zeros((200, 200, 3), bool)
    flags[:, 100:] = True
    image = np.where(flags.any(axis=-1, keepdims=True), 1.0, views[0].images["sky"])
    image[..., 3] = views[0].images["sky"][..., 3]
    clipped = replace(views[0], images={"sky": image.astype(np.float32)}, clipped={"sky": flags})
    found = errors(made([clipped, *views[1:]])[0], fine)
    assert found.mean() < errors(made(views)[0], fine).mean() + 0.005


@pytest.mark.parametrize(
    ("pixels", "tier", "expected"),
    [
        (0, "full", 1024),
        (200, "full", 1024),
        (2048, "full", 2048),
        (3000, "full", 4096),
        # No larger than a tier allows.
        *((50_000, tier, size) for tier, size in (("lite", 1024), ("full", 4096), ("none", 4096))),
    ],
)
def test_atlases_are_as_fine_as_the_photographs(pixels, tier, expected):
    """The photographs have so many pixels along a side of the atlas; 0: unknown."""
    pixel = BOX.texel_size * BOX.size / pixels if pixels else 0.0
    assert automatic_size(BOX, pixel, tier) == expected


def test_atlases_are_no_coarser_than_transport():
    assert automatic_size(replace(BOX, size=3000), 0.0, "lite") == 4096


def test_each_photograph_is_opened_twice_and_one_at_a_time(views):
    opened, alive = [], []

    def photographs():
        opened.append(0)
        for view in views:
            opened[-1] += 1
            # The one before must be gone when the next is read: two may be all the memory there is.
            assert all(reference() is None for reference in alive)
            image = view.images["sky"].copy()
            alive.append(weakref.ref(image))
            copied = replace(view, images={"sky": image})
            del image
            yield copied
            del copied

    calls = []
    photo_albedo.albedo_texture(
        BOX, SCENE, 128, photographs, "sky", sky(), lambda: calls.append(tuple(opened))
    )
    assert opened == [len(views)] * 2
    # After the k-th photograph no later one has been read.
    assert calls == [(k + 1,) for k in range(8)] + [(8, k + 1) for k in range(8)]


def test_a_photograph_that_is_darker_than_its_reflections_is_not_printed_black(fine):
    """Light that was found too bright would leave less than nothing for albedo."""
    glossy, shown = glossy_box()
    for view in shown:
        view.images["sky"][..., :3] *= 0.3
    texture, _ = made(shown, glossy)
    found = texture.reshape(-1, 3)[fine.index]
    assert (found > 0.02 * 0.3 * MODEL[0]).all(axis=1).mean() > 0.99

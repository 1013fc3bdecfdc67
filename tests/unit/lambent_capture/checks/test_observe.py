"""Measurements of a single picture: sizes, masks, clipping, sharpness, thumbnails; in every kind of file."""

import base64
import io

import numpy as np
import pytest
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.observe import PORTRAIT_SIDE, fine_contrast, observe
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.pictures.picture import box_averaged
from lambent_capture.pictures.pictures import read_picture
from lambent_capture.problems import Problems
from lambent_core.exr import write_exr
from lambent_proto.v1 import scene_pb2
from PIL import Image
from scipy.ndimage import gaussian_filter
from support.captures import look_at, write_blender, write_tensoir

LIMITS = CaptureLimits()


def frame_of(folder, name, pixels, **fields):
    """Return a manifest of one frame with this picture."""
    if name.endswith(".exr"):
        write_exr(folder / name, {letter: pixels[..., i] for i, letter in enumerate("RGBA")})
    else:
        Image.fromarray(pixels).save(folder / name)
    height, width = pixels.shape[:2]
    camera = scene_pb2.Camera(
        width=width, height=height, focal_x=width, focal_y=width, camera_to_world=look_at(np.ones(3)).ravel()
    )
    image = scene_pb2.Image(light="day", path=name)
    frame = scene_pb2.Frame(name="a", split="SPLIT_TRAIN", camera=camera, images=[image], **fields)
    return scene_pb2.SceneManifest(lights=["day"], frames=[frame])


def test_every_frame_is_seen_once_and_every_training_light_of_it(tmp_path):
    folder = write_tensoir(tmp_path, lights=("sunset", "snow"))
    manifest = collect_scene(folder, None, Problems())
    announced = []
    seen = observe(folder, manifest, LIMITS, announced.append)
    assert [each.frame.name for each in seen] == [frame.name for frame in manifest.frames]
    assert all([picture.light for picture in each.pictures] == manifest.lights for each in seen)
    assert len(announced) == 14
    assert seen[0].mask.mean() == pytest.approx(0.25)
    assert seen[0].has_mask


def test_a_large_jpeg_is_decoded_small(tmp_path):
    Image.fromarray(np.full((900, 1600, 3), 77, dtype=np.uint8)).save(tmp_path / "a.jpg")
    picture = read_picture(tmp_path / "a.jpg", side=200)
    colours, alpha = picture.srgb(), picture.coverage()
    assert colours.shape == (112, 200, 3)
    assert (alpha == 1.0).all()
    assert not picture.is_linear
    assert np.abs(colours.astype(int) - 77).max() <= 2


def test_transparent_pixels_do_not_bleed_into_the_reduced_picture(tmp_path):
    pixels = np.zeros((64, 64, 4), dtype=np.uint8)
    pixels[..., :3] = (255, 0, 0)
    pixels[:, 30:] = (0, 90, 0, 255)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    picture = read_picture(tmp_path / "a.png", side=16)
    colours, alpha = picture.srgb(), picture.coverage()
    assert alpha[0, 7] == pytest.approx(0.5, abs=0.01)
    assert colours[0, 7] == pytest.approx([0, 90, 0], abs=1)


def test_sixteen_bit_grey_is_scaled_and_not_clipped(tmp_path):
    Image.fromarray(np.full((8, 8), 0x4000, dtype=np.uint16)).save(tmp_path / "a.png")
    assert read_picture(tmp_path / "a.png", side=8).srgb()[0, 0].tolist() == [64, 64, 64]


def test_luminance_is_linear_and_in_the_exposure_of_the_first_frame(tmp_path):
    manifest = frame_of(tmp_path, "a.png", np.full((16, 16, 3), 188, dtype=np.uint8), exposure=0.5)
    (seen,) = observe(tmp_path, manifest, LIMITS)
    assert seen.pictures[0].luminance == pytest.approx(np.full((16, 16), 0.25), abs=0.005)
    assert not seen.has_mask


def test_linear_pictures_are_read_as_they_are_and_cannot_be_clipped(tmp_path):
    pixels = np.full((16, 16, 4), 3.0, dtype=np.float32)
    pixels[:, 8:, 3] = 0.0
    (seen,) = observe(tmp_path, frame_of(tmp_path, "a.exr", pixels), LIMITS)
    assert seen.pictures[0].luminance[:, :8] == pytest.approx(3.0 * np.ones((16, 8)))
    assert seen.pictures[0].clipped_share == 0.0
    assert seen.mask[0].tolist() == [True] * 8 + [False] * 8


def test_a_mask_file_says_what_the_object_is(tmp_path):
    manifest = frame_of(tmp_path, "a.png", np.full((16, 16, 3), 90, dtype=np.uint8), mask="m.png")
    mask = np.zeros((16, 16), dtype=np.uint8)
    mask[4:12] = 255
    Image.fromarray(mask).save(tmp_path / "m.png")
    (seen,) = observe(tmp_path, manifest, LIMITS)
    assert seen.mask.sum() == 128


def test_clipping_is_a_share_of_the_object(tmp_path):
    pixels = np.full((20, 20, 4), 100, dtype=np.uint8)
    pixels[..., 3] = 0
    pixels[:10, :, 3] = 255
    pixels[:10, :5, 0] = 254
    pixels[10:, :, :3] = 255
    (seen,) = observe(tmp_path, frame_of(tmp_path, "a.png", pixels), LIMITS)
    assert seen.pictures[0].clipped_share == pytest.approx(0.25)


def textured() -> np.ndarray:
    return gaussian_filter(np.random.default_rng(0).random((96, 96)), 0.8)


def test_blur_takes_away_fine_contrast_and_brightness_does_not():
    alpha = np.zeros((96, 96))
    alpha[10:80, 10:80] = 1.0
    sharp = fine_contrast(textured(), alpha)
    assert fine_contrast(gaussian_filter(textured(), 1.2), alpha) < 0.6 * sharp
    assert fine_contrast(0.3 * textured() + 0.1, alpha) == pytest.approx(sharp)


def test_the_outline_of_the_mask_is_no_detail():
    alpha = np.zeros((96, 96))
    alpha[10:80, 10:80] = 1.0
    bright_outside = np.where(alpha > 0.5, textured(), 5.0)
    assert fine_contrast(bright_outside, alpha) == pytest.approx(fine_contrast(textured(), alpha), rel=0.02)


def test_what_has_no_contrast_has_no_sharpness():
    assert fine_contrast(np.full((96, 96), 0.5), np.ones((96, 96))) == 0.0
    assert fine_contrast(textured(), np.zeros((96, 96))) == 0.0


def test_values_are_averaged_over_new_pixels():
    assert box_averaged(np.arange(16, dtype=np.float32).reshape(4, 4), (2, 2)).tolist() == [
        [2.5, 4.5],
        [10.5, 12.5],
    ]


def test_the_first_frame_has_a_portrait_without_an_outline(tmp_path):
    pixels = np.full((300, 400, 4), (20, 160, 40, 255), dtype=np.uint8)
    pixels[:, :200, 3] = 0
    (seen,) = observe(tmp_path, frame_of(tmp_path, "a.png", pixels), LIMITS)
    with Image.open(io.BytesIO(base64.b64decode(seen.portrait))) as image:
        shown = np.asarray(image.convert("RGB")).astype(int)
    assert max(shown.shape) == PORTRAIT_SIDE
    # The object's green and the grey behind it, and nothing else.
    for colour in ((20, 160, 40), (232, 232, 232)):
        assert (np.abs(shown - np.array(colour)).max(axis=-1) < 24).mean() > 0.47
    manifest = collect_scene(write_tensoir(tmp_path / "more"), None, Problems())
    assert [bool(each.portrait) for each in observe(tmp_path / "more", manifest, LIMITS)][:3] == [
        True,
        False,
        False,
    ]


def test_a_thumbnail_is_a_small_jpeg_with_the_outline_of_the_mask(tmp_path):
    folder = write_blender(tmp_path)
    (seen, *_) = observe(folder, collect_scene(folder, None, Problems()), LIMITS)
    image = Image.open(io.BytesIO(base64.b64decode(seen.thumbnail)))
    assert (image.format, image.size) == ("JPEG", (12, 12))
    red, green, blue = np.asarray(image).astype(int)[3, 6]
    assert red > green
    assert blue > green

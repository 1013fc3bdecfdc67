"""Photographs that let in different amounts of light are brought to the first one's."""

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.load import load_scene
from lambent_capture.scenes.exposure import Exposure, exif_exposure, stated_exposure
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from support.captures import edit_frame, photograph, write_blender

TIME, F_NUMBER, ISO = 0x829A, 0x829D, 0x8827


def write_photograph(path, pixels, **settings):
    """Write a JPEG with EXIF, as a camera does."""
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({TIME: settings["time"], F_NUMBER: settings["f"], ISO: settings["iso"]})
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, exif=exif, quality=100, subsampling=0)


def rational(numerator, denominator=1):
    return IFDRational(numerator, denominator)


def camera_capture(folder, exposures):
    """Write a capture whose photographs carry EXIF; None leaves it out of one."""
    write_blender(folder, num_train=len(exposures), num_test=0)
    for index, exposure in enumerate(exposures):
        (folder / "train" / f"r_{index}.png").unlink()
        path = folder / "train" / f"r_{index}.jpg"
        grey = photograph(index)[..., :3] // 2 + 60
        if exposure is None:
            Image.fromarray(grey).save(path, quality=100)
        else:
            write_photograph(path, grey, **exposure)
    return folder


BASE = {"time": rational(1, 100), "f": rational(8), "iso": 100}


def factors(folder):
    return [frame.exposure for frame in describe_scene(folder).frames]


@pytest.mark.parametrize(
    ("change", "factor"),
    [
        ({"time": rational(1, 200)}, 2.0),
        ({"f": rational(4)}, 0.25),
        ({"iso": 400}, 0.25),
        ({"time": rational(1, 25), "iso": 25}, 1.0),
        ({"time": rational(1, 100) * 1.004}, 1.0),
    ],
    ids=[
        "half the time",
        "two stops wider",
        "two stops more sensitive",
        "evened out by the camera",
        "rounding",
    ],
)
def test_the_factor_undoes_what_the_camera_changed(tmp_path, change, factor):
    folder = camera_capture(tmp_path, [BASE, BASE, {**BASE, **change}, BASE])
    assert factors(folder) == pytest.approx([1.0, 1.0, factor, 1.0], rel=1e-3)


def test_the_factor_is_applied_to_linear_light_on_loading(tmp_path):
    bright = camera_capture(tmp_path / "a", [BASE] * 4)
    dark = camera_capture(tmp_path / "b", [BASE, BASE, {**BASE, "time": rational(1, 300)}, BASE])
    one, other = (load_scene(folder, describe_scene(folder), max_side=64) for folder in (bright, dark))
    np.testing.assert_allclose(
        other.train[2].images["capture"][..., :3], 3.0 * one.train[2].images["capture"][..., :3], rtol=1e-5
    )
    np.testing.assert_array_equal(other.train[1].images["capture"], one.train[1].images["capture"])


def test_photographs_without_exif_are_left_alone(tmp_path):
    assert factors(camera_capture(tmp_path, [None] * 4)) == [1.0] * 4


def test_one_photograph_without_exif_leaves_all_alone_and_is_named(tmp_path):
    folder = camera_capture(tmp_path, [BASE, BASE, None, {**BASE, "iso": 400}])
    assert factors(folder) == [1.0] * 4
    finding = next(f for f in inspect_files(folder).report.findings if f.code == "scene.exposure_incomplete")
    assert finding.subject == "train_r_2"


def test_the_capture_may_state_exposures_itself(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    for index in range(5):
        edit_frame(folder, index, exposure_time=0.01 * (index + 1), iso=100)
    assert factors(folder) == pytest.approx([1.0, 1 / 2, 1 / 3, 1 / 4, 1 / 5])


def test_the_capture_s_own_words_go_before_exif(tmp_path):
    folder = camera_capture(tmp_path, [BASE, {**BASE, "iso": 800}, BASE, BASE])
    for index in range(4):
        edit_frame(folder, index, exposure_time=0.5)
    assert factors(folder) == [1.0] * 4


@pytest.mark.parametrize(
    "settings",
    [{}, {"exposure_time": 0}, {"exposure_time": "long"}, {"iso": float("nan")}, {"f_number": -2.0}],
)
def test_settings_that_make_no_sense_state_nothing(settings):
    assert stated_exposure(settings) is None


def test_light_is_proportional_to_time_and_sensitivity_and_falls_with_the_square_of_the_f_number():
    assert Exposure(time_s=0.02, f_number=4.0, iso=200.0).light == pytest.approx(0.02 * 200 / 16)


@pytest.mark.parametrize("time", [rational(0, 1), rational(1, 0)])
def test_exif_without_a_time_keeps_what_else_it_says(tmp_path, time):
    write_photograph(tmp_path / "a.jpg", photograph(0)[..., :3], time=time, f=rational(8), iso=100)
    assert exif_exposure(tmp_path / "a.jpg") == Exposure(f_number=8.0, iso=100.0)


def test_damaged_exif_tells_nothing(tmp_path):
    write_photograph(tmp_path / "a.jpg", photograph(0)[..., :3], time=rational(1, 9), f=rational(8), iso=100)
    data = (tmp_path / "a.jpg").read_bytes()
    start = data.index(b"Exif\0\0")
    (tmp_path / "a.jpg").write_bytes(data[: start + 6] + b"\xff" * 40 + data[start + 46 :])
    assert exif_exposure(tmp_path / "a.jpg") is None


def test_heic_photographs_are_read_with_their_exposure(tmp_path):
    import pillow_heif

    pillow_heif.register_heif_opener()
    folder = camera_capture(tmp_path, [BASE] * 4)
    for index in range(4):
        path = folder / "train" / f"r_{index}.jpg"
        exif = Image.Exif()
        time = rational(1, 100 * (index + 1))
        exif.get_ifd(0x8769).update({TIME: time, F_NUMBER: rational(8), ISO: 100})
        with Image.open(path) as image:
            image.resize((64, 64)).save(path.with_suffix(".heic"), exif=exif.tobytes(), quality=90)
        path.unlink()
    manifest = describe_scene(folder)
    assert manifest.frames[0].images[0].path == "train/r_0.heic"
    assert [frame.exposure for frame in manifest.frames] == pytest.approx([1.0, 2.0, 3.0, 4.0])
    assert load_scene(folder, manifest, max_side=64).train[0].images["capture"].shape == (64, 64, 4)

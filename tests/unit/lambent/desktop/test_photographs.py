"""Photographs for the desktop viewer: which are found, where they lie in a window, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest
from lambent.desktop.photographs import find_photographs, fitted, photograph_index, resampled
from lambent.errors import UsageProblemError
from lambent_relight import cameras_json, turntable
from PIL import Image

CAMERAS = turntable(2, radius=4.0, width=8, height=8)
BUNDLE = SimpleNamespace(manifest=SimpleNamespace(train_lights=["sky", "sun"]), cameras=lambda: CAMERAS)


def write_view(folder, camera, light="sky"):
    folder.mkdir(exist_ok=True)
    Image.new("RGBA", (8, 8)).save(folder / f"rgba_{light}.png")
    numbers = ",".join(str(value) for value in camera.ravel())
    (folder / "metadata.json").write_text(
        f'{{"imw": 8, "imh": 8, "cam_angle_x": 0.7, "cam_transform_mat": "{numbers}"}}'
    )


def test_photographs_are_found_by_the_names_of_cameras(tmp_path):
    Image.new("RGB", (4, 4)).save(tmp_path / f"{CAMERAS[0].name}.jpg")
    write_view(tmp_path / CAMERAS[1].name, CAMERAS[1].camera_to_world, "sun")
    write_view(tmp_path / "train_000", CAMERAS[0].camera_to_world)
    (extra,) = turntable(1, radius=3.0, width=4, height=4)
    (tmp_path / "cameras.json").write_text(cameras_json([extra]).replace(extra.name, "own"))
    Image.new("RGB", (4, 4)).save(tmp_path / "own.png")
    found = {(photograph.name, photograph.light) for photograph in find_photographs(BUNDLE, tmp_path)}
    assert found == {(CAMERAS[0].name, "sky"), (CAMERAS[1].name, "sun"), ("train_000", "sky"), ("own", "sky")}


def test_cameras_of_another_world_and_folders_without_photographs_are_refused(tmp_path):
    with pytest.raises(UsageProblemError, match=r"view\.no_photographs"):
        find_photographs(BUNDLE, tmp_path)
    view = tmp_path / CAMERAS[0].name
    pose = CAMERAS[0].camera_to_world.copy()
    write_view(view, pose)
    (found,) = find_photographs(BUNDLE, tmp_path)
    assert photograph_index([found], found.name) == 0
    with pytest.raises(UsageProblemError, match=r"view\.no_photograph"):
        photograph_index([found], "another")
    pose[0, 3] += 0.5
    write_view(view, pose)
    with pytest.raises(UsageProblemError, match=r"view\.other_world"):
        find_photographs(BUNDLE, tmp_path)
    (view / "metadata.json").write_text("{}")
    with pytest.raises(UsageProblemError, match=r"view\.bad_camera"):
        find_photographs(BUNDLE, tmp_path)


def test_a_fitted_camera_sees_in_the_photographs_place_what_its_own_saw():
    camera = CAMERAS[0].resized(8, 6)
    wide, (rows, columns) = fitted(camera, 40, 12)
    assert (rows, columns) == (slice(0, 12), slice(12, 28))
    own = camera.resized(16, 12).rays()[1].reshape(12, 16, 3)
    np.testing.assert_allclose(wide.rays()[1].reshape(12, 40, 3)[rows, columns], own, atol=1e-6)


def test_resampling_keeps_means_and_takes_no_colour_from_where_nothing_is():
    pixels = np.zeros((4, 4, 4), np.float32)
    pixels[:, :2] = (0.2, 0.4, 0.6, 1.0)
    pixels[:, 2:, :3] = 9.0
    small = resampled(pixels, 1, 1)[0, 0]
    np.testing.assert_allclose(small, (0.2, 0.4, 0.6, 0.5), atol=1e-6)
    large = resampled(pixels, 16, 16)
    shown = large[..., 3] > 1e-3
    np.testing.assert_allclose(
        large[shown][:, :3], np.broadcast_to((0.2, 0.4, 0.6), large[shown][:, :3].shape), atol=1e-5
    )

"""Photographs are a layout of their own: first without cameras, then with those that were found."""

import json

import numpy as np
import pytest
from lambent_capture.layouts import photographs
from lambent_capture.layouts.detect import collect_scene, describe_scene, detect_layout
from lambent_capture.layouts.photographs import FoundCameras, read_found_cameras
from lambent_capture.problems import Problems
from lambent_core.errors import SceneRefusedError, WorkerError
from support.captures import look_at, save

NAMES = ("a.jpg", "b.jpg", "more/c.jpg", "more/d.jpg")


def write_photographs(folder, inside=""):
    for number, name in enumerate(NAMES):
        save(folder / inside / name, np.full((12, 16, 3), 30 + 40 * number, dtype=np.uint8))
    return folder


def write_cameras(folder, names=NAMES, up=None):
    """Write cameras around the origin as COLMAP's text, one degree of longitude after the other."""
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 16 12 20 20 8 6\n")
    lines = []
    for number, name in enumerate(names):
        angle = 2.0 * np.pi * number / len(names)
        pose = look_at(4.0 * np.array([np.cos(angle), np.sin(angle), 0.5]))
        pose[:3, 1:3] *= -1.0
        rotation, position = pose[:3, :3].T, pose[:3, 3]
        w, x, y, z = quaternion(rotation)
        t = -rotation @ position
        lines += [f"{number + 1} {w} {x} {y} {z} {t[0]} {t[1]} {t[2]} 1 {name}", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    found = FoundCameras(inputs="hash", photographs=len(NAMES), up=up)
    (folder / "cameras.json").write_text(found.model_dump_json())
    return folder


def quaternion(rotation):
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return w, x, y, z


def test_a_folder_of_pictures_is_photographs_whatever_lies_beside_them(tmp_path):
    write_photographs(tmp_path / "phone")
    (tmp_path / "phone" / "notes.txt").write_text("kitchen")
    assert detect_layout(tmp_path / "phone") == "photographs"
    assert detect_layout(write_photographs(tmp_path / "other", inside="images")) == "photographs"
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / ".hidden.jpg").write_bytes(b"")
    assert detect_layout(tmp_path / "empty") is None


def test_without_cameras_they_have_frames_and_no_box(tmp_path):
    problems = Problems()
    manifest = collect_scene(write_photographs(tmp_path / "phone"), None, problems)
    assert problems.usable
    assert [frame.name for frame in manifest.frames] == ["a", "b", "more_c", "more_d"]
    assert photographs.lacks_cameras(manifest.frames)
    assert not manifest.bounds.minimum
    with pytest.raises(SceneRefusedError, match=r"scene\.cameras_missing.*4 photographs.*lambent train"):
        describe_scene(tmp_path / "phone")


def test_found_cameras_make_a_capture_of_the_users_own_files(tmp_path):
    folder = write_photographs(tmp_path / "phone", inside="images")
    cameras = write_cameras(tmp_path / "run" / "cameras", NAMES[:3])
    problems = Problems()
    manifest = collect_scene(folder, None, problems, cameras=cameras)
    assert [each.code for each in problems.findings()] == [], (
        "a photograph without a camera is not a surplus file"
    )
    assert [frame.images[0].path for frame in manifest.frames] == [f"images/{name}" for name in NAMES[:3]]
    assert not photographs.lacks_cameras(manifest.frames)
    assert manifest.layout == "photographs"
    assert manifest.bounds_from == "cameras"


def test_up_is_what_the_search_says_rather_than_how_cameras_were_held(tmp_path):
    folder = write_photographs(tmp_path / "phone")
    sideways = (1.0, 0.0, 0.0)
    cameras = write_cameras(tmp_path / "cameras", up=sideways)
    manifest = collect_scene(folder, None, Problems(), cameras=cameras)
    matrix = np.array(manifest.world_from_capture).reshape(4, 4)
    turned = matrix[:3, :3] @ sideways
    assert turned / np.linalg.norm(turned) == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


def test_masks_beside_the_photographs_belong_to_them(tmp_path):
    folder = write_photographs(tmp_path / "phone", inside="images")
    for name in NAMES:
        save(folder / "masks" / f"{name}.png", np.full((12, 16), 255, dtype=np.uint8))
    manifest = collect_scene(folder, None, Problems())
    assert [frame.mask for frame in manifest.frames] == [f"masks/{name}.png" for name in NAMES]


def test_a_record_that_cannot_be_read_says_which_folder_to_remove(tmp_path):
    cameras = write_cameras(tmp_path / "cameras")
    assert read_found_cameras(cameras).registered == 4
    record = json.loads((cameras / "cameras.json").read_text())
    del record["inputs"]
    (cameras / "cameras.json").write_text(json.dumps(record))
    with pytest.raises(WorkerError, match=r"(?s)run\.cameras_broken.*remove"):
        read_found_cameras(cameras)

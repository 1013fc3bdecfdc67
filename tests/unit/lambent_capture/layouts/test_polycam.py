"""Polycam's raw data is read with its cameras; its maps are not photographs."""

import json
import shutil

import numpy as np
import pytest
from lambent_capture.checks.check import check_capture
from lambent_capture.layouts.detect import collect_scene, describe_scene, detect_layout
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.problems import Problems
from lambent_capture.scenes.world import world_matrix
from support.captures import save
from support.uneven_object import FOCAL, NUM_VIEWS, SIDE, colours, coverage, poses

Y_UP = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From our world, z up, to that of ARKit."""


def write_camera(path, pose, **changes):
    values = {"fx": FOCAL, "fy": FOCAL, "cx": SIDE / 2, "cy": SIDE / 2, "width": SIDE, "height": SIDE}
    values |= {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
    values |= {"blur_score": 120.0, "timestamp": 1} | changes
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({key: value for key, value in values.items() if value is not None}))


def write_polycam(folder, corrected=True, base="keyframes"):
    for index, pose in enumerate(poses()):
        picture = np.dstack([colours(index), coverage(pose)])
        tracked = Y_UP @ pose
        tracked[:3, 3] += 0.01 * index  # as a telephone drifts
        for kind, camera in {"corrected_": Y_UP @ pose, "": tracked}.items():
            if kind and not corrected:
                continue
            save(folder / base / f"{kind}images" / f"{1000 + index}.png", picture)
            write_camera(folder / base / f"{kind}cameras" / f"{1000 + index}.json", camera)
        for name in ("depth", "confidence"):
            save(folder / base / name / f"{1000 + index}.png", picture[..., 0])
    (folder / "mesh_info.json").write_text("{}")
    return folder


@pytest.mark.parametrize("corrected", [True, False])
@pytest.mark.parametrize("base", ["keyframes", "."])
def test_the_better_cameras_are_used_with_their_own_photographs(tmp_path, corrected, base):
    folder = write_polycam(tmp_path / "scan", corrected, base)
    assert detect_layout(folder) == "polycam"
    manifest = describe_scene(folder)
    place = f"{base}/corrected_images" if corrected else f"{base}/images"
    assert [frame.images[0].path for frame in manifest.frames] == [
        f"{place}/{1000 + index}.png".removeprefix("./") for index in range(NUM_VIEWS)
    ]
    assert manifest.frames[0].name == "1000"
    assert manifest.frames[0].camera.focal_x == FOCAL
    assert check_capture(folder).report.usable


def test_up_is_where_the_telephone_says_it_is(tmp_path):
    manifest = describe_scene(write_polycam(tmp_path))
    up = world_matrix(manifest)[:3, :3] @ [0.0, 1.0, 0.0]
    assert up / np.linalg.norm(up) == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    assert not inspect_files(tmp_path).report.findings


def test_a_few_photographs_may_be_missing(tmp_path):
    folder = write_polycam(tmp_path)
    (folder / "keyframes" / "corrected_images" / "1003.png").unlink()
    report = inspect_files(folder).report
    assert report.usable
    assert [each.code for each in report.findings] == ["scene.frames_without_picture"]


FAULTS = {
    "no lens": ({"fx": None}, "scene.camera_missing"),
    "no pose": ({"t_12": None}, "scene.camera_missing"),
    "a lens that is not a number": ({"fx": "wide"}, "scene.lens_invalid"),
    "a pose that is not a rotation": ({"t_12": 7.0}, "scene.camera_not_rigid"),
}


@pytest.mark.parametrize(("changes", "code"), FAULTS.values(), ids=FAULTS.keys())
def test_a_faulty_camera_is_named_with_its_file(tmp_path, changes, code):
    folder = write_polycam(tmp_path)
    write_camera(folder / "keyframes" / "corrected_cameras" / "1003.json", Y_UP @ poses()[3], **changes)
    (finding,) = inspect_files(folder).report.findings
    assert finding.code == code
    assert "corrected_cameras/1003.json" in finding.message


def test_maps_of_depth_are_no_photographs_without_cameras_either(tmp_path):
    folder = write_polycam(tmp_path, corrected=False)
    shutil.rmtree(folder / "keyframes" / "cameras")
    problems = Problems()
    manifest = collect_scene(folder, None, problems)
    assert manifest.layout == "photographs"
    assert len(manifest.frames) == NUM_VIEWS
    assert [each.code for each in problems.findings()] == ["scene.extra_file"]
    assert "32 pictures" in problems.findings()[0].message


def test_cameras_of_another_program_are_not_taken_for_polycam_s(tmp_path):
    save(tmp_path / "images" / "1.png", colours(1))
    (tmp_path / "cameras").mkdir()
    (tmp_path / "cameras" / "1.json").write_text('{"fx": 1}')
    assert detect_layout(tmp_path) == "photographs"

"""Whatever is wrong with a capture is named, with the file or frame it is about, and never raises."""

import json

import numpy as np
import pytest
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.pictures import pictures
from lambent_capture.problems import MAX_FINDINGS
from support.captures import (
    edit_frame,
    look_at,
    photograph,
    read_transforms,
    save,
    write_blender,
    write_tensoir,
    write_transforms,
)
from support.findings import codes, subject_of, warnings_of
from support.hostile_files import huge_exr, huge_png

POSE = look_at(np.array([4.0, 0.0, 1.0]))


def test_a_good_capture_is_usable_and_counted(tmp_path):
    report = inspect_files(write_tensoir(tmp_path)).report
    assert report.usable
    assert not report.findings
    assert (report.num_train_frames, report.num_test_frames) == (5, 2)


def test_a_folder_that_is_not_there_is_said_so(tmp_path):
    assert codes(inspect_files(tmp_path / "nowhere").report) == ["scene.folder_missing"]


def test_an_unknown_layout_says_what_was_looked_for(tmp_path):
    report = inspect_files(tmp_path).report
    assert codes(report) == ["scene.layout_unknown"]
    assert "transforms_train.json" in report.findings[0].message


BROKEN_PICTURES = {
    "truncated": (lambda path: path.write_bytes(path.read_bytes()[:-40]), "scene.image_broken"),
    "cut in the header": (lambda path: path.write_bytes(path.read_bytes()[:20]), "scene.image_not_a_picture"),
    "empty": (lambda path: path.write_bytes(b""), "scene.image_not_a_picture"),
    "text": (lambda path: path.write_text("not a picture"), "scene.image_not_a_picture"),
    "another format": (lambda path: path.write_bytes(b"GIF89a" + b"\0" * 50), "scene.image_not_a_picture"),
    "missing": (lambda path: path.unlink(), "scene.file_missing"),
    "too many pixels": (lambda path: huge_png(path, 12_000), "scene.image_too_large"),
    "a decompression bomb": (lambda path: huge_png(path, 60_000), "scene.image_too_large"),
    "of another size": (lambda path: save(path, photograph(1, side=16)), "scene.image_size"),
}


@pytest.mark.parametrize(("damage", "code"), BROKEN_PICTURES.values(), ids=BROKEN_PICTURES.keys())
def test_a_broken_picture_is_an_error_that_names_the_file(tmp_path, damage, code):
    folder = write_tensoir(tmp_path, relight=("city",))
    damage(folder / "test_001" / "rgba_city.png")
    report = inspect_files(folder).report
    assert not report.usable
    assert code in codes(report)
    assert subject_of(report, code) == "test_001/rgba_city.png"


def test_a_flipped_bit_in_the_pixels_is_found(tmp_path):
    folder = write_tensoir(tmp_path)
    path = folder / "train_002" / "rgba_sunset.png"
    data = bytearray(path.read_bytes())
    data[data.index(b"IDAT") + 30] ^= 0xFF
    path.write_bytes(data)
    assert "scene.image_broken" in codes(inspect_files(folder).report)


def test_an_exr_that_asks_for_gigabytes_is_refused_by_its_header(tmp_path):
    folder = write_tensoir(tmp_path)
    huge_exr(folder / "test_000" / "distance.exr", 100_000)
    report = inspect_files(folder).report
    assert codes(report) == ["scene.image_too_large"]
    assert subject_of(report, "scene.image_too_large") == "test_000/distance.exr"


def test_an_exr_of_nothing_but_a_header_is_broken(tmp_path):
    folder = write_tensoir(tmp_path)
    huge_exr(folder / "test_000" / "distance.exr", 12)
    assert codes(inspect_files(folder).report) == ["scene.image_broken"]


def test_an_exr_without_a_number_in_a_pixel_is_refused(tmp_path):
    import OpenEXR

    folder = write_blender(tmp_path)
    (folder / "train" / "r_0.png").unlink()
    pixels = np.full((12, 12, 3), np.nan, dtype=np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": pixels}) as file:
        file.write(str(folder / "train" / "r_0.exr"))
    report = inspect_files(folder).report
    (note,) = (f for f in report.findings if f.code == "scene.pictures_left_out")
    assert note.subject == "train/r_0.exr"
    assert "NaN" in note.message


BAD_POSES = {
    "infinite": (np.where(np.eye(4) > 0, np.inf, POSE).tolist(), "scene.camera_not_finite"),
    "huge": ((POSE + 1e9).tolist(), "scene.camera_not_finite"),
    "scaled": (np.diag([2.0, 2.0, 2.0, 1.0]).tolist(), "scene.camera_not_rigid"),
    "mirrored": ((POSE @ np.diag([1.0, 1.0, -1.0, 1.0])).tolist(), "scene.camera_not_rigid"),
    "last row": ((POSE + np.eye(4)[[3] * 4] * [[0], [0], [0], [1]]).tolist(), "scene.camera_not_rigid"),
    "too short": ([[1.0, 0.0], [0.0, 1.0]], "scene.camera_invalid"),
    "words": ("here", "scene.camera_invalid"),
    "ragged": ([[1.0], [1.0, 2.0]], "scene.camera_invalid"),
    "enormous integer": ([[10**400] * 4] * 4, "scene.camera_invalid"),
    "absent": (None, "scene.camera_missing"),
}


@pytest.mark.parametrize(("matrix", "code"), BAD_POSES.values(), ids=BAD_POSES.keys())
def test_a_pose_that_is_none_is_an_error_that_names_the_frame(tmp_path, matrix, code):
    folder = write_blender(tmp_path)
    edit_frame(folder, 2, transform_matrix=matrix)
    report = inspect_files(folder).report
    assert codes(report) == [code]
    assert "r_2" in report.findings[0].message


@pytest.mark.parametrize("angle", [0.0, -1.0, 3.2, "wide", float("nan"), None, True])
def test_an_impossible_field_of_view_is_an_error(tmp_path, angle):
    folder = write_blender(tmp_path)
    write_transforms(folder, "train", {**read_transforms(folder), "camera_angle_x": angle})
    assert set(codes(inspect_files(folder).report)) == {"scene.camera_angle_invalid", "scene.too_few_images"}


def test_a_frame_without_a_lens_is_an_error(tmp_path):
    folder = write_blender(tmp_path)
    transforms = read_transforms(folder)
    del transforms["camera_angle_x"]
    write_transforms(folder, "train", transforms)
    assert "scene.camera_missing" in codes(inspect_files(folder).report)


@pytest.mark.parametrize("lens", [{"fl_x": 0}, {"fl_x": 10, "cx": "middle"}, {"fl_x": 10, "w": -4}])
def test_a_lens_of_nonsense_is_an_error(tmp_path, lens):
    folder = write_blender(tmp_path)
    edit_frame(folder, 0, **lens)
    assert codes(inspect_files(folder).report) == ["scene.lens_invalid"]


@pytest.mark.parametrize(
    "path",
    [
        "../train/r_0",
        "/etc/passwd",
        "..\\train\\r_0",
        "C:\\train\\r_0",
        "\\\\host\\train\\r_0",
        "",
        "a/../../b",
        ".",
        "a" * 300,
        "\ud800",
        "a/" * 600 + "b",
    ],
)
def test_a_path_out_of_the_folder_is_an_error(tmp_path, path):
    folder = write_blender(tmp_path)
    edit_frame(folder, 0, file_path=path)
    assert codes(inspect_files(folder).report) == ["scene.path_unsafe"]


def test_the_same_picture_under_two_names_is_a_warning(tmp_path):
    folder = write_blender(tmp_path)
    (folder / "train" / "r_1.png").write_bytes((folder / "train" / "r_0.png").read_bytes())
    report = inspect_files(folder).report
    assert report.usable
    assert warnings_of(report) == ["scene.image_duplicate"]


METADATA = {
    "not JSON": "{",
    "a list": "[]",
    "not text": b"\xff\xfe\x00",
    "nested too deeply": "[" * 200_000,
    "without frames": "{}",
}


@pytest.mark.parametrize("text", METADATA.values(), ids=METADATA.keys())
def test_unreadable_metadata_is_an_error(tmp_path, text):
    folder = write_blender(tmp_path)
    path = folder / "transforms_train.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert "scene.metadata_unreadable" in codes(inspect_files(folder).report)


def test_a_view_without_metadata_has_no_camera(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "train_003" / "metadata.json").unlink()
    report = inspect_files(folder).report
    assert codes(report) == ["scene.camera_missing"]
    assert subject_of(report, "scene.camera_missing") == "train_003"


def test_a_light_that_one_view_lacks_is_an_error_that_names_the_file(tmp_path):
    folder = write_tensoir(tmp_path, lights=("sunset", "snow"))
    (folder / "train_001" / "rgba_snow.png").unlink()
    report = inspect_files(folder).report
    assert subject_of(report, "scene.file_missing") == "train_001/rgba_snow.png"


def test_two_photographs_are_too_few(tmp_path):
    assert codes(inspect_files(write_blender(tmp_path, num_train=2)).report) == ["scene.too_few_images"]


def test_a_scene_of_no_frames_at_all_is_too_few(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    write_transforms(folder, "train", {"camera_angle_x": 0.7, "frames": []})
    assert codes(inspect_files(folder).report) == ["scene.too_few_images"]


def place_cameras(folder, poses):
    transforms = read_transforms(folder)
    for frame, pose in zip(transforms["frames"], poses, strict=True):
        frame["transform_matrix"] = pose.tolist()
    write_transforms(folder, "train", transforms)


def test_cameras_on_one_spot_see_no_depth(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    place_cameras(folder, [look_at(np.array([4.0, 0, 1]), np.array([0, y, 0.0])) for y in range(5)])
    assert codes(inspect_files(folder).report) == ["scene.cameras_coincide"]


def test_parallel_cameras_look_at_nothing_in_common(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    spots = [np.array([4.0, 10.0 * y, 1.0]) for y in range(5)]
    place_cameras(folder, [look_at(spot, spot - [4.0, 0.0, 1.0]) for spot in spots])
    assert codes(inspect_files(folder).report) == ["scene.cameras_parallel"]


def test_views_that_do_not_overlap_are_refused(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    spots = [np.array([4.0 * np.cos(a), 4.0 * np.sin(a), 1.0]) for a in np.linspace(0, 5, 5)]
    aside = [spot + np.array([-spot[1], spot[0], 0.0]) - 0.5 * spot for spot in spots]
    place_cameras(folder, [look_at(spot, target) for spot, target in zip(spots, aside, strict=True)])
    assert codes(inspect_files(folder).report) == ["scene.no_overlap"]


def test_one_camera_that_looks_elsewhere_is_a_warning_that_names_it(tmp_path):
    folder = write_blender(tmp_path, num_train=12, num_test=0)
    edit_frame(folder, 3, transform_matrix=look_at(np.array([0.0, 4.0, 1.0]), np.array([6, 4.0, 0])).tolist())
    report = inspect_files(folder).report
    assert report.usable
    assert subject_of(report, "scene.camera_looks_elsewhere") == "train_r_3"


def test_photographs_without_a_cut_out_object_are_a_warning(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    for index in range(5):
        save(folder / "train" / f"r_{index}.png", photograph(index)[..., :3])
    assert warnings_of(inspect_files(folder).report) == ["scene.no_mask"]


def test_a_fully_transparent_photograph_is_a_warning(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.zeros((12, 12, 4), dtype=np.uint8))
    assert warnings_of(inspect_files(folder).report) == ["scene.image_empty"]


def test_everything_that_is_wrong_is_reported_at_once(tmp_path):
    folder = write_blender(tmp_path, num_train=9)
    edit_frame(folder, 0, transform_matrix=None)
    edit_frame(folder, 1, file_path="../x")
    (folder / "train" / "r_2.png").write_text("no")
    data = (folder / "train" / "r_3.png").read_bytes()
    (folder / "train" / "r_3.png").write_bytes(data[:-30])
    (folder / "model.onnx").write_bytes(b"\x08")
    report = inspect_files(folder).report
    assert set(codes(report)) == {"scene.camera_missing", "scene.path_unsafe"}
    assert warnings_of(report) == ["scene.pictures_left_out", "scene.unsupported_file"]
    left_out = next(f.message for f in report.findings if f.code == "scene.pictures_left_out")
    assert "r_2.png is not a PNG picture (it is text)" in left_out
    assert 'r_3.png (frame "train_r_3") cannot be decoded' in left_out


def test_a_hundred_findings_are_enough_and_errors_come_first(tmp_path):
    folder = write_blender(tmp_path, num_test=0)
    transforms = read_transforms(folder)
    transforms["frames"] += [{"file_path": f"gone_{i}"} for i in range(150)]
    write_transforms(folder, "train", transforms)
    (folder / "model.onnx").write_bytes(b"\x08")
    report = inspect_files(folder).report
    assert len(report.findings) == MAX_FINDINGS
    assert "scene.unsupported_file" not in {finding.code for finding in report.findings}
    assert report.findings[-1].code == "scene.more_findings"
    assert "52 more" in report.findings[-1].message


def test_messages_say_what_to_do(tmp_path):
    folder = write_blender(tmp_path)
    edit_frame(folder, 0, transform_matrix=None)
    (folder / "train" / "r_1.png").unlink()
    for finding in inspect_files(folder).report.findings:
        assert any(word in finding.message for word in ("add", "remove", "use")), finding.message


def test_scene_json_with_nonsense_is_an_error(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "scene.json").write_text(json.dumps({"near_far": [6, 2], "bbox": [[0, 0], [1, 1]]}))
    assert codes(inspect_files(folder).report) == ["scene.extent_invalid"] * 2


def test_a_file_that_killed_a_reader_is_reported_and_not_opened_again(tmp_path, monkeypatch):
    folder = write_tensoir(tmp_path)
    opened = []
    facts = pictures.picture_facts
    monkeypatch.setattr(
        "lambent_capture.loading.inspect.picture_facts", lambda path: opened.append(path.name) or facts(path)
    )
    killer = "train_000/rgba_sunset.png"
    report = inspect_files(folder, skip={killer: "scene.image_too_large"}).report
    assert subject_of(report, "scene.image_too_large") == killer
    assert len(opened) == 8

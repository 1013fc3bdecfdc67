"""COLMAP models in text and binary are the same scene, and damage is named."""

import struct

import numpy as np
import pytest
from lambent_capture.layouts.colmap_model import MODELS as NUMBERED
from lambent_capture.layouts.colmap_model import ModelError, read_cameras, read_images
from lambent_capture.layouts.colmap_points import read_points
from lambent_capture.layouts.detect import collect_scene, describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.problems import Problems
from lambent_capture.scenes.world import in_world, world_matrix
from support.findings import only
from support.layouts import ColmapBinaryFolder, ColmapTextFolder
from support.uneven_object import NUM_VIEWS, SIDE


def model_file(capture, name):
    return capture.folder / "sparse" / "0" / name


def test_text_and_binary_describe_the_same_frames(tmp_path):
    text = describe_scene(ColmapTextFolder(tmp_path / "text").folder)
    binary = describe_scene(ColmapBinaryFolder(tmp_path / "binary").folder)
    assert [frame.name for frame in text.frames] == [frame.name for frame in binary.frames]
    in_world(binary, world_matrix(text))  # the last digits may decide whether a scene is moved
    for one, other in zip(text.frames, binary.frames, strict=True):
        np.testing.assert_allclose(one.camera.camera_to_world, other.camera.camera_to_world, atol=1e-9)


# Model, parameters, and where a point at (0.2, -0.1) over depth is seen.
MODELS = {
    "SIMPLE_PINHOLE": ("48 21 19", (48 * 0.2 + 21, 48 * -0.1 + 19)),
    "PINHOLE": ("48 50 21 19", (48 * 0.2 + 21, 50 * -0.1 + 19)),
    "SIMPLE_RADIAL": ("48 20 20 0.1", (48 * 0.2 * 1.005 + 20, 48 * -0.1 * 1.005 + 20)),
    "RADIAL": ("48 20 20 0.1 0.2", (48 * 0.2 * 1.0055 + 20, 48 * -0.1 * 1.0055 + 20)),
    "OPENCV": (
        "48 50 20 20 0.1 0.2 0.01 0.02",
        (
            48 * (0.2 * 1.0055 + 2 * 0.01 * -0.02 + 0.02 * (0.05 + 0.08)) + 20,
            50 * (-0.1 * 1.0055 + 0.01 * (0.05 + 0.02) + 2 * 0.02 * -0.02) + 20,
        ),
    ),
    "FULL_OPENCV": (
        "48 50 20 20 0.1 0.2 0 0 0 0.1 0.2 0",
        (48 * 0.2 + 20, 50 * -0.1 + 20),  # numerator and denominator are equal
    ),
}


@pytest.mark.parametrize(("model", "parameters", "expected"), [(k, *v) for k, v in MODELS.items()])
def test_every_perspective_model_is_understood(tmp_path, model, parameters, expected):
    from lambent_capture.pictures.lens import distorted

    capture = ColmapTextFolder(tmp_path / "scene")
    model_file(capture, "cameras.txt").write_text(f"1 {model} {SIDE} {SIDE} {parameters}\n")
    problems = Problems()
    manifest = collect_scene(capture.folder, None, problems)
    assert problems.usable
    camera = manifest.frames[0].camera
    if camera.HasField("lens"):
        lens = camera.lens
        x, y = distorted(np.array(0.2), np.array(-0.1), np.array(lens.distortion))
    else:
        lens, x, y = camera, 0.2, -0.1
    seen = (lens.focal_x * x + lens.centre_x, lens.focal_y * y + lens.centre_y)
    assert seen == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    "model", ["OPENCV_FISHEYE", "FOV", "THIN_PRISM_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "NEW"]
)
def test_a_model_that_no_pinhole_can_stand_in_for_is_refused(tmp_path, model):
    capture = ColmapTextFolder(tmp_path / "scene")
    count = {"OPENCV_FISHEYE": 8, "FOV": 5, "THIN_PRISM_FISHEYE": 12, "SIMPLE_RADIAL_FISHEYE": 4, "NEW": 3}[
        model
    ]
    model_file(capture, "cameras.txt").write_text(f"1 {model} {SIDE} {SIDE} {' '.join(['20'] * count)}\n")
    report = inspect_files(capture.folder).report
    assert {finding.code for finding in report.findings} == {"scene.lens_unsupported"}
    assert "image_undistorter" in report.findings[0].message
    assert model in report.findings[0].message


DAMAGE = {
    "images.txt": [
        ("1 0.5 0.5 0.5 0.5 0 0\n\n", "not an image"),
        ("# Number of images: 2\n1 1 0 0 0 0 0 4 1 a.png\n\n", "announces 2 images and holds 1"),
        ("1 1 0 0 0 0 0 4 one a.png\n\n", "line 1"),
        ("1 x 0 0 0 0 0 4 1 a.png\n\n", "line 1"),
    ],
    "cameras.txt": [
        ("1 PINHOLE 40\n", "not a camera"),
        ("1 PINHOLE 40 40 1 2\n", "2 parameters, 4 are needed"),
        ("1 PINHOLE 0 40 1 1 0 0\n", "0 x 40"),
        ("1 PINHOLE 4 4 1 1 2 2\n1 PINHOLE 4 4 1 1 2 2\n", "again"),
        ("# Number of cameras: 3\n1 PINHOLE 4 4 1 1 2 2\n", "announces 3 cameras"),
    ],
}


@pytest.mark.parametrize(
    ("name", "text", "reason"), [(name, *case) for name, cases in DAMAGE.items() for case in cases]
)
def test_a_damaged_text_file_is_named_with_its_fault(tmp_path, name, text, reason):
    capture = ColmapTextFolder(tmp_path / "scene")
    model_file(capture, name).write_text(text)
    finding = only(capture.folder)
    assert finding.code == "scene.metadata_unreadable"
    assert finding.subject == f"sparse/0/{name}"
    assert reason in finding.message


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:-3],
        lambda data: data[:10],
        lambda data: b"",
        lambda data: data + b"\0",
        lambda data: struct.pack("<Q", 2**60) + data[8:],
        lambda data: struct.pack("<Q", 0) + data[8:],
    ],
    ids=["cut", "cut early", "empty", "longer", "huge count", "zero count"],
)
def test_a_damaged_binary_file_is_named(tmp_path, name, damage):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    path = model_file(capture, name)
    path.write_bytes(damage(path.read_bytes()))
    finding = only(capture.folder)
    assert finding.code == "scene.metadata_unreadable"
    assert finding.subject == f"sparse/0/{name}"


def test_every_possible_cut_of_a_binary_model_is_refused(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    for name, read in (("cameras.bin", read_cameras), ("images.bin", read_images)):
        data = model_file(capture, name).read_bytes()
        for length in range(0, len(data), 23):
            (tmp_path / name).write_bytes(data[:length])
            with pytest.raises(ModelError):
                read(tmp_path / name)


@pytest.mark.parametrize(
    ("rotation", "code"),
    [
        ("0 0 0 0", "scene.camera_not_rigid"),
        ("1e200 1e200 0 0", "scene.camera_not_finite"),
        ("nan 0 0 1", "scene.camera_not_finite"),
        ("inf 0 0 1", "scene.camera_not_finite"),
    ],
)
def test_numbers_that_are_no_rotation_are_an_error_that_names_the_photograph(tmp_path, rotation, code):
    capture = ColmapTextFolder(tmp_path / "scene")
    path = model_file(capture, "images.txt")
    lines = path.read_text().splitlines()
    place = next(i for i, line in enumerate(lines) if line.endswith("IMG_0003.png"))
    words = lines[place].split()
    lines[place] = " ".join([words[0], rotation, *words[5:]])
    path.write_text("\n".join(lines) + "\n")
    finding = only(capture.folder)
    assert finding.code == code
    assert "IMG_0003.png" in finding.subject


def test_an_image_of_an_unknown_camera_is_named(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    path = model_file(capture, "images.txt")
    path.write_text(path.read_text().replace("1 IMG_0003.png", "7 IMG_0003.png"))
    finding = only(capture.folder)
    assert finding.code == "scene.camera_missing"
    assert "camera 7" in finding.message
    assert finding.subject == "images/IMG_0003.png"


def test_a_name_that_leads_out_of_the_folder_is_refused(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    path = model_file(capture, "images.txt")
    path.write_text(path.read_text().replace(" IMG_0003.png", " ../IMG_0003.png"))
    assert {finding.code for finding in inspect_files(capture.folder).report.findings} == {
        "scene.path_unsafe"
    }


def test_half_a_model_is_an_error_that_names_the_other_half(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    model_file(capture, "cameras.bin").unlink()
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == ("scene.file_missing", "sparse/0/cameras.bin")


def test_a_photograph_without_a_mask_is_left_out_where_most_have_one(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    capture.mask(3).unlink()
    inspection = inspect_files(capture.folder)
    report, manifest = inspection.report, inspection.manifest
    assert report.usable
    assert [each.code for each in report.findings] == ["scene.pictures_left_out"]
    assert "images/IMG_0003.png has no mask masks/IMG_0003.png.png" in report.findings[0].message
    assert len(manifest.frames) == NUM_VIEWS - 1
    assert all(frame.mask for frame in manifest.frames)


def test_masks_that_most_photographs_lack_are_not_used(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    for index in range(NUM_VIEWS // 2 + 1):
        capture.mask(index).unlink()
    inspection = inspect_files(capture.folder)
    report, manifest = inspection.report, inspection.manifest
    assert report.usable
    assert "scene.mask_unused" in {each.code for each in report.findings}
    assert len(manifest.frames) == NUM_VIEWS
    assert not any(frame.mask for frame in manifest.frames)


def test_masks_may_be_named_by_the_stem(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    for index in range(NUM_VIEWS):
        capture.mask(index).rename(capture.folder / "masks" / f"IMG_{index:04d}.png")
    assert not inspect_files(capture.folder).report.findings


def test_reduced_photographs_scale_the_lens(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    text = model_file(capture, "cameras.txt").read_text()
    double = f"1 PINHOLE {2 * SIDE} {2 * SIDE} {2 * 48} {2 * 48} {SIDE} {SIDE}"
    model_file(capture, "cameras.txt").write_text(text.splitlines()[0] + "\n" + double + "\n")
    camera = describe_scene(capture.folder).frames[0].camera
    assert (camera.width, camera.focal_x, camera.centre_x) == (SIDE, 48.0, SIDE / 2)


@pytest.mark.parametrize("kind", [ColmapTextFolder, ColmapBinaryFolder])
@pytest.mark.parametrize(
    ("number", "model", "count"), [(n, *v) for n, v in NUMBERED.items() if n >= 5 and n != 6]
)
def test_a_lens_of_a_newer_colmap_is_answered_with_the_undistorter(tmp_path, kind, number, model, count):
    capture = kind(tmp_path / "scene")
    if kind is ColmapTextFolder:
        text = f"1 {model} {SIDE} {SIDE} {' '.join(['20'] * count)}\n"
        model_file(capture, "cameras.txt").write_text(text)
    else:
        data = struct.pack("<QiiQQ", 1, 1, number, SIDE, SIDE) + struct.pack(f"<{count}d", *[20.0] * count)
        model_file(capture, "cameras.bin").write_bytes(data)
    report = inspect_files(capture.folder).report
    assert {finding.code for finding in report.findings} == {"scene.lens_unsupported"}
    assert model in report.findings[0].message
    assert "image_undistorter" in report.findings[0].message


def test_a_model_number_that_is_not_known_yet_is_answered_with_the_undistorter(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    data = struct.pack("<QiiQQ", 1, 1, 99, SIDE, SIDE) + struct.pack("<4d", *[20.0] * 4)
    model_file(capture, "cameras.bin").write_bytes(data)
    assert only(capture.folder).code == "scene.lens_unsupported"
    assert "99; run colmap image_undistorter" in only(capture.folder).message


def test_the_numbers_of_lenses_are_those_of_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    known = {int(each): name for name, each in pycolmap.CameraModelId.__members__.items() if int(each) >= 0}
    assert known == {number: name for number, (name, _) in NUMBERED.items()}


ENCODINGS = {"CRLF": "utf-8", "mark": "utf-8-sig", "UTF-16": "utf-16"}


@pytest.mark.parametrize("encoding", ENCODINGS.values(), ids=ENCODINGS.keys())
def test_text_may_come_from_windows(tmp_path, encoding):
    capture = ColmapTextFolder(tmp_path / "scene")
    before = describe_scene(capture.folder)
    points = "# 3D point list\n1 0 0 0 9 9 9 0.5 1 0 2 0\n"
    model_file(capture, "points3D.txt").write_text(points)
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        path = model_file(capture, name)
        path.write_bytes(path.read_text().replace("\n", "\r\n").encode(encoding))
    assert describe_scene(capture.folder) == before
    assert len(read_points(model_file(capture, "")).xyz) == 1


NAMES = {
    "capitals": lambda name: name.upper(),
    "backslashes": lambda name: "Left\\" + name,
    "backslashes from here": lambda name: ".\\left\\" + name,
    "a doubled suffix": lambda name: name + ".png",
}


@pytest.mark.parametrize("kind", [ColmapTextFolder, ColmapBinaryFolder])
@pytest.mark.parametrize("spelling", NAMES.values(), ids=NAMES.keys())
def test_photographs_may_be_named_in_the_spelling_of_another_system(tmp_path, kind, spelling):
    capture = kind(tmp_path / "scene")
    inner = "left" if "left" in spelling("x").lower() else ""
    for index in range(NUM_VIEWS):
        for path in (capture.picture(index), capture.mask(index)):
            (path.parent / inner).mkdir(exist_ok=True)
            path.rename(path.parent / inner / path.name)
    capture.write_model([(turn, shift, spelling(name)) for turn, shift, name in capture.rows()])
    inspection = inspect_files(capture.folder)
    report, manifest = inspection.report, inspection.manifest
    assert not [each.message for each in report.findings]
    assert all(frame.mask.endswith(".png.png") for frame in manifest.frames)

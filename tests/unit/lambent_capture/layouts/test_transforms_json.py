"""Pictures are found under the names that programs on other systems give them."""

import json
import unicodedata

import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from support.captures import edit_frame, read_transforms, write_blender, write_transforms
from support.layouts import NerfstudioFolder
from support.uneven_object import NUM_VIEWS

FILES = {"nerf_blender": "transforms_train.json", "nerfstudio": "transforms.json"}
SPELLINGS = {
    "backslashes": lambda name: name.replace("/", "\\"),
    "backslashes from here": lambda name: ".\\" + name.removeprefix("./").replace("/", "\\"),
    "capitals": lambda name: name.upper(),
    "a doubled suffix": lambda name: name + ".png" if "." in name[2:] else name + ".png.png",
    "no suffix": lambda name: name[:2] + name[2:].split(".")[0],
    "a way round": lambda name: "elsewhere/../" + name,
}


@pytest.fixture(params=FILES)
def capture(request, tmp_path):
    """Return a capture and its transforms file."""
    if request.param == "nerfstudio":
        folder = NerfstudioFolder(tmp_path / "scene").folder
    else:
        folder = write_blender(tmp_path / "scene")
    return folder, folder / FILES[request.param]


def respelled(file, spelling, keys=("file_path", "mask_path")):
    transforms = json.loads(file.read_text())
    for frame in transforms["frames"]:
        frame.update({key: spelling(frame[key]) for key in keys if key in frame})
    return transforms


@pytest.mark.parametrize("spelling", SPELLINGS.values(), ids=SPELLINGS.keys())
def test_a_picture_may_be_named_in_the_spelling_of_another_system(capture, spelling):
    folder, file = capture
    before = describe_scene(folder)
    file.write_text(json.dumps(respelled(file, spelling)))
    assert describe_scene(folder) == before


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_accents_may_be_composed_or_not(tmp_path, form):
    folder = write_blender(tmp_path)
    (folder / "train" / "r_0.png").rename(folder / "train" / unicodedata.normalize(form, "möbel.png"))
    for spelled in ("NFC", "NFD"):
        edit_frame(folder, 0, file_path="./train/" + unicodedata.normalize(spelled, "möbel"))
        assert len(describe_scene(folder).frames) == 7


def test_a_spelling_that_fits_two_pictures_is_not_guessed(tmp_path):
    folder = write_blender(tmp_path)
    (folder / "train" / "R_0.png").write_bytes((folder / "train" / "r_1.png").read_bytes())
    describe_scene(folder)
    edit_frame(folder, 0, file_path="./Train/r_0")
    assert len(describe_scene(folder).frames) == 7, "this spelling is exact but for the folder"
    (folder / "train" / "r_2.png").rename(folder / "train" / "x.JPG")
    (folder / "train" / "r_3.png").rename(folder / "train" / "X.jpg")
    edit_frame(folder, 2, file_path="./train/x.jpg")
    edit_frame(folder, 3, file_path=None)
    report = inspect_files(folder).report
    assert "x.jpg" in next(f.message for f in report.findings if f.code == "scene.frames_without_picture")


ENCODINGS = {"UTF-8 with its mark": "utf-8-sig", "UTF-16": "utf-16", "UTF-32": "utf-32"}


@pytest.mark.parametrize("encoding", ENCODINGS.values(), ids=ENCODINGS.keys())
def test_the_file_may_begin_with_a_byte_order_mark(capture, encoding):
    folder, file = capture
    before = describe_scene(folder)
    file.write_bytes(file.read_text().replace("\n", "\r\n").encode(encoding))
    assert describe_scene(folder) == before


def test_a_pose_may_have_three_rows(capture):
    folder, file = capture
    before = describe_scene(folder)
    transforms = json.loads(file.read_text())
    for frame in transforms["frames"]:
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    file.write_text(json.dumps(transforms))
    assert describe_scene(folder) == before


def test_a_pose_may_be_scaled_as_a_whole(capture):
    folder, file = capture
    before = describe_scene(folder)
    transforms = json.loads(file.read_text())
    for frame in transforms["frames"]:
        frame["transform_matrix"] = [[value / 1024 for value in row] for row in frame["transform_matrix"]]
    file.write_text(json.dumps(transforms))
    assert describe_scene(folder) == before


def test_a_pose_of_four_rows_of_three_is_refused(tmp_path):
    folder = write_blender(tmp_path)
    transforms = read_transforms(folder)
    rows = transforms["frames"][0]["transform_matrix"]
    transforms["frames"][0]["transform_matrix"] = [row[:3] for row in rows]
    write_transforms(folder, "train", transforms)
    assert [each.code for each in inspect_files(folder).report.findings] == ["scene.camera_invalid"]


def test_a_picture_in_another_format_is_named_by_its_own_name(tmp_path):
    capture = NerfstudioFolder(tmp_path)
    for index in range(NUM_VIEWS):
        capture.picture(index).rename(capture.picture(index).with_suffix(".jp2"))
    capture.write_cameras([{**each, "file_path": each["file_path"][:-4]} for each in capture.entries()])
    report = inspect_files(capture.folder).report
    assert {each.code for each in report.findings} == {"scene.image_format"}
    assert "images/frame_00000.jp2 has a format that is not read" in report.findings[0].message


def test_a_picture_with_another_suffix_is_named_as_a_way_out(tmp_path):
    capture = NerfstudioFolder(tmp_path)
    capture.picture(3).rename(capture.picture(3).with_suffix(".png"))
    report = inspect_files(capture.folder).report
    assert report.usable
    edited = [{**each, "file_path": each["file_path"].replace(".jpg", ".webp")} for each in capture.entries()]
    capture.write_cameras(edited)
    message = inspect_files(capture.folder).report.findings[0].message
    assert "there is no images/frame_00000.webp" in message
    assert "but images/frame_00000.jpg" in message

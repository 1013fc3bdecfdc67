"""transforms.json of nerfstudio and instant-ngp: lenses per frame, distortion, masks, split lists."""

import json

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.load import load_scene
from lambent_capture.pictures.lens import LensFigures, camera_with_lens, distorted
from lambent_capture.problems import Problems
from lambent_proto.v1 import scene_pb2
from support.captures import save
from support.findings import only
from support.layouts import NerfstudioFolder
from support.uneven_object import FOCAL, NUM_VIEWS, SIDE, colours, coverage

BARREL = {"k1": -0.5, "k2": 0.2, "p1": 0.002, "p2": -0.001}


def change(capture, frame=None, **values):
    """Change entries of the file, or of one frame; None removes one."""
    path = capture.folder / "transforms.json"
    transforms = json.loads(path.read_text())
    place = transforms if frame is None else transforms["frames"][frame]
    place.update(values)
    for key in [key for key, value in values.items() if value is None]:
        del place[key]
    path.write_text(json.dumps(transforms))


def names(manifest, split):
    return [frame.name for frame in manifest.frames if frame.split == split]


def test_every_frame_may_have_a_lens_of_its_own(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    for index in range(NUM_VIEWS):
        lens = {"fl_x": 40.0 + index, "fl_y": 41.0, "cx": 20.5, "cy": 19.5, "w": SIDE, "h": SIDE}
        change(capture, index, **lens)
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        change(capture, **{key: None})
    frames = describe_scene(capture.folder).frames
    assert [frame.camera.focal_x for frame in frames] == [40.0 + index for index in range(NUM_VIEWS)]
    assert (frames[3].camera.focal_y, frames[3].camera.centre_x, frames[3].camera.centre_y) == (
        41.0,
        20.5,
        19.5,
    )


def test_instant_ngp_s_field_of_view_is_a_lens_too(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    for key in ("fl_x", "fl_y", "camera_model"):
        change(capture, **{key: None})
    change(capture, camera_angle_x=2.0 * np.arctan(0.5 * SIDE / FOCAL), aabb_scale=4, scale=0.3)
    assert describe_scene(capture.folder).frames[0].camera.focal_x == pytest.approx(FOCAL)


def distorted_capture(folder, side=80):
    """Write a capture through a lens with distortion: every pixel shows what lies in its bent direction."""
    capture = NerfstudioFolder(folder)
    big = 4 * side  # looked up in a larger and wider picture
    u, v = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    focal = FOCAL * side / SIDE
    target_x, target_y = (u - side / 2) / focal, (v - side / 2) / focal
    x, y = target_x.copy(), target_y.copy()
    coefficients = np.array([BARREL[key] for key in ("k1", "k2", "p1", "p2")] + [0.0] * 4)
    for _ in range(60):
        seen_x, seen_y = distorted(x, y, coefficients)
        x, y = x + 0.7 * (target_x - seen_x), y + 0.7 * (target_y - seen_y)
    straight_focal = FOCAL * big / SIDE
    columns = np.clip(np.floor(straight_focal * x + big / 2), 0, big - 1).astype(int)
    rows = np.clip(np.floor(straight_focal * y + big / 2), 0, big - 1).astype(int)
    for index, pose in enumerate(capture.poses):
        straight = coverage(pose, side=big)
        save(capture.picture(index), colours(index, side))
        save(capture.mask(index), straight[rows, columns])
    values = {"w": side, "h": side, "fl_x": focal, "fl_y": focal, "cx": side / 2, "cy": side / 2}
    change(capture, **values, **BARREL)
    return capture


def test_distortion_is_undone_so_that_the_silhouettes_of_the_pinhole_are_the_true_ones(tmp_path):
    capture = distorted_capture(tmp_path / "scene")
    assert not inspect_files(capture.folder).report.findings
    scene = load_scene(capture.folder, describe_scene(capture.folder), max_side=200)
    camera, alpha = scene.train[0].camera, scene.train[0].images["capture"][..., 3]
    # The true silhouette, wider and finer, looked up along the directions of the pinhole's pixels.
    fine = coverage(capture.poses[0], side=800) > 0
    u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    scale = FOCAL * 800 / SIDE
    columns = np.clip(np.floor(scale * (u - camera.centre_x) / camera.focal_x + 400), 0, 799).astype(int)
    rows = np.clip(np.floor(scale * (v - camera.centre_y) / camera.focal_y + 400), 0, 799).astype(int)
    assert overlap(alpha > 0.5, fine[rows, columns]) > 0.97


def overlap(one, other):
    return (one & other).sum() / (one | other).sum()


def test_without_undoing_it_the_silhouettes_would_be_visibly_smaller(tmp_path):
    # The premise of the test above: this distortion matters.
    capture = distorted_capture(tmp_path / "scene")
    change(capture, k1=0.0, k2=0.0, p1=0.0, p2=0.0)
    scene = load_scene(capture.folder, describe_scene(capture.folder), max_side=200)
    alpha = scene.train[0].images["capture"][..., 3] > 0.5
    true = coverage(capture.poses[0], side=alpha.shape[0]) > 0
    assert overlap(alpha, true) < 0.95


def test_every_pixel_of_a_straightened_picture_was_photographed(tmp_path):
    capture = distorted_capture(tmp_path / "scene")
    camera = describe_scene(capture.folder).frames[0].camera
    assert camera.HasField("lens")
    assert camera.focal_x != camera.lens.focal_x
    figures = LensFigures(
        width=80,
        height=80,
        focal_x=96.0,
        focal_y=96.0,
        centre_x=40.0,
        centre_y=40.0,
        distortion=tuple(camera.lens.distortion),
    )
    again = camera_with_lens(figures, np.eye(4), "a", Problems())
    assert again.focal_x == pytest.approx(camera.focal_x)


def test_split_lists_say_what_is_trained_on(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    paths = [capture.path(index) for index in range(NUM_VIEWS)]
    change(capture, train_filenames=paths[:11], test_filenames=paths[11:14], val_filenames=paths[14:])
    manifest = describe_scene(capture.folder)
    assert names(manifest, scene_pb2.SPLIT_TRAIN) == [f"frame_{index:05d}" for index in range(11)]
    assert names(manifest, scene_pb2.SPLIT_TEST) == [f"frame_{index:05d}" for index in range(11, 14)]
    assert not inspect_files(capture.folder).report.findings


def test_validation_frames_stand_in_for_test_frames(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    paths = [capture.path(index) for index in range(NUM_VIEWS)]
    change(capture, train_filenames=paths[:12], val_filenames=paths[12:], test_filenames=[])
    assert len(names(describe_scene(capture.folder), scene_pb2.SPLIT_TEST)) == 4


def test_a_frame_in_no_list_is_left_out_and_named(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    paths = [capture.path(index) for index in range(NUM_VIEWS)]
    change(capture, train_filenames=paths[:12], test_filenames=paths[13:])
    finding = only(capture.folder)
    assert (finding.code, finding.subject) == ("scene.extra_file", paths[12])


@pytest.mark.parametrize(
    ("lists", "code"),
    [
        ({"train_filenames": ["images/none.jpg"]}, "scene.file_missing"),
        ({"train_filenames": "all"}, "scene.metadata_unreadable"),
        ({"test_filenames": ["images/frame_00001.jpg"] * 2}, "scene.frame_duplicate"),
    ],
)
def test_split_lists_that_do_not_fit_the_frames_are_errors(tmp_path, lists, code):
    capture = NerfstudioFolder(tmp_path / "scene")
    paths = [capture.path(index) for index in range(NUM_VIEWS)]
    change(capture, **{"train_filenames": paths, **lists})
    assert code in {finding.code for finding in inspect_files(capture.folder).report.findings}


@pytest.mark.parametrize(
    ("mask", "code"),
    [
        ("../mask.png", "scene.path_unsafe"),
        ("masks/none.png", "scene.file_missing"),
        (7, "scene.file_path_missing"),
    ],
)
def test_a_mask_that_cannot_be_had_is_an_error_that_names_its_frame(tmp_path, mask, code):
    capture = NerfstudioFolder(tmp_path / "scene")
    change(capture, 3, mask_path=mask)
    finding = only(capture.folder)
    assert finding.code == code
    assert "frame 3" in finding.message


def test_without_masks_the_whole_picture_is_the_object_and_a_note_says_so(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    for index in range(NUM_VIEWS):
        change(capture, index, mask_path=None)
        capture.mask(index).unlink()
    assert only(capture.folder).code == "scene.no_mask"
    assert describe_scene(capture.folder).bounds_from == "cameras"


def test_a_picture_turned_by_exif_says_so(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    change(capture, w=SIDE, h=2 * SIDE, cy=SIDE)
    for index in range(NUM_VIEWS):
        save(capture.picture(index), np.zeros((SIDE, 2 * SIDE, 3), dtype=np.uint8) + index)
    report = inspect_files(capture.folder).report
    assert {finding.code for finding in report.findings} == {"scene.image_size"}
    assert "EXIF orientation" in report.findings[0].message


def test_pictures_in_two_folders_keep_the_folder_in_their_names(tmp_path):
    capture = NerfstudioFolder(tmp_path / "scene")
    other = capture.folder / "more" / "frame_00003.jpg"
    other.parent.mkdir()
    capture.picture(5).rename(other)
    change(capture, 5, file_path="more/frame_00003.jpg")
    found = [frame.name for frame in describe_scene(capture.folder).frames]
    assert "more_frame_00003" in found
    assert "images_frame_00003" in found

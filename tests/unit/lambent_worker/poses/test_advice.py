"""What is said of found cameras names the photographs and what to do; photographs are laid out for COLMAP."""

import importlib

import numpy as np
import pytest
from lambent_worker.errors import UsageError
from lambent_worker.poses.advice import PoseLimits, advise, widest_gap
from lambent_worker.poses.capture import solve_capture
from lambent_worker.poses.photographs import find_photographs, lay_out
from lambent_worker.poses.solve import Solution
from lambent_worker.scenes.problems import Problems
from PIL import Image
from support.captures import look_at, save

from benchmarks.pose_errors import pose_errors

NAMES = tuple(f"{i}.jpg" for i in range(12))


def around(azimuths_deg):
    """Return OpenCV poses that look at the origin from these azimuths, by name."""
    poses = {}
    for name, azimuth in zip(NAMES, np.radians(azimuths_deg), strict=False):
        pose = look_at(4.0 * np.array([np.cos(azimuth), np.sin(azimuth), 0.4]))
        pose[:3, 1:3] *= -1.0
        poses[name] = pose
    return poses


def advice(**changes):
    values = {
        "names": NAMES,
        "features": (2000,) * 12,
        "partners": dict.fromkeys(NAMES, ("0.jpg", 500)),
        "camera_to_world": around(np.arange(12) * 30.0),
        "reprojection_error_px": 0.6,
    }
    problems = Problems()
    advise(Solution(**{**values, **changes}), PoseLimits(), problems)
    return [(finding.code, finding.message) for finding in problems.findings()]


def test_nothing_is_said_where_all_went_well():
    assert advice() == []


def test_missing_photographs_with_few_points_need_texture():
    found = around(np.arange(11) * 33.0)
    ((code, message),) = advice(camera_to_world=found, features=(2000,) * 11 + (40,))
    assert code == "scene.poses_incomplete"
    assert "11 of 12 photographs; left out are 11.jpg" in message
    assert "11.jpg: 40" in message
    assert "printed paper" in message


def test_a_missing_photograph_without_neighbours_names_the_nearest():
    found = around(np.arange(11) * 33.0)
    ((_, message),) = advice(camera_to_world=found, partners={"11.jpg": ("4.jpg", 17)})
    assert "11.jpg fits 4.jpg best, by 17 points only" in message


def test_less_than_half_is_refused():
    codes = [code for code, _ in advice(camera_to_world=around(np.arange(5) * 30.0))]
    assert codes[0] == "scene.poses_few"


def test_a_second_group_and_large_errors_are_named():
    said = dict(advice(other_models=(("3.jpg", "4.jpg", "5.jpg"),), reprojection_error_px=2.2))
    assert "3.jpg, 4.jpg, 5.jpg" in said["scene.poses_split"]
    assert "2.2 pixels" in said["scene.poses_inexact"]


def test_a_lens_that_is_too_wide_is_doubted():
    assert advice(field_deg=88.0) == []
    ((code, message),) = advice(field_deg=104.0)
    assert code == "scene.poses_lens"
    assert "104 degrees" in message


def test_the_widest_gap_is_between_its_neighbours():
    angles = [*range(0, 200, 20), 300, 330]
    degrees, first, second = widest_gap(around(angles))
    assert degrees == pytest.approx(120.0, abs=1.0)
    assert {first, second} == {"9.jpg", "10.jpg"}


def test_pose_errors_forget_a_similarity_and_nothing_else():
    true = np.array(list(around(np.arange(12) * 30.0).values()))
    turn = look_at(np.array([1.0, 2.0, 3.0]))[:3, :3]
    moved = true.copy()
    moved[:, :3, :3] = turn @ true[:, :3, :3]
    moved[:, :3, 3] = 0.3 * true[:, :3, 3] @ turn.T + [5.0, 6.0, 7.0]
    rotation, centre = pose_errors(moved, true)
    assert rotation.max() < 1e-4
    assert centre.max() < 1e-9
    moved[3, :3, 3] += 0.3 * 0.4
    assert pose_errors(moved, true)[1].argmax() == 3
    # A reflection is no similarity that a camera can follow.
    true[::2, 2, 3] += 1.5
    true[::3, 0, 3] += 1.0
    mirrored = true * np.array([1.0, 1.0, -1.0, 1.0])[:, None]
    assert pose_errors(mirrored, true)[1].max() > 0.05


def test_photographs_are_laid_out_with_masks_named_as_colmap_wants_them(tmp_path):
    for name in ("a.png", "b.webp", "sub/c.png"):
        save(tmp_path / "in" / name, np.full((8, 8, 3), 90, dtype=np.uint8))
        save(tmp_path / "cut" / f"{name.rsplit('/')[-1]}", np.full((8, 8), 255, dtype=np.uint8))
    problems = Problems()
    photographs = find_photographs(tmp_path / "in", tmp_path / "cut", problems)
    given = lay_out(photographs, tmp_path / "out", problems)
    assert not problems.findings()
    assert given == {"a.png": "a.png", "b.webp": "b.png", "sub/c.png": "sub/c.png"}
    made = sorted(p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*.png"))
    assert made == [
        *(f"images/{name}" for name in given.values()),
        *(f"masks/{name}.png" for name in given.values()),
    ]


def test_alpha_of_the_photographs_is_their_mask(tmp_path):
    pixels = np.full((8, 8, 4), 255, dtype=np.uint8)
    pixels[:, :4, 3] = 0
    for number in range(3):
        save(tmp_path / "in" / f"{number}.png", pixels)
    problems = Problems()
    lay_out(find_photographs(tmp_path / "in", None, problems), tmp_path / "out", problems)
    with Image.open(tmp_path / "out" / "masks" / "1.png.png") as mask:
        assert np.array_equal(np.asarray(mask), pixels[..., 3])
    save(tmp_path / "in" / "1.png", pixels[..., :3])
    assert find_photographs(tmp_path / "in", None, problems) is None
    assert "2 of 3 photographs have a transparent background, but not 1.png" in problems.findings()[0].message


def test_a_photograph_that_cannot_be_read_does_not_shift_the_names(tmp_path):
    pixels = np.full((8, 8, 4), 255, dtype=np.uint8)
    pixels[:, :4, 3] = 0
    for number, channels in ((1, 4), (2, 3), (3, 4)):
        save(tmp_path / "in" / f"{number}.png", pixels[..., :channels])
    (tmp_path / "in" / "0.png").write_bytes(b"no picture")
    problems = Problems()
    assert find_photographs(tmp_path / "in", None, problems) is None
    found = {finding.code: finding.message for finding in problems.findings()}
    assert (
        "2 of 3 photographs have a transparent background, but not 2.png" in found["scene.mask_file_missing"]
    )


def codes_of(folder, masks=None):
    problems = Problems()
    photographs = find_photographs(folder, masks, problems)
    if photographs is not None:
        lay_out(photographs, folder.parent / "out", problems)
    return [(finding.code, finding.subject) for finding in problems.findings()]


def test_each_fault_of_a_photograph_or_mask_is_named(tmp_path):
    folder, masks = tmp_path / "in", tmp_path / "cut"
    for number in range(3):
        save(folder / f"{number}.png", np.full((8, 8, 3), 90, dtype=np.uint8))
        save(masks / f"{number}.png", np.full((8, 8), 255, dtype=np.uint8))
    save(masks / "1.png", np.zeros((8, 8), dtype=np.uint8))
    save(masks / "2.png", np.full((4, 8), 255, dtype=np.uint8))
    assert codes_of(folder, masks) == [("scene.mask_empty", "1.png"), ("scene.mask_size", "2.png")]
    (masks / "0.png").unlink()
    assert codes_of(folder, masks) == [("scene.mask_file_missing", "0")]
    (folder / "1.png").write_text("no picture")
    assert ("scene.image_not_a_picture", "1.png") in codes_of(folder)
    assert codes_of(tmp_path / "nowhere")[0][0] == "scene.too_few_images"


def test_without_pycolmap_the_extra_is_named(tmp_path, monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(UsageError, match=r"config\.poses_missing: .*pip install 'lambent\[poses\]'"):
        solve_capture(tmp_path, tmp_path / "out")


def test_a_folder_with_something_else_is_left_alone(tmp_path):
    pytest.importorskip("pycolmap", reason="needs the extra poses")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("")
    with pytest.raises(UsageError, match=r"config\.poses_folder"):
        solve_capture(tmp_path, tmp_path / "out")

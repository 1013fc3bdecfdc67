"""Photographs without cameras are checked one by one, in the child that may do nothing else."""

import numpy as np
from lambent_capture.checks.check import check_capture
from lambent_capture.checks.check_result import capture_record
from support.captures import save


def photograph(number):
    """Return a picture that has detail and that no other one resembles."""
    return np.random.default_rng(number).integers(0, 255, (240, 320, 3)).astype(np.uint8)


def write(folder, count=4):
    for number in range(count):
        save(folder / f"IMG_{number}.png", photograph(number))
    return folder


def test_photographs_can_be_used_and_are_shown(tmp_path):
    checked = check_capture(write(tmp_path / "phone"))
    assert checked.report.usable
    assert checked.report.layout == "photographs"
    assert checked.report.num_train_frames == 4
    assert checked.figures.lacks_cameras
    assert not checked.figures.has_masks
    assert set(checked.thumbnails) == {f"IMG_{number}" for number in range(4)}
    assert len(capture_record(checked)["figures"]["views"]) == 4


def test_a_broken_one_is_left_out_and_named(tmp_path):
    folder = write(tmp_path / "phone", 5)
    whole = (folder / "IMG_2.png").read_bytes()
    (folder / "IMG_2.png").write_bytes(whole[: len(whole) // 2])
    checked = check_capture(folder)
    assert checked.report.usable
    assert checked.left_out == ("IMG_2.png",)
    assert checked.report.num_train_frames == 4
    assert any("IMG_2.png" in finding.message for finding in checked.report.findings)


def test_two_photographs_are_refused_with_what_is_needed(tmp_path):
    checked = check_capture(write(tmp_path / "phone", 2))
    assert not checked.report.usable
    assert checked.figures is None
    (finding,) = [each for each in checked.report.findings if each.code == "scene.too_few_images"]
    assert "3 are needed" in finding.message

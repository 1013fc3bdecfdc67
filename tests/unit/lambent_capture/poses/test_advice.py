"""Advice on found cameras names the photographs and what to do."""

import numpy as np
import pytest
from lambent_capture.poses.advice import PoseLimits, advise, widest_gap
from lambent_capture.poses.solution import Fault, Solution
from lambent_capture.problems import Problems
from support.captures import look_at

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
        "faults": {},
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


def test_a_photograph_that_could_not_be_used_is_named_once():
    found = around(np.arange(11) * 33.0)
    fault = Fault(code="scene.image_broken", message="11.jpg cannot be decoded")
    ((code, message),) = advice(camera_to_world=found, faults={"11.jpg": fault})
    assert (code, message) == ("scene.image_broken", "11.jpg cannot be decoded; it was left out")


def test_photographs_of_which_most_could_not_be_used_are_refused():
    problems = Problems()
    fault = Fault(code="scene.mask_empty", message="shows nothing")
    solution = Solution(
        names=NAMES, features=(0,) * 12, partners={}, camera_to_world={}, faults=dict.fromkeys(NAMES, fault)
    )
    advise(solution, PoseLimits(), problems)
    assert not problems.usable
    assert {finding.code for finding in problems.findings()} == {"scene.mask_empty"}


def test_a_turntable_is_said_plainly():
    ((code, message),) = advice(static_background=True, still_share=0.93)
    assert code == "scene.static_background"
    assert "93 %" in message
    assert "--light-fixed-to camera" in message


def test_one_view_and_one_spot_have_reasons_of_their_own():
    ((_, message),) = advice(camera_to_world={}, nothing_moved=True)
    assert "all show the same view" in message
    ((_, message),) = advice(camera_to_world={}, flat_share=0.95)
    assert "taken from one spot" in message


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
    # A reflection is not a similarity that a camera can follow.
    true[::2, 2, 3] += 1.5
    true[::3, 0, 3] += 1.0
    mirrored = true * np.array([1.0, 1.0, -1.0, 1.0])[:, None]
    assert pose_errors(mirrored, true)[1].max() > 0.05


@pytest.mark.parametrize("error_px", [2.6e156, float("nan"), float("inf"), 17.0])
def test_an_error_that_no_right_camera_has_is_refused_and_never_printed(error_px):
    ((code, message),) = advice(reprojection_error_px=error_px)
    assert code == "scene.poses_unusable"
    assert ("17.0" if error_px == 17.0 else "not usable") in message
    assert "fixed zoom" in message

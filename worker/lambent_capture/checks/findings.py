"""Turns figures into findings: what is wrong, where, and what to do."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from lambent_core.measured import measured, significant
from lambent_proto.v1 import capture_pb2

from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.problems import Problems


@dataclass(frozen=True, slots=True)
class _Complaint:
    """One view that is over a limit."""

    name: str
    subject: str
    """Frame, or file where it is about one."""
    badness: float
    """Orders the worst first."""
    what: str
    """The problem, as the middle of a sentence."""


def note_findings(
    figures: capture_pb2.CaptureFigures,
    limits: CaptureLimits,
    problems: Problems,
    *,
    box_is_stated: bool = True,
) -> None:
    """Note in `problems` everything in `figures` that is over its limit; all of it are warnings.

    A box that the capture does not state (`box_is_stated`) is fitted to the masks later, so it is never too
    small.
    """
    _note_views(figures, limits, problems)
    clipped = _of_pictures(figures, lambda p: p.clipped_share, limits.clipped_share, _clipped)
    advice = "expose less, or light more softly: what is clipped is lost"
    _note("scene.image_clipped", clipped, advice, limits, problems)
    blurred = _of_pictures(figures, _blur, 1.0 - limits.sharpness, _blurred)
    advice = "take it again in focus and without motion, or leave the frame out"
    _note("scene.image_blurred", blurred, advice, limits, problems)
    doubted = _note_masks(figures, limits, problems) if figures.has_masks else frozenset()
    if figures.has_hull:
        _note_exposure(figures, doubted, limits, problems)
    if box_is_stated and figures.outside_box_share > limits.outside_box_share:
        problems.warning(
            "scene.object_outside_box",
            f"{_percent(figures.outside_box_share)} of the object lie outside of the scene's box, where "
            "detail is lost; state a larger box, or move and scale the poses",
        )


def _note_views(figures: capture_pb2.CaptureFigures, limits: CaptureLimits, problems: Problems) -> None:
    if figures.num_train_views < limits.few_views:
        problems.warning(
            "scene.views_few",
            f"there are {figures.num_train_views} photographs to train on; below {limits.few_views} the "
            "shape between them is guesswork, 40 and more are recommended",
        )
    if figures.upper_gap_deg > limits.gap_deg:
        problems.warning(
            "scene.views_gap",
            f"no photograph was taken within {measured(figures.upper_gap_deg)} degrees of azimuth "
            f"{measured(figures.upper_gap_azimuth_deg)}, elevation "
            f"{measured(figures.upper_gap_elevation_deg)} degrees "
            f"(the views reach from {measured(figures.lowest_elevation_deg)} to "
            f"{measured(figures.highest_elevation_deg)} degrees above the horizon); add some from there",
        )


def _note_masks(
    figures: capture_pb2.CaptureFigures, limits: CaptureLimits, problems: Problems
) -> frozenset[str]:
    """Note what is wrong with masks and poses; return the views whose points cannot be trusted."""
    if not figures.has_hull and len(figures.views) >= limits.min_views_for_hull:
        problems.warning(
            "scene.poses_inconsistent",
            "the silhouettes have no common object in the scene's box: poses, focal length or masks do not "
            "belong together; check the axes of the poses and that each mask belongs to its picture",
        )
        return frozenset()
    usual_mismatch = float(np.median([view.mismatch_ev for view in figures.views]))
    # A hole in many masks is one in the object.
    holed = [view.name for view in figures.views if view.hole_share > limits.missing_share]
    holed = holed if len(holed) <= limits.max_holed_share * len(figures.views) else []
    turned, leaking, missing, specks, cut = [], [], [], [], []
    for view in figures.views:
        leak, hole = view.unexplained_share, view.carved_share
        if view.name in holed:
            hole = max(hole, view.hole_share)
        doubtful = leak > limits.unexplained_share or hole > limits.missing_share
        if leak > limits.misplaced_share or (doubtful and view.moved_share < limits.moved_share):
            what = f"its silhouette differs by {_percent(max(leak, hole))} from what the others agree on, and"
            turned.append(_Complaint(view.name, view.name, max(leak, hole), f"{what} would fit elsewhere"))
        elif doubtful and leak / limits.unexplained_share >= hole / limits.missing_share:
            what = f"{_percent(leak)} of its mask show something that no other view confirms"
            leaking.append(_Complaint(view.name, view.name, leak, what))
        elif doubtful:
            what = f"its mask leaves out {_percent(hole)} that other views show"
            missing.append(_Complaint(view.name, view.name, hole, what))
        elif view.mismatch_ev > max(limits.mismatch_ev, 2.0 * usual_mismatch):
            what = f"points of the object look different in it by {measured(view.mismatch_ev, 1)} EV"
            turned.append(_Complaint(view.name, view.name, 0.1 * view.mismatch_ev, what))
        elif view.speck_share > limits.speck_share and view.num_specks >= limits.min_specks:
            what = f"its mask has {view.num_specks} specks"
            specks.append(_Complaint(view.name, view.name, view.speck_share, what))
        elif view.border_share > limits.border_share:
            what = f"the mask covers {_percent(view.border_share)} of its border"
            cut.append(_Complaint(view.name, view.name, view.border_share, what))
    for code, complaints, advice in (
        ("scene.pose_inconsistent", turned, "solve its pose again, or leave the frame out"),
        ("scene.mask_leak", leaking, "cut the background out"),
        ("scene.mask_incomplete", missing, "fix the mask, or leave the frame out"),
        ("scene.mask_specks", specks, "clean the mask: remove islands of a few pixels"),
        ("scene.mask_border", cut, "show the whole object, or fix the mask"),
    ):
        _note(code, complaints, advice, limits, problems)
    return frozenset(each.name for each in (*turned, *leaking, *missing))


def _note_exposure(
    figures: capture_pb2.CaptureFigures, doubted: frozenset[str], limits: CaptureLimits, problems: Problems
) -> None:
    advice = (
        "fix exposure and white balance, or state the exposure of each picture; training evens out what it "
        "can tell from how the object looks"
    )
    if figures.exposure_range_ev > limits.drift_ev:
        problems.warning(
            "scene.exposure_drift",
            f"the same points of the object differ by {measured(figures.exposure_range_ev, 1)} EV between "
            "pictures; " + advice,
        )
        return
    jumps = [picture.exposure_jump_ev for view in figures.views for picture in view.pictures]
    spread = 1.4826 * float(np.median(np.abs(np.array(jumps) - np.median(jumps)))) if jumps else 0.0
    limit = max(limits.exposure_ev, limits.exposure_spread * spread)
    complaints = _of_pictures(figures, lambda p: abs(p.exposure_jump_ev), limit, _exposed)
    complaints = [each for each in complaints if each.name not in doubted]
    _note("scene.exposure_drift", complaints, advice, limits, problems)


def _of_pictures(
    figures: capture_pb2.CaptureFigures,
    badness: Callable[[capture_pb2.PictureFigures], float],
    limit: float,
    describe: Callable[[capture_pb2.PictureFigures], str],
) -> list[_Complaint]:
    return [
        _Complaint(view.name, picture.path, badness(picture), describe(picture))
        for view in figures.views
        for picture in view.pictures
        if badness(picture) > limit
    ]


def _blur(picture: capture_pb2.PictureFigures) -> float:
    """Return the lack of sharpness, 0 if it could not be measured."""
    return 1.0 - picture.sharpness if picture.sharpness > 0.0 else 0.0


def _clipped(picture: capture_pb2.PictureFigures) -> str:
    return f"{_percent(picture.clipped_share)} of the object are clipped"


def _blurred(picture: capture_pb2.PictureFigures) -> str:
    return f"it has {_percent(picture.sharpness)} of the fine detail of the sharpest pictures"


def _exposed(picture: capture_pb2.PictureFigures) -> str:
    how = "brighter" if picture.exposure_jump_ev > 0.0 else "darker"
    jump = measured(abs(picture.exposure_jump_ev), 1)
    return f"it is {jump} EV {how} than its neighbours show the same points"


def _note(
    code: str, complaints: Sequence[_Complaint], advice: str, limits: CaptureLimits, problems: Problems
) -> None:
    """Note each complaint, or one finding with the worst of them where they are many."""
    worst = sorted(complaints, key=lambda each: -each.badness)
    if len(worst) <= limits.max_named_views:
        for each in worst:
            problems.warning(code, f'frame "{each.name}": {each.what}; {advice}', each.subject)
        return
    views = list(dict.fromkeys(each.name for each in worst))
    # A view that was photographed in several lights may complain once for each.
    counted = f"{len(views)} views have this problem"
    if len(worst) > len(views):
        counted += f" ({len(worst)} pictures, because each light counts)"
    named = ", ".join(f'"{name}"' for name in views[: limits.max_named_views])
    problems.warning(code, f"{counted}; the worst are {named}, the first because {worst[0].what}; {advice}")


def _percent(share: float) -> str:
    return f"{significant(100.0 * share, 3)} %"

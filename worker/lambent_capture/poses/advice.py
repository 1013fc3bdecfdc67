"""Reports how well cameras were found, and which photographs to add if necessary."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from lambent_core.measured import measured
from numpy import ndarray

from lambent_capture.checks.sphere import unit_directions
from lambent_capture.poses.solution import Solution
from lambent_capture.problems import Problems
from lambent_capture.scenes.extent import looked_at_point
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.world import common_up


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseLimits:
    """Thresholds of the findings."""

    min_share: float = 0.5
    """Share of the photographs whose cameras must be found; below, the capture is refused."""
    few_features: int = 300
    """Points below which a photograph shows too little texture, or is blurred."""
    few_matches: int = 60
    """Points in common with its best partner below which a photograph has no neighbour."""
    reprojection_error_px: float = 1.0
    """Good solutions have 0.2 to 0.6."""
    unusable_px: float = 16.0
    """No camera is right if points are this far off in the mean, or their error is not a number."""
    field_deg: float = 90.0
    """Wider than most lenses: rather the sign of a pattern that repeats."""
    flat_share: float = 0.8
    """Share of the pairs that a camera which only turned would explain, above which it probably did."""
    gap_deg: float = 45.0
    """Between neighbours on the way around the object; above 25 to 30 matching gets hard."""


def advise(solution: Solution, limits: PoseLimits, problems: Problems) -> None:
    """Note in `problems` what is missing, why, and which photographs to add; nothing if all went well."""
    _note_unreadable(solution, limits, problems)
    if _note_missing(solution, limits, problems):
        _note_doubts(solution, limits, problems)


def _note_unreadable(solution: Solution, limits: PoseLimits, problems: Problems) -> None:
    total = len(solution.names)
    usable = total - len(solution.faults)
    note = problems.warning if usable and usable >= limits.min_share * total else problems.error
    for name, fault in solution.faults.items():
        note(fault.code, f"{fault.message}; it was left out", name)


def _note_missing(solution: Solution, limits: PoseLimits, problems: Problems) -> bool:
    """Note cameras that were not found or cannot be right; return whether the others are worth a look."""
    placed, total = len(solution.camera_to_world), len(solution.names)
    # A photograph that could not be read has a finding of its own.
    known = {*solution.camera_to_world, *solution.faults}
    missing = [name for name in solution.names if name not in known]
    if not placed:
        if missing:
            problems.error(
                "scene.poses_none",
                f"no {total} photographs could be fitted together; {_reason(solution, missing, limits)}",
                missing[0],
            )
        return False
    if not solution.reprojection_error_px <= limits.unusable_px:
        problems.error(
            "scene.poses_unusable",
            "the cameras do not explain the photographs (reprojection error in pixels: "
            f"{measured(solution.reprojection_error_px, 1)}, at most {measured(limits.unusable_px)}); "
            "photograph with fixed zoom and focus, in steps of 10 to 15 degrees, and keep what moves out of "
            "the pictures or give masks",
            solution.names[0],
        )
        return False
    if placed < limits.min_share * total:
        problems.error(
            "scene.poses_few",
            f"cameras were found for {placed} of {total} photographs only, not for {listed(missing)}; "
            f"{_reason(solution, missing, limits)}",
            missing[0],
        )
    elif missing:
        problems.warning(
            "scene.poses_incomplete",
            f"cameras were found for {placed} of {total} photographs; left out are {listed(missing)}; "
            f"{_reason(solution, missing, limits)}",
            missing[0],
        )
    return True


def _note_doubts(solution: Solution, limits: PoseLimits, problems: Problems) -> None:
    """Note what makes cameras that were found inexact, or the object hard to reconstruct from them."""
    if solution.other_models:
        problems.warning(
            "scene.poses_split",
            f"{listed(list(solution.other_models[0]))} fit together, but not to the "
            f"{len(solution.camera_to_world)} others; photograph the way from the ones to the others, a step "
            "of 10 to 15 degrees at a time",
            solution.other_models[0][0],
        )
    if solution.reprojection_error_px > limits.reprojection_error_px:
        problems.warning(
            "scene.poses_inexact",
            f"points are {measured(solution.reprojection_error_px, 1)} pixels away from where the cameras "
            "put them; fix zoom and focus, hold still, and keep what moves out of the pictures or give masks",
        )
    if solution.field_deg > limits.field_deg:
        problems.warning(
            "scene.poses_lens",
            f"the lens would have a field of view of {measured(solution.field_deg)} degrees; if it has not, "
            "the cameras are wrong: something repeats, such as tiles or a fabric, so give masks or cover it",
        )
    if solution.static_background:
        problems.warning(
            "scene.static_background",
            f"the background stands still in {measured(100.0 * solution.still_share)} % of the pairs while "
            "the object moves, as on a turntable; only what moves was used for the cameras. The light then "
            "turns with the camera, seen from the object: train with --light-fixed-to camera",
        )
    gap = widest_gap(solution.camera_to_world)
    if gap is not None and gap[0] > limits.gap_deg:
        problems.warning(
            "scene.poses_gap",
            f"there are {measured(gap[0])} degrees between {gap[1]} and {gap[2]} on the way around the "
            "object; photograph the way between them",
            gap[1],
        )


def widest_gap(camera_to_world: dict[str, Float[ndarray, "4 4"]]) -> tuple[float, str, str] | None:
    """Return the widest angle [deg] between neighbours on the way around the object, and the two.

    Around means about the direction that cameras held level have in common as up; None where there is none,
    or they look at no common point.
    """
    names = sorted(camera_to_world)
    poses = np.array([camera_to_world[name] for name in names])
    if len(names) < 3:
        return None
    centre = looked_at_point(poses[:, :3, 3], poses[:, :3, 2])
    up = common_up(poses * np.array([1.0, -1.0, -1.0, 1.0]))
    if centre is None or up is None:
        return None
    across = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    across /= np.linalg.norm(across)
    directions = unit_directions(poses[:, :3, 3], centre)
    azimuths = np.degrees(np.arctan2(directions @ np.cross(up, across), directions @ across))
    order = np.argsort(azimuths)
    steps = np.diff(azimuths[order], append=azimuths[order[0]] + 360.0)
    widest = int(steps.argmax())
    return float(steps[widest]), names[order[widest]], names[order[(widest + 1) % len(names)]]


def _reason(solution: Solution, missing: list[str], limits: PoseLimits) -> str:
    """Return the most common problem of the missing photographs, and what to do about it."""
    if solution.nothing_moved:
        return (
            "they all show the same view: walk around the object, a step of 10 to 15 degrees at a time, or "
            "turn it on a plate with a pattern"
        )
    features = dict(zip(solution.names, solution.features, strict=True))
    plain = [name for name in missing if features[name] < limits.few_features]
    if 2 * len(plain) >= len(missing):
        fewest = min(plain, key=features.__getitem__)
        return (
            f"they show too few points to recognise ({fewest}: {features[fewest]}): photograph sharper and "
            "larger, put printed paper with text or pictures under the object, and dull what mirrors"
        )
    if not solution.camera_to_world and solution.flat_share >= limits.flat_share:
        return (
            "they were taken from one spot, or show nothing but one flat thing: walk around the object "
            "instead of turning the camera"
        )
    lonely = [name for name in missing if solution.partners.get(name, ("", 0))[1] < limits.few_matches]
    if lonely:
        name = lonely[0]
        partner, common = solution.partners.get(name, ("", 0))
        if not partner:
            return f"{name} has nothing in common with any other: photograph around it in small steps"
        return (
            f"{name} fits {partner} best, by {common} points only: photograph the way between them, a step "
            "of 10 to 15 degrees at a time"
        )
    return (
        "they fit each other, but not the rest: photograph the way to the rest, and look for parts of the "
        "object, or of its surroundings, that look alike from several sides"
    )

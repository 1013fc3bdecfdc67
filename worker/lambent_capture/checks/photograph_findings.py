"""Turns the figures of photographs without cameras into findings: what is wrong, where, and what to do."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from lambent_core.measured import measured

from lambent_capture.checks.photograph_limits import PhotographLimits
from lambent_capture.checks.photographs import (
    MASK_AMONG_PHOTOGRAPHS,
    PhotographFigures,
    PhotographsFigures,
)
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed

LIMITS = PhotographLimits()
_Fault = tuple[str, Sequence[PhotographFigures], str, str]
"""Code, photographs, what they are, and what to do."""
_FRAME_NAME = re.compile(r"(?i).*(frame|still|vlcsnap|img|out|image)?[-_ ]?\d{3,}$")
_CAMERA_FOLDER = re.compile(r"[1-9]\d\d\w{5}")
"""Folders that cameras make for every so many photographs: three digits and five letters (DCF), 100CANON."""
_VIDEO_SHAPES = (16 / 9, 9 / 16, 4 / 3, 3 / 4, 256 / 135, 135 / 256)
_VIDEO_SIDES = frozenset({480, 540, 576, 720, 1080, 1440, 2160, 4320})
_SCREEN_ASPECTS = (1.5, 2.25)
"""Long over short side of screens: from tablets at 3:2 to telephones at 20:9."""


def note_photographs(
    figures: PhotographsFigures, problems: Problems, limits: PhotographLimits = LIMITS
) -> None:
    """Note in `problems` everything in `figures` that is over its limit.

    Errors are only what nothing can come of: fewer than three different photographs. The rest are warnings.
    """
    if not _note_numbers(figures, limits, problems):
        return
    usable = figures.usable
    _note_each(usable, limits, problems)
    _note_alike(usable, limits, problems)
    _note_folders(usable, limits, problems)
    if _look_like_video(usable):
        problems.warning(
            "scene.video_frames",
            f"the {len(usable)} photographs seem to be frames of a video: compressed, and read out line by "
            "line while the camera moves, which bends what they show; photographs give a better result, or "
            "move slowly",
        )
    if figures.exposure_range_ev > limits.exposure_ev:
        problems.warning(
            "scene.exposure_spread",
            f"the photographs differ in brightness by {measured(figures.exposure_range_ev, 1)} EV; fix the "
            "exposure (on a telephone: hold the finger on the object until it is locked)",
        )


def _note_numbers(figures: PhotographsFigures, limits: PhotographLimits, problems: Problems) -> bool:
    """Note photographs that cannot be used; return whether there are enough of the others."""
    faulty = [each for each in figures.photographs if each.fault]
    total, usable = len(figures.photographs), figures.usable
    enough = len(usable) >= limits.min_photographs
    broken = [each for each in faulty if each.fault != MASK_AMONG_PHOTOGRAPHS]
    note = problems.warning if enough and len(broken) <= len(usable) else problems.error
    for code in sorted({each.fault for each in faulty}):
        rows = [each for each in faulty if each.fault == code]
        by_reason: dict[str, list[str]] = {}
        for each in rows:
            by_reason.setdefault(each.reason, []).append(each.name)
        said = "; ".join(
            f"{listed(names)} {why}" for why, names in list(by_reason.items())[: limits.max_named]
        )
        more = "; and others" if len(by_reason) > limits.max_named else ""
        note(code, f"{len(rows)} of {total} photographs cannot be used: {said}{more}", rows[0].name)
    if not enough:
        problems.error(
            "scene.too_few_images",
            f"{len(usable)} of {total} photographs can be used; {limits.min_photographs} are needed at "
            "least, 40 are good",
        )
        return False
    if all(each.is_like_a_mask for each in usable):
        problems.error(
            "scene.only_masks",
            f"all {len(usable)} pictures are black and white, as masks are; add the photographs they "
            "belong to",
        )
        return False
    blank = [each for each in usable if each.deviation < limits.blank_levels]
    shown = sum(each.deviation >= limits.blank_levels and not each.same_as for each in usable)
    if shown < limits.min_photographs:
        _note_nothing_to_see(figures, len(blank), shown, problems)
        return False
    if len(usable) < limits.few_photographs:
        problems.warning(
            "scene.views_few",
            f"there are {len(usable)} photographs; below {limits.few_photographs} the shape between them is "
            "guesswork, 40 and more are recommended",
        )
    return True


def _note_nothing_to_see(figures: PhotographsFigures, num_blank: int, shown: int, problems: Problems) -> None:
    usable = figures.usable
    if num_blank * 2 > len(usable):
        problems.error(
            "scene.image_blank",
            f"{num_blank} of {len(usable)} photographs show one colour and nothing else; look at them, and "
            "take them again with light",
        )
        return
    problems.error(
        "scene.photographs_same",
        f"the {len(usable)} photographs show {shown} different views, at least 3 are needed: the rest repeat "
        "another, because files were copied or because neither camera nor object moved; move the camera "
        "around the object by 10 degrees between photographs",
        next(each.name for each in usable if each.same_as),
    )


def _note_each(usable: Sequence[PhotographFigures], limits: PhotographLimits, problems: Problems) -> None:
    """Note the photographs with each kind of fault."""
    for code, rows, what, advice in (*_by_look(usable, limits), *_by_file(usable, limits)):
        if rows:
            named = listed([each.name for each in rows])
            problems.warning(code, f"{what}: {named}; {advice}", rows[0].name)


def _by_look(usable: Sequence[PhotographFigures], limits: PhotographLimits) -> Iterator[_Fault]:
    """Yield the kinds of faults that photographs show, each with those that have it."""
    blurred = [each for each in usable if 0.0 < each.sharpness < limits.sharpness]
    screens = [each for each in usable if _is_screenshot(each, limits)]
    bright = [each for each in usable if each.clipped_share > limits.clipped_share and each not in screens]
    percent = measured(100.0 * limits.clipped_share)
    yield (
        "scene.image_blank",
        [each for each in usable if each.deviation < limits.blank_levels],
        "photographs of one colour and nothing else",
        "leave them out",
    )
    yield (
        "scene.image_blurred",
        sorted(blurred, key=lambda each: each.sharpness),
        f"blurred photographs, with less than {measured(100.0 * limits.sharpness)} % of the fine detail "
        "of the sharpest",
        "take them again in focus and without motion, or leave them out",
    )
    yield (
        "scene.image_clipped",
        sorted((each for each in bright if not each.has_alpha), key=lambda each: -each.clipped_share),
        f"photographs that are overexposed in more than {percent} % of their area",
        "what is clipped on the object is lost, so expose less",
    )
    yield ("scene.screenshot", screens, "screenshots, by their look", "use the photographs themselves")
    yield (
        "scene.panorama",
        [each for each in usable if each.is_panorama or _aspect(each) > limits.panorama_aspect],
        "panoramas, which no single position of a camera explains",
        "leave them out and take single photographs",
    )
    yield (
        "scene.animation",
        [each for each in usable if each.num_pictures > 1],
        "animations, of which the first picture is used",
        "save single photographs",
    )


def _by_file(usable: Sequence[PhotographFigures], limits: PhotographLimits) -> Iterator[_Fault]:
    """Yield the kinds of faults that files state or share with others, each with those that have it."""
    yield (
        "scene.fisheye",
        [each for each in usable if _is_fisheye(each, limits)],
        "photographs through a fisheye or an extremely wide lens, which is not modelled",
        "use the ordinary lens of the camera (on a telephone: 1x)",
    )
    for doubt in sorted({each.colour_doubt for each in usable if each.colour_doubt}):
        yield (
            "scene.colour_profile",
            [each for each in usable if each.colour_doubt == doubt],
            f"photographs each of which {doubt}",
            "export them again if they look wrong",
        )
    yield (
        "scene.mirrored",
        [each for each in usable if each.facts.is_mirrored],
        "photographs that are stored as mirror images, as their EXIF says, and are mirrored back",
        "remove the EXIF orientation if writing on the object reads backwards now",
    )
    yield (
        "scene.exif_wrong",
        [each for each in usable if _was_cropped(each, limits)],
        "photographs of another shape than the camera wrote, so cropped or stretched afterwards",
        "the focal length in their EXIF is not theirs any more, so use the originals",
    )
    yield (
        "scene.exif_wrong",
        [each for each in usable if _is_impossible(each)],
        "photographs with impossible EXIF (a focal length above 3000 mm, or an exposure above an hour)",
        "remove the EXIF or use the originals",
    )
    yield (
        "scene.image_duplicate",
        [each for each in usable if each.is_copy],
        "copies of other photographs",
        "they add nothing, so remove them",
    )
    yield (
        "scene.photographs_alike",
        [each for each in usable if each.same_as and not each.is_copy],
        "photographs of the same view as another",
        "they add nothing",
    )


def _note_alike(usable: Sequence[PhotographFigures], limits: PhotographLimits, problems: Problems) -> None:
    alike = [each for each in usable if each.alike]
    if len(alike) > limits.alike_share * len(usable):
        problems.warning(
            "scene.photographs_alike",
            f"{len(alike)} of {len(usable)} photographs are almost equal to another ({alike[0].name} to "
            f"{alike[0].alike}); either they add little, or the camera stood still while the object turned",
            alike[0].name,
        )


def _note_folders(usable: Sequence[PhotographFigures], limits: PhotographLimits, problems: Problems) -> None:
    """Note photographs in several folders, each with enough for a capture, but not a camera's own."""
    counts = Counter(PurePosixPath(each.name).parent for each in usable)
    theirs = [each for each in counts if not _CAMERA_FOLDER.fullmatch(each.name)]
    enough = all(counts[each] >= limits.folder_photographs for each in theirs)
    if len(theirs) > 1 and enough:
        names = sorted(each.as_posix() for each in theirs)
        problems.warning(
            "scene.photographs_in_folders",
            f"the photographs of {len(names)} folders ({listed(names)}) are taken for one capture; if each "
            "shows an object of its own, check and train each folder alone",
        )


def _look_like_video(usable: Sequence[PhotographFigures]) -> bool:
    """Return whether all were numbered by a program, have one size of a video, and know of no camera."""
    sizes = {(each.width, each.height) for each in usable}
    if len(sizes) != 1 or len(usable) < 4:
        return False
    (size,) = sizes
    video = min(size) in _VIDEO_SIDES and any(
        abs(size[0] / size[1] / shape - 1.0) < 0.01 for shape in _VIDEO_SHAPES
    )
    numbered = all(_FRAME_NAME.match(PurePosixPath(each.name).stem) for each in usable)
    return video and numbered and all(each.facts.is_silent for each in usable)


def _is_screenshot(each: PhotographFigures, limits: PhotographLimits) -> bool:
    if "screenshot" in _plain(each.facts.comment) or "screenshot" in _plain(Path(each.name).stem):
        return True
    low, high = _SCREEN_ASPECTS
    drawn = each.name.lower().endswith(".png") and each.facts.is_silent and not each.has_alpha
    return drawn and low <= _aspect(each) <= high and each.flat_share > limits.flat_share


def _is_fisheye(each: PhotographFigures, limits: PhotographLimits) -> bool:
    return "fisheye" in _plain(each.facts.lens) or 0.0 < each.facts.focal_35mm < limits.fisheye_35mm


def _is_impossible(each: PhotographFigures) -> bool:
    facts = each.facts
    return facts.focal_35mm > 3000.0 or facts.focal_mm > 3000.0 or facts.time_s > 3600.0


def _was_cropped(each: PhotographFigures, limits: PhotographLimits) -> bool:
    width, height = each.facts.stated_size
    if not width or not height:
        return False
    stated = max(width, height) / min(width, height)
    return abs(_aspect(each) / stated - 1.0) > limits.cropped_aspect


def _aspect(each: PhotographFigures) -> float:
    return max(each.width, each.height) / max(min(each.width, each.height), 1)


def _plain(text: str) -> str:
    return re.sub(r"[^a-z]", "", text.lower())

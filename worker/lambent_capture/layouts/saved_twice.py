"""Tells which files are one photograph: raw and JPEG, and second files that telephones write beside some.

Pixel telephones write `PXL_1.RAW-01.COVER.jpg` and `PXL_1.RAW-02.ORIGINAL.dng`, `PXL_1.PORTRAIT-01.COVER.jpg`
and `...-02.ORIGINAL.jpg`, and mark the cover of a series `..._BURST001_COVER.jpg`; iOS writes what was edited
as `IMG_E1234` beside `IMG_1234`, other programs as `IMG_1234~2` or `IMG_1234-edited`.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from pathlib import PurePosixPath

from lambent_core.layouts import RAW_SUFFIXES

from lambent_capture.layouts.named_files import folded
from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.pictures.raw_pictures import raw_available
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed

_PREFERRED = (".tif", ".tiff", ".heic", ".heif", ".avif", ".jpg", ".jpeg", ".png", ".webp", ".exr", ".hdr")
_SECOND = 1
"""Rank of a file that was made from another one of the same photograph."""

# Each with what the photograph is called, and the rank of the file.
_FORMS = (
    # Modes in capitals, the last with a number: .NIGHT.RAW-01.MP.COVER
    (re.compile(r"(.+?)(?:\.[A-Z_]+)*\.[A-Z_]+-\d\d(?:\.MP)?\.ORIGINAL(?:\.MP)?"), r"\1", 0),
    (re.compile(r"(.+?)(?:\.[A-Z_]+)*\.[A-Z_]+-\d\d(?:\.MP)?\.(?:COVER|MAIN)(?:\.MP)?"), r"\1", _SECOND),
    # The cover of a portrait has its background blurred.
    (re.compile(r"\d{5}d?PORTRAIT_\d{5}_(BURST\d+)_COVER"), r"\1 portrait", _SECOND),
    (re.compile(r"\d{5}d?PORTRAIT_\d{5}_(BURST\d+)"), r"\1 portrait", 0),
    (re.compile(r"(.*BURST\d+)_COVER"), r"\1", _SECOND),
    (re.compile(r"IMG_E(\d{4,})"), r"IMG_\1", _SECOND),
    (
        re.compile(r"(.+?)(?:~\d+|[-_ ](?:edited|edit|bearbeitet|modifi\u00e9|editado))", re.IGNORECASE),
        r"\1",
        _SECOND,
    ),
)


def one_of_each(names: Sequence[str], problems: Problems) -> tuple[str, ...]:
    """Return one file of each photograph, in order, after noting in `problems` which are not used.

    Raw files are used where every photograph has one and they can be read here: developed by the camera they
    would look different. Then originals go before what was made from them, and HEIC before JPEG.
    """
    groups: dict[str, list[tuple[int, str]]] = defaultdict(list)
    for name in names:
        key, rank = _photograph(name)
        groups[key].append((rank, name))
    every_raw = raw_available() and all(any(_is_raw(name) for _, name in group) for group in groups.values())
    chosen, doubled = [], []
    for group in groups.values():
        wanted = [each for each in group if _is_raw(each[1]) == every_raw] or group
        best = min(wanted, key=_order)[1]
        chosen.append(best)
        doubled += [name for _, name in group if name != best]
    if doubled:
        doubled.sort()
        used = sorted({PurePosixPath(name).suffix for name in chosen})
        problems.warning(
            "scene.saved_twice",
            f"{len(doubled)} files show a photograph a second time, in another format or edited, and are not "
            f"used ({listed(doubled)}; used: {', '.join(used)}); remove those you do not want",
            doubled[0],
        )
    return tuple(sorted(chosen))


def _photograph(name: str) -> tuple[str, int]:
    """Return a key that all files of a photograph share, and the rank of this one."""
    path = PurePosixPath(name)
    stem = path.stem
    for form, called, rank in _FORMS:
        match = form.fullmatch(stem)
        if match:
            return folded((path.parent / match.expand(called)).as_posix()), rank
    return folded(path.with_suffix("").as_posix()), 0


def _is_raw(name: str) -> bool:
    return name.lower().endswith(RAW_SUFFIXES)


def _order(ranked: tuple[int, str]) -> tuple[int, int, str]:
    rank, name = ranked
    suffix = PurePosixPath(name).suffix.lower()
    order = (*RAW_SUFFIXES, *_PREFERRED, *PICTURE_SUFFIXES)
    return rank, order.index(suffix), name

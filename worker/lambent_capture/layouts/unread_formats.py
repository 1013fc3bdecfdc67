"""Names pictures in formats that are not read, so that none is missing without a word."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.links import files_below

_PICTURES = (
    *(".gif", ".tif", ".tiff", ".bmp", ".avif", ".jp2", ".j2k", ".jpf", ".jpx", ".jxl", ".jxr", ".psd"),
    *(".jfif", ".jpe", ".heics", ".avifs", ".tga", ".ppm", ".pgm", ".pnm", ".pfm", ".dds", ".dpx", ".cin"),
    *(".cr4", ".insp", ".svg", ".pdf", ".xcf", ".kra", ".psb"),
)
_JPEG = frozenset({".jfif", ".jpe"})


def is_unread(name: str) -> bool:
    """Return whether a file of this name is a picture in a format that is not read."""
    suffix = PurePosixPath(name).suffix.lower()
    return suffix in _PICTURES and suffix not in PICTURE_SUFFIXES


def note_unread(folder: Path, problems: Problems) -> None:
    """Note how many pictures of the capture in `folder` have formats that are not read, and what to do."""
    names = [path.relative_to(folder).as_posix() for path in files_below(folder, folder, [])]
    unread = [name for name in names if is_unread(name)]
    if unread:
        problems.warning("scene.image_format", f"{counted(unread)} ({listed(unread)})", unread[0])


def note_only_unread(folder: Path, problems: Problems) -> bool:
    """Return whether `folder` has no picture in such a format, after noting as an error that it has."""
    noted = Problems()
    note_unread(folder, noted)
    for finding in noted.findings():
        problems.error(finding.code, finding.message, finding.subject)
    return noted.usable and not noted.findings()


def counted(names: Sequence[str]) -> str:
    """Return how many files have which format that is not read, and what to do."""
    suffixes = [PurePosixPath(name).suffix.lower() for name in names]
    numbers = ", ".join(f"{number} {suffix}" for suffix, number in sorted(Counter(suffixes).items()))
    return f"{numbers} {'is' if len(names) == 1 else 'are'} not read; {_remedy(suffixes)}"


def _remedy(suffixes: Iterable[str]) -> str:
    kinds = set(suffixes)
    if kinds <= _JPEG:
        return "these are JPEG under another name, so rename them to .jpg"
    return "export what are photographs among them as JPEG or PNG"

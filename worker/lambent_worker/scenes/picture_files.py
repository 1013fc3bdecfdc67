"""Finds the photographs in a folder as people hand them over, with all that telephones and computers add to
it."""

import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from lambent_worker.scenes.frames import listed
from lambent_worker.scenes.pictures import PICTURE_SUFFIXES
from lambent_worker.scenes.problems import Problems
from lambent_worker.scenes.raw_pictures import RAW_SUFFIXES, raw_available

MASK_FOLDERS = frozenset({"mask", "masks"})
MIN_PHOTOGRAPHS = 3
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".3gp")
OTHER_PICTURE_SUFFIXES = (".gif", ".bmp", ".jp2", ".jxl", ".psd", ".svg", ".pdf")
ARCHIVE_SUFFIXES = (".zip", ".rar", ".7z", ".tar", ".gz")
_PREFERRED = (".tif", ".tiff", ".heic", ".heif", ".avif", ".jpg", ".jpeg", ".png", ".webp", ".exr", ".hdr")
_CLUTTER = frozenset({"__macosx", "@eadir", "lost+found", "$recycle.bin"})


def photographs_in(folder: Path, problems: Problems) -> tuple[str, ...]:
    """Return the paths of the photographs below `folder`, in order, with forward slashes.

    Left out are hidden files (`._IMG_1.jpg` of macOS among them) and folders, masks beside photographs, and
    with a note in `problems`: links that lead out of the folder, names that are no text, and all but one file
    of a photograph that a camera saved twice (raw and JPEG). What makes fewer than three photographs of a
    folder is an error.
    """
    files = list(_files(folder, problems))
    pictures = [name for name in files if PurePosixPath(name).suffix.lower() in PICTURE_SUFFIXES]
    photographs = [name for name in pictures if not _is_mask(name)]
    if pictures and not photographs:
        problems.error(
            "scene.only_masks",
            f'"{folder.name}" holds {len(pictures)} masks and no photographs; add the photographs they '
            "belong to",
        )
        return ()
    chosen = _one_of_each(photographs, problems)
    if len(chosen) < MIN_PHOTOGRAPHS:
        problems.error(
            "scene.too_few_images",
            f'"{folder.name}" has {_counted(len(chosen))}; {MIN_PHOTOGRAPHS} are needed at least, 40 are good'
            + _advice(files),
        )
    return chosen


def _files(folder: Path, problems: Problems) -> Iterator[str]:
    """Yield the paths of ordinary files in order; those that cannot be used are noted."""
    inside = folder.resolve()
    linked, unnamed = [], []
    for place, folders, names in os.walk(folder, followlinks=False):
        here = Path(place)
        kept = sorted(name for name in folders if not name.startswith(".") and name.lower() not in _CLUTTER)
        linked += [_shown(here / name, folder) for name in kept if (here / name).is_symlink()]
        folders[:] = [name for name in kept if not (here / name).is_symlink()]
        for name in sorted(names):
            path = here / name
            if name.startswith("."):
                continue
            if not _is_text(path.relative_to(folder).as_posix()):
                unnamed.append(_shown(path, folder))
            elif path.is_symlink() and not _leads_inside(path, inside):
                linked.append(_shown(path, folder))
            elif path.is_file():
                yield path.relative_to(folder).as_posix()
    if linked:
        problems.warning(
            "scene.file_linked",
            f"{listed(linked)}: a link that leads nowhere, to a folder or out of this one is not followed; "
            "copy the "
            "files themselves",
            linked[0],
        )
    if unnamed:
        problems.warning(
            "scene.name_unusable",
            f"{listed(unnamed)}: the name is not readable text, so the file is left out; rename it",
            unnamed[0],
        )


def _leads_inside(path: Path, inside: Path) -> bool:
    try:
        return path.resolve(strict=True).is_relative_to(inside)
    except (OSError, RuntimeError):  # leads nowhere, or in a circle
        return False


def _is_text(name: str) -> bool:
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return all(letter.isprintable() for letter in name)


def _shown(path: Path, folder: Path) -> str:
    name = path.relative_to(folder).as_posix().encode("utf-8", "replace").decode("utf-8")
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def _is_mask(name: str) -> bool:
    return any(part.lower() in MASK_FOLDERS for part in PurePosixPath(name).parts[:-1])


def _one_of_each(names: list[str], problems: Problems) -> tuple[str, ...]:
    """Return one file of each photograph: raw before HEIC before JPEG, as far as they can be read here."""
    twins = defaultdict(list)
    for name in names:
        twins[PurePosixPath(name).with_suffix("").as_posix().casefold()].append(name)
    order = (*RAW_SUFFIXES, *_PREFERRED) if raw_available() else (*_PREFERRED, *RAW_SUFFIXES)
    chosen, doubled = [], []
    for group in twins.values():
        best = min(group, key=lambda name: (order.index(PurePosixPath(name).suffix.lower()), name))
        chosen.append(best)
        doubled += [name for name in group if name != best]
    if doubled:
        used = sorted({PurePosixPath(name).suffix for name in chosen})
        problems.warning(
            "scene.saved_twice",
            f"{len(doubled)} photographs are there in a second format, which is not used "
            f"({listed(doubled)}; used: "
            f"{', '.join(used)}); remove those you do not want",
            doubled[0],
        )
    return tuple(sorted(chosen))


def _counted(count: int) -> str:
    return {0: "no photographs", 1: "one photograph"}.get(count, f"{count} photographs")


def _advice(files: list[str]) -> str:
    """Return what the folder holds instead, as the end of a sentence."""
    suffixes = [PurePosixPath(name).suffix.lower() for name in files]
    video = next((name for name in files if name.lower().endswith(VIDEO_SUFFIXES)), None)
    other = sorted({suffix for suffix in suffixes if suffix in OTHER_PICTURE_SUFFIXES})
    archive = next((name for name in files if name.lower().endswith(ARCHIVE_SUFFIXES)), None)
    if video is not None:
        return f"; take them out of the video: ffmpeg -i {PurePosixPath(video).name} -vf fps=2 frame_%04d.jpg"
    if other:
        return f"; {', '.join(other)} is not read, so export these as JPEG or PNG"
    return f"; unpack {PurePosixPath(archive).name} first" if archive is not None else ""

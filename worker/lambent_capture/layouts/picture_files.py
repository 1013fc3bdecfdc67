"""Finds the photographs in a folder as people hand them over, with all that telephones and computers add to
it."""

from pathlib import Path, PurePosixPath

from lambent_capture.layouts.mask_search import photographs_among
from lambent_capture.layouts.saved_twice import one_of_each
from lambent_capture.layouts.unread_formats import counted, is_unread
from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.links import files_below, note_links, shown_name

MIN_PHOTOGRAPHS = 3
VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".3gp")
MAP_FOLDERS = frozenset(
    {"depth", "depths", "depth_maps", "depth_images", "confidence", "disparity", "normals"}
)
"""Folders, in lower case, of what scanning apps and programs write beside photographs."""
ARCHIVE_SUFFIXES = (".zip", ".rar", ".7z", ".tar", ".gz")


def photographs_in(folder: Path, problems: Problems, within: Path | None = None) -> tuple[str, ...]:
    """Return the paths of the photographs below `folder`, in order, with forward slashes.

    Left out are hidden files (`._IMG_1.jpg` of macOS among them) and folders, masks beside photographs, and
    with a note in `problems`: links that lead out of the capture (`within`, or `folder`), names that are not
    text, formats that are not read, and all but one file of each photograph. What makes fewer than three
    photographs of a folder is an error.
    """
    files = _files(folder, within or folder, problems)
    pictures = [name for name in files if PurePosixPath(name).suffix.lower() in PICTURE_SUFFIXES]
    photographs = _without_maps(photographs_among(pictures), problems)
    if pictures and not photographs:
        problems.error(
            "scene.only_masks",
            f'"{folder.name}" holds {len(pictures)} masks and no photographs; add the photographs they '
            "belong to",
        )
        return ()
    chosen = one_of_each(photographs, problems)
    if len(chosen) < MIN_PHOTOGRAPHS:
        problems.error(
            "scene.too_few_images",
            f'"{folder.name}" has {_counted(len(chosen))}; {MIN_PHOTOGRAPHS} are needed at least, 40 are good'
            + _advice(files),
        )
    return chosen


def _without_maps(names: list[str], problems: Problems) -> list[str]:
    """Return `names` without the maps that scanning apps write beside photographs, which are noted."""
    maps = [name for name in names if MAP_FOLDERS & {part.lower() for part in PurePosixPath(name).parts[:-1]}]
    if not maps or len(maps) == len(names):
        return names
    problems.warning(
        "scene.extra_file",
        f"{len(maps)} pictures in folders of depth or confidence are maps and no photographs "
        f"({listed(maps)}); move them elsewhere if they are photographs",
        maps[0],
    )
    return [name for name in names if name not in set(maps)]


def pictures_below(folder: Path) -> list[str]:
    """Return the paths of all pictures that can be read below `folder`, masks among them, in order."""
    files = _files(folder, folder, Problems())
    return [name for name in files if PurePosixPath(name).suffix.lower() in PICTURE_SUFFIXES]


def _files(folder: Path, within: Path, problems: Problems) -> list[str]:
    """Return the paths of ordinary files in order; those that cannot be used are noted."""
    astray: list[Path] = []
    unnamed, named = [], []
    for path in files_below(folder, within, astray):
        name = path.relative_to(folder).as_posix()
        if _is_text(name):
            named.append(name)
        else:
            unnamed.append(shown_name(path, folder))
    note_links(astray, folder, problems)
    if unnamed:
        problems.warning(
            "scene.name_unusable",
            f"{listed(unnamed)}: the name is not readable text, so the file is left out; rename it",
            unnamed[0],
        )
    return named


def _is_text(name: str) -> bool:
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return all(letter.isprintable() for letter in name)


def _counted(count: int) -> str:
    return {0: "no photographs", 1: "one photograph"}.get(count, f"{count} photographs")


def _advice(files: list[str]) -> str:
    """Return what the folder holds instead, as the end of a sentence."""
    video = next((name for name in files if name.lower().endswith(VIDEO_SUFFIXES)), None)
    other = [name for name in files if is_unread(name)]
    archive = next((name for name in files if name.lower().endswith(ARCHIVE_SUFFIXES)), None)
    if video is not None:
        return f"; take them out of the video: ffmpeg -i {PurePosixPath(video).name} -vf fps=2 frame_%04d.jpg"
    if other:
        return f"; {counted(other)}"
    return f"; unpack {PurePosixPath(archive).name} first" if archive is not None else ""

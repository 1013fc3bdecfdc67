"""Looks at photographs one after the other and keeps the points found in each by its content."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lambent_core.files import digest, file_sha256

from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.poses.features import SURVEY_FEATURES, SURVEY_SIDE, Features, find_features
from lambent_capture.poses.photographs import Photographs, covered_pixels
from lambent_capture.poses.shots import Shot, read_shot
from lambent_capture.poses.solution import Fault

FORMAT = 1
"""Raised when points are found differently, so that none of an earlier version is taken up."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Sight:
    """What was seen in a photograph."""

    shot: Shot
    features: Features
    whole: Features | None
    """Points regardless of masks, at `SURVEY_SIDE`, to tell what stands still; None without masks."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Looked:
    """What was seen in all photographs."""

    sights: dict[str, Sight]
    """By name, those that could be read, in order."""
    faults: dict[str, Fault]
    """The others."""
    key: str
    """Changes with the content of any photograph or mask."""


def look(
    photographs: Photographs,
    folder: Path,
    max_side: int,
    max_features: int,
    told: Callable[[int, int], None] = lambda done, total: None,
) -> Looked:
    """Return the points of all photographs; those that `folder` holds are not looked for again.

    `told` is called with the number of photographs that were looked at, of how many.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sights: dict[str, Sight] = {}
    faults: dict[str, Fault] = {}
    keys = []
    for number, name in enumerate(photographs.names):
        told(number, len(photographs.names))
        try:
            key, sights[name] = _sight(photographs, name, folder, max_side, max_features)
        except PictureError as error:
            key = error.code
            faults[name] = Fault(code=error.code, message=f"{name} {error}")
        keys.append((name, key))
    told(len(photographs.names), len(photographs.names))
    return Looked(sights=sights, faults=faults, key=digest(keys))


def _sight(
    photographs: Photographs, name: str, folder: Path, max_side: int, max_features: int
) -> tuple[str, Sight]:
    """Return a key for the content of a photograph and its mask, and what was seen in it."""
    path = photographs.path(name)
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist")
    shot, content = read_shot(path), file_sha256(path)
    if not photographs.masked:
        key = digest(content, max_side, max_features, FORMAT)
        features = _kept(folder / f"{key}.npz", lambda: find_features(path, max_side, max_features))
        return key, Sight(shot=shot, features=features, whole=None)
    mask = file_sha256(photographs.masks.get(name, path))
    key = digest(content, mask, max_side, max_features, FORMAT)

    def find_covered() -> Features:
        return find_features(path, max_side, max_features, covered_pixels(photographs, name))

    features = _kept(folder / f"{key}.npz", find_covered)
    survey_key = digest(content, SURVEY_SIDE, SURVEY_FEATURES, FORMAT)
    whole = _kept(folder / f"{survey_key}.npz", lambda: find_features(path, SURVEY_SIDE, SURVEY_FEATURES))
    return key, Sight(shot=shot, features=features, whole=whole)


def _kept(path: Path, find: Callable[[], Features]) -> Features:
    """Return the points in a file, after finding them and writing it where it is missing or damaged."""
    try:
        return Features.load(path)
    except (OSError, ValueError, KeyError, EOFError):
        features = find()
        features.save(path)
        return features

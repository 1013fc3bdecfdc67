"""True environments of training lights, found beside a capture: truth for evaluation, never for training."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32
from lambent_core.errors import RelightError, UsageError
from lambent_relight.environment.maps import load_environment
from numpy import ndarray

from lambent_run.report.environment_scores import COLUMNS, ROWS

FOLDER = "envmaps"
"""Where a capture with ground truth keeps its maps."""
MAP_SUFFIXES = (".hdr", ".exr")
_TURNED = re.compile(r"(.+)_(\d+(?:\.\d+)?)")


def maps_in(folder: Path) -> dict[str, Path]:
    """Return the environment maps in a folder by their names without suffix; none where it is not there."""
    if not folder.is_dir():
        return {}
    return {path.stem: path for path in sorted(folder.iterdir()) if path.suffix.lower() in MAP_SUFFIXES}


def read_true_lights(
    lights: Sequence[str], folders: Iterable[Path]
) -> dict[str, Float32[ndarray, "rows columns 3"]]:
    """Return the true environments of those `lights` that have one in a folder; the first folder decides.

    A map is named like the light, or like it without an angle at the end: `sunset_120` is `sunset` turned by
    120 degrees about +z. Maps too small to be compared do not count. Raises `UsageError` for a map that
    cannot be read.
    """
    images: dict[str, Float32[ndarray, "rows columns 3"]] = {}
    for folder in folders:
        maps = maps_in(folder)
        for light in lights:
            if light in images:
                continue
            match = _TURNED.fullmatch(light)
            if light in maps:
                image = _read(maps[light])
            elif match is not None and match[1] in maps:
                image = turned_about_z(_read(maps[match[1]]), float(match[2]))
            else:
                continue
            if image.shape[0] >= ROWS and image.shape[1] >= COLUMNS:
                images[light] = np.ascontiguousarray(image, dtype=np.float32)
    return images


def turned_about_z(
    image: Float[ndarray, "rows columns 3"], degrees: float
) -> Float[ndarray, "rows columns 3"]:
    """Return the environment turned counter-clockwise as seen from above: L_deg(d) = L_0(R_z(-deg) d).

    Where the angle is not a whole number of columns, pixels are mixed with their neighbours.
    """
    columns = degrees / 360.0 * image.shape[1]
    whole = int(np.floor(columns))
    near, far = np.roll(image, -whole, axis=1), np.roll(image, -whole - 1, axis=1)
    part = columns - whole
    return (1.0 - part) * near + part * far


def _read(path: Path) -> Float[ndarray, "rows columns 3"]:
    try:
        return load_environment(path).radiance
    except RelightError as error:
        raise UsageError("evaluate.environment_unreadable", str(error)) from error

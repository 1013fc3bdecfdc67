"""Environment maps: light that comes from infinitely far away, as a latitude-longitude picture.

Directions, rows and columns as in `lambent_relight.directions`. Radiance between pixel centres is
bilinear, wrapping around in azimuth and held constant above the first and below the last row.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lambent_relight.directions import Array, rotate_about_z, uv_of_directions
from lambent_relight.errors import EnvironmentFileError
from lambent_relight.exr import read_exr_rgb, write_exr
from lambent_relight.rgbe import read_rgbe

MAX_PIXELS = 1 << 25
"""Largest map that is read by default: 8192 x 4096."""


@dataclass(frozen=True)
class Cleaning:
    """How many values of a map were unusable: NaN and negative ones become 0, infinite ones the largest."""

    num_nan: int = 0
    num_infinite: int = 0
    num_negative: int = 0

    def __bool__(self) -> bool:
        """Return whether anything had to be mended."""
        return bool(self.num_nan or self.num_infinite or self.num_negative)


@dataclass(frozen=True)
class Environment:
    """A map and the angle it is turned by."""

    radiance: NDArray[np.float32]
    """Linear Rec. 709 radiance [height, width, 3], finite and not negative."""
    rotate_deg: float = 0.0
    """The light is turned by this angle about +z: L(d) = L_0(Rz(-rotate_deg) d)."""
    cleaning: Cleaning = Cleaning()

    def rotated(self, degrees: float) -> "Environment":
        """Return the same light turned by a further +`degrees` about +z."""
        return replace(self, rotate_deg=self.rotate_deg + degrees)

    def scaled(self, factor: float) -> "Environment":
        """Return the same light, `factor` times as bright."""
        return replace(self, radiance=self.radiance * np.float32(factor))

    def lookup(self, directions: Array) -> NDArray[np.float32]:
        """Return the radiance that arrives from unit `directions` [*batch, 3], as [*batch, 3]."""
        if self.rotate_deg:
            directions = rotate_about_z(directions, -self.rotate_deg)
        height, width, _ = self.radiance.shape
        u, v = uv_of_directions(directions)
        column, row = u * width - 0.5, np.clip(v * height - 0.5, 0.0, height - 1.0)
        column_floor, row_floor = np.floor(column), np.floor(row)
        fraction_x = (column - column_floor).astype(np.float32)[..., None]
        fraction_y = (row - row_floor).astype(np.float32)[..., None]
        left, top = column_floor.astype(np.int64) % width, row_floor.astype(np.int64)
        right, bottom = (left + 1) % width, np.minimum(top + 1, height - 1)
        flat = self.radiance.reshape(-1, 3)
        upper = flat[top * width + left] * (1 - fraction_x) + flat[top * width + right] * fraction_x
        lower = flat[bottom * width + left] * (1 - fraction_x) + flat[bottom * width + right] * fraction_x
        return upper * (1 - fraction_y) + lower * fraction_y


def environment_from_array(radiance: Array, *, source: str = "environment") -> Environment:
    """Return an environment of linear values [height, width, 3], with unusable values counted and mended.

    NaN and negative values become 0, infinite ones the largest finite value of the map. Raises
    EnvironmentFileError when the shape is wrong or nothing usable is left.
    """
    image = np.array(radiance, np.float32)
    if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 2:
        raise EnvironmentFileError(
            "environment.shape",
            f'"{source}" has shape {image.shape}, expected [height, width, 3]',
            "give an RGB latitude-longitude map of at least 2 x 2 pixels",
        )
    nan, infinite = np.isnan(image), np.isinf(image)
    positive_infinite = infinite & (image > 0)
    negative = ~nan & (image < 0)
    usable = image[~(nan | infinite | negative)]
    if usable.size == 0:
        raise EnvironmentFileError(
            "environment.no_values", f'"{source}" holds no finite, non-negative value', "export the map again"
        )
    image[nan | negative] = 0.0
    image[positive_infinite] = usable.max()
    cleaning = Cleaning(int(nan.sum()), int(infinite.sum()), int((negative & ~infinite).sum()))
    return Environment(image, cleaning=cleaning)


def load_environment(path: Path | str, *, max_pixels: int = MAX_PIXELS) -> Environment:
    """Return the environment map in a Radiance (.hdr) or OpenEXR (.exr) file.

    `cleaning` of the result tells how many values had to be mended. Raises EnvironmentFileError, with a
    code that starts with `environment.`, for a file that cannot be read or is above `max_pixels`.
    """
    path = Path(path)
    if not path.is_file():
        raise EnvironmentFileError("environment.missing", f'there is no file "{path}"', "check the path")
    readers = {".hdr": read_rgbe, ".pic": read_rgbe, ".rgbe": read_rgbe, ".exr": read_exr_rgb}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise EnvironmentFileError(
            "environment.unknown_format",
            f'"{path.name}" is neither .hdr nor .exr',
            "convert it to one of them",
        )
    return environment_from_array(reader(path, max_pixels=max_pixels), source=path.name)


def write_environment(path: Path | str, radiance: Array, *, half: bool = True) -> None:
    """Write linear radiance [height, width, 3] as an EXR latitude-longitude map in our convention."""
    image = np.asarray(radiance)
    write_exr(Path(path), {name: image[..., index] for index, name in enumerate("RGB")}, half=half)

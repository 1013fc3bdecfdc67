"""Environment maps: infinitely distant light as a latitude-longitude picture.

Directions, rows and columns as in `lambent_core.directions`. Radiance between pixel centres is
bilinear, wrapping around in azimuth and held constant above the first and below the last row.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from lambent_core.directions import Array, rotate_about_z, uv_of_directions
from lambent_core.errors import EnvironmentFileError
from lambent_core.exr import read_exr_rgb, write_exr
from lambent_core.picture_rows import PictureRows, block_means
from lambent_core.rgbe import read_rgbe
from numpy.typing import NDArray

from lambent_relight.arguments import file_path, number, refusal
from lambent_relight.environment.layouts import (
    AUTO,
    LATLONG,
    LAYOUTS,
    blank_unused,
    decided_layout,
    to_latlong,
)

MAX_PIXELS = 1 << 25
"""Largest map kept at full size by default, 8192 x 4096; larger files are reduced while they are read."""
MAX_FILE_PIXELS = 1 << 27
"""Largest file that is read: 16384 x 8192."""


_refuse = refusal("environment.argument", EnvironmentFileError)


@dataclass(frozen=True)
class Cleaning:
    """Counts of unusable values of a map that were replaced on request.

    NaN and negative values became 0, infinite ones the largest finite value.
    """

    num_nan: int = 0
    num_infinite: int = 0
    num_negative: int = 0

    def __bool__(self) -> bool:
        """Return whether any value was replaced."""
        return bool(self.num_nan or self.num_infinite or self.num_negative)

    def __str__(self) -> str:
        """Return the counts in words."""
        return f"{self.num_nan} NaN, {self.num_infinite} infinite and {self.num_negative} negative values"


@dataclass(frozen=True)
class Environment:
    """A map and the angle by which it is rotated."""

    radiance: NDArray[np.float32]
    """Linear Rec. 709 radiance [height, width, 3], finite and not negative."""
    rotate_deg: float = 0.0
    """The light is rotated by this angle about +z: L(d) = L_0(Rz(-rotate_deg) d)."""
    cleaning: Cleaning = Cleaning()
    reduced_from: tuple[int, int] | None = None
    """Height and width of the file, if it was above the limit and the map consists of means of its pixels."""
    read_as: str = LATLONG
    """The file's layout, a name of `layouts.LAYOUTS`, from which the map was converted."""

    def __post_init__(self) -> None:
        image = self.radiance
        if not isinstance(image, np.ndarray) or image.ndim != 3 or image.shape[2:] != (3,):
            shape = list(image.shape) if isinstance(image, np.ndarray) else type(image).__name__
            raise _refuse(
                f"radiance is {shape} and no array [height, width, 3]",
                "make an environment with environment_from_array, which also checks the values",
            )
        number(self.rotate_deg, "rotate_deg", refuse=_refuse)

    def __repr__(self) -> str:
        """Return the size and the rotation in one line."""
        height, width = self.radiance.shape[:2]
        turned = f", rotated by {self.rotate_deg:g} degrees" if self.rotate_deg else ""
        return f"Environment({width} x {height} pixels{turned})"

    def rotated(self, degrees: float) -> "Environment":
        """Return the same light rotated by a further +`degrees` about +z."""
        degrees = number(degrees, "degrees", refuse=_refuse)
        return replace(self, rotate_deg=self.rotate_deg + degrees)

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


def environment_from_array(
    radiance: Array, *, source: str = "environment", mend: bool = False
) -> Environment:
    """Return an environment of linear values [height, width, 3].

    NaN, negative and infinite values are an error, unless `mend` requests their replacement: NaN and
    negative ones by 0, infinite ones by the largest finite value of the map; `cleaning` tells how many.
    Raises EnvironmentFileError for those, for a wrong shape, and where nothing usable is left.
    """
    try:
        image = np.array(radiance, np.float32)
    except (TypeError, ValueError) as error:
        raise _refuse(
            f'"{source}" is {type(radiance).__name__} and no array of numbers', "give [height, width, 3]"
        ) from error
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise EnvironmentFileError(
            "environment.shape",
            f'"{source}" has shape {image.shape}, expected [height, width, 3]',
            "give an RGB latitude-longitude map",
        )
    nan, infinite = np.isnan(image), np.isinf(image)
    positive_infinite = infinite & (image > 0)
    negative = ~nan & (image < 0)
    unusable = nan | infinite | negative
    if not unusable.any():
        return Environment(image)
    usable = image[~unusable]
    if usable.size == 0:
        raise EnvironmentFileError(
            "environment.no_values", f'"{source}" holds no finite, non-negative value', "export the map again"
        )
    cleaning = Cleaning(int(nan.sum()), int(infinite.sum()), int((negative & ~infinite).sum()))
    if not mend:
        row, column, _ = (int(place[0]) for place in np.nonzero(unusable))
        raise EnvironmentFileError(
            "environment.unusable_values",
            f'"{source}" holds {cleaning}, the first in row {row}, column {column}',
            "fix the map, or have them replaced: --mend-env (mend=True); "
            "`lambent probe MAP --mend-env -o DIR` writes a repaired map",
        )
    image[nan | negative] = 0.0
    image[positive_infinite] = usable.max()
    return Environment(image, cleaning=cleaning)


def load_environment(
    path: Path | str,
    *,
    max_pixels: int = MAX_PIXELS,
    max_file_pixels: int = MAX_FILE_PIXELS,
    mend: bool = False,
    layout: str = AUTO,
) -> Environment:
    """Return the environment map in a Radiance (.hdr) or OpenEXR (.exr) file.

    `mend` as in `environment_from_array`. `layout` is a name of `layouts.LAYOUTS`, or "auto": what the file
    states, or else what its size says. Probes and cubes are converted to latitude-longitude. A map above
    `max_pixels` is reduced by an integer factor to the means of blocks of pixels, and has `reduced_from` set.
    Raises EnvironmentFileError, with a code that starts with `environment.`, for a file that cannot be read
    or is above `max_file_pixels`, and for a layout that is unclear or does not fit the size.
    """
    path = file_path(path, "path", refuse=_refuse)
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
    picture = reader(path, max_pixels=max_file_pixels)
    height, width = picture.height, picture.width
    layout_name = decided_layout(path.name, height, width, picture.layout, layout)
    if layout_name != LATLONG:
        return _converted(path, picture, layout_name, max_pixels, mend, certain=layout != AUTO)
    step = next(step for step in range(1, height * width + 1) if height * width <= max_pixels * step * step)
    if height % step or width % step:
        raise _too_large(path, height, width, max_pixels, f"which blocks of {step} x {step} do not divide")
    read = environment_from_array(block_means(picture, step), source=path.name, mend=mend)
    return replace(read, reduced_from=(height, width)) if step > 1 else read


def _converted(
    path: Path, picture: PictureRows, layout: str, max_pixels: int, mend: bool, *, certain: bool
) -> Environment:
    """Return the map of a picture in another layout; unusable values are found before they spread."""
    if picture.height * picture.width > max_pixels:
        raise _too_large(
            path, picture.height, picture.width, max_pixels, f"too many for {LAYOUTS[layout]} to be converted"
        )
    image = picture.rows(slice(0, picture.height))
    image = blank_unused(path.name, image, layout, certain=certain)
    read = environment_from_array(image, source=path.name, mend=mend)
    return replace(read, radiance=to_latlong(read.radiance, layout), read_as=layout)


def _too_large(path: Path, height: int, width: int, max_pixels: int, why: str) -> EnvironmentFileError:
    return EnvironmentFileError(
        "environment.too_large",
        f'"{path.name}" has {width} x {height} pixels, {why}',
        f"reduce the map to at most {max_pixels} pixels (8192 x 4096 is plenty for lighting)",
    )


def as_environment(light: "Environment | Array | Path | str") -> Environment:
    """Return the light that a function was given as an environment, an array or a file.

    Raises EnvironmentFileError as `environment_from_array` and `load_environment` do.
    """
    if isinstance(light, Environment):
        return light
    if isinstance(light, np.ndarray):
        return environment_from_array(light)
    advice = "give an Environment, an array [height, width, 3] of linear radiance, or the path of a map"
    if not isinstance(light, (str, Path)):
        raise _refuse(f"environment is {type(light).__name__}", advice)
    return load_environment(light)


def write_environment(path: Path | str, radiance: Array | Environment, *, half: bool = True) -> None:
    """Write linear radiance [height, width, 3] as an EXR latitude-longitude map in our convention.

    An environment has to be unrotated, because a file has no angle. Raises EnvironmentFileError.
    """
    if isinstance(radiance, Environment) and radiance.rotate_deg:
        raise _refuse(
            f"the environment is rotated by {radiance.rotate_deg:g} degrees", "rotate when rendering"
        )
    image = radiance.radiance if isinstance(radiance, Environment) else np.asarray(radiance)
    if image.ndim != 3 or image.shape[2] != 3 or not np.issubdtype(image.dtype, np.number):
        raise _refuse(f"radiance is {image.dtype} {list(image.shape)}", "give numbers [height, width, 3]")
    target = file_path(path, "path", refuse=_refuse)
    write_exr(target, {name: image[..., index] for index, name in enumerate("RGB")}, half=half)

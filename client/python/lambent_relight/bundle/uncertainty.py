"""Uncertainty of an object's materials at any point: a grid of values over a box.

Written by the exporter, read by viewers and by programs that bake it into textures.
Source: docs/reference/bundle-format.md; what the values mean: docs/discussion/uncertainty.md.
"""

import io
from dataclasses import dataclass

import numpy as np
from lambent_core.errors import BundleError
from numpy.typing import NDArray

PATH = "uncertainty/materials.npy"
CHANNELS = ("albedo", "albedo_from_light", "metalness", "perceptual_roughness", "views")
"""Standard deviations (albedo: relative), and how many photographs see the point."""
MAX_CELLS = 256
"""Cells along an axis that a file may have."""


@dataclass(frozen=True, eq=False)
class UncertaintyGrid:
    """Values at the centres of equal cells that fill a box."""

    low: NDArray[np.float64]
    """Corner of the box, scene units [3]."""
    high: NDArray[np.float64]
    values: NDArray[np.float32]
    """[x, y, z, channel], in the order of `channels`."""
    channels: tuple[str, ...] = CHANNELS

    def __repr__(self) -> str:
        """Return cells and channels in one line."""
        cells = " x ".join(str(count) for count in self.values.shape[:3])
        return f"UncertaintyGrid({cells} cells, {', '.join(self.channels)})"

    def at(self, positions: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return values [..., channel] at world positions [..., 3], trilinear between centres.

        Positions outside the box get the value of the nearest centre.
        """
        counts = np.array(self.values.shape[:3])
        place = (np.asarray(positions, np.float64) - self.low) / (self.high - self.low) * counts - 0.5
        place = np.clip(place, 0.0, counts - 1.0)
        first = np.minimum(place.astype(np.int64), np.maximum(counts - 2, 0))
        share = place - first
        total = np.zeros((*place.shape[:-1], self.values.shape[-1]), np.float32)
        for corner in np.ndindex(2, 2, 2):
            index = np.minimum(first + corner, counts - 1)
            factor = np.prod(np.where(np.array(corner) == 1, share, 1.0 - share), axis=-1)
            total += factor[..., None].astype(np.float32) * self.values[tuple(np.moveaxis(index, -1, 0))]
        return total

    def channel(self, name: str, positions: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return one channel at world positions; raises KeyError naming the channels there are."""
        if name not in self.channels:
            raise KeyError(f"there is no channel {name!r}; there are {', '.join(self.channels)}")
        return self.at(positions)[..., self.channels.index(name)]

    def to_bytes(self) -> bytes:
        """Return the grid as an NPY file of float16."""
        buffer = io.BytesIO()
        np.save(buffer, np.ascontiguousarray(self.values, np.float16), allow_pickle=False)
        return buffer.getvalue()


def read_uncertainty(
    data: bytes, low: list[float], high: list[float], channels: list[str]
) -> UncertaintyGrid:
    """Return the grid in the bytes of an NPY file; raises BundleError for anything but one that fits."""
    buffer = io.BytesIO(data)
    try:
        # The header is checked before any memory is allocated.
        if np.lib.format.read_magic(buffer) != (1, 0):
            raise ValueError("version")
        shape, column_major, dtype = np.lib.format.read_array_header_1_0(buffer)
    except ValueError as error:
        raise _invalid("cannot be read as NPY") from error
    if dtype != np.float16 or column_major or len(shape) != 4 or shape[-1] != len(channels):
        raise _invalid(f"holds {dtype} {list(shape)}, expected float16 [x, y, z, {len(channels)}]")
    if not (min(shape) > 0 and max(shape[:3]) <= MAX_CELLS):
        raise _invalid(f"has {list(shape[:3])} cells, expected 1 to {MAX_CELLS} along each axis")
    if len(data) - buffer.tell() != 2 * int(np.prod(shape)):
        raise _invalid("has another length than its header says")
    values = np.frombuffer(data, np.float16, offset=buffer.tell()).reshape(shape)
    if len(low) != 3 or len(high) != 3 or not np.all(np.subtract(high, low) > 0.0):
        raise _invalid("fills a box without a size")
    if not np.isfinite(values).all():
        raise _invalid("holds values that are not finite")
    return UncertaintyGrid(np.array(low), np.array(high), values.astype(np.float32), tuple(channels))


def _invalid(what: str) -> BundleError:
    message = f"the uncertainty grid {what}"
    return BundleError("bundle.uncertainty_invalid", message, "export the bundle again")

"""A photograph as it is decoded: levels, straight alpha, and what the levels mean."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float32, Shaped
from numpy import ndarray
from PIL import Image

from lambent_capture.arrays import Grey32, Levels, Plane, Reduced32, Rgb
from lambent_capture.pictures.colour_space import ColourSpace

CLIPPED_LEVEL = 252 / 255
"""Share of full scale from which on a level may have been clipped; below 1 for the rounding of JPEG."""

Part = tuple[slice, slice]
ALL: Part = (slice(None), slice(None))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Picture:
    """A decoded picture; only the part that is asked for becomes float."""

    levels: Levels
    """One (grey) or three channels: uint8 or uint16, encoded as `space` says, or float32."""
    alpha: Plane | None
    """Straight alpha of the same kind of number, floats in 0..1; None where everything is opaque."""
    space: ColourSpace
    colour_doubt: str = ""
    """Why `space` is an assumption, as the end of a sentence; "" where the file states it, or nothing."""

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height in pixels."""
        return self.levels.shape[1], self.levels.shape[0]

    @property
    def is_linear(self) -> bool:
        """Return whether levels are light as floats, whose scale has no end at which they clip."""
        return self.levels.dtype.kind == "f"

    def linear(self, part: Part = ALL) -> Float32[ndarray, "rows columns 3"]:
        """Return a part in linear Rec. 709."""
        colours = self.space.linear(self.levels[part])
        return np.ascontiguousarray(np.broadcast_to(colours, (*colours.shape[:2], 3)))

    def srgb(self) -> Rgb:
        """Return the picture in 8-bit sRGB, clipped."""
        return self.space.srgb(self.levels)

    def coverage(self, part: Part = ALL) -> Reduced32:
        """Return alpha in 0..1, which is 1 where the file has none."""
        if self.alpha is None:
            return np.ones(self.levels[part].shape[:2], dtype=np.float32)
        return shares(self.alpha[part])

    def clipped(self, part: Part = ALL) -> Shaped[ndarray, "rows columns channels"] | None:
        """Return which channels are at the end of the scale; None for floats."""
        if self.is_linear:
            return None
        return self.levels[part] >= CLIPPED_LEVEL * np.iinfo(self.levels.dtype).max

    def mirrored(self) -> Self:
        """Return the picture with left and right exchanged."""
        alpha = None if self.alpha is None else np.ascontiguousarray(self.alpha[:, ::-1])
        return replace(self, levels=np.ascontiguousarray(self.levels[:, ::-1]), alpha=alpha)

    def resized(self, size: tuple[int, int]) -> Self:
        """Return the picture averaged to `size` (width, height): its levels as they are encoded, by alpha.

        That is exact enough for a look; training averages light.
        """
        if size == self.size:
            return self
        if self.levels.dtype == np.uint8:
            both = self.levels if self.alpha is None else np.dstack([self.levels, self.alpha])
            # Pillow multiplies by alpha before it averages, and divides afterwards.
            image = Image.fromarray(both[..., 0] if both.shape[-1] == 1 else both)
            small = np.asarray(image.resize(size, Image.Resampling.BOX, reducing_gap=2.0))
            small = small.reshape(size[1], size[0], -1)
            count = self.levels.shape[-1]
            return replace(
                self, levels=small[..., :count], alpha=None if self.alpha is None else small[..., count]
            )
        weights = None if self.alpha is None else shares(self.alpha)
        planes = [
            box_averaged(plane if weights is None else plane * weights, size)
            for plane in np.moveaxis(self.levels, -1, 0).astype(np.float32)
        ]
        levels = np.stack(planes, axis=-1)
        small_weights = None if weights is None else box_averaged(weights, size)
        if small_weights is not None:
            levels /= np.maximum(small_weights, 1e-6)[..., None]
        if self.is_linear:
            return replace(self, levels=levels, alpha=small_weights)
        full = np.iinfo(self.levels.dtype).max
        alpha = None if small_weights is None else np.round(full * small_weights).astype(self.levels.dtype)
        return replace(self, levels=np.round(levels).clip(0, full).astype(self.levels.dtype), alpha=alpha)


def turned(
    values: Shaped[ndarray, "height width *channels"], orientation: int
) -> Shaped[ndarray, "rows columns *channels"]:
    """Return stored pixels as a person is to see them. Source: EXIF 2.32, Orientation."""
    if orientation in (5, 6, 7, 8):
        values = np.swapaxes(values, 0, 1)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    return np.ascontiguousarray(values)


def undoing(orientation: int) -> int:
    """Return the orientation that brings what people see back to the stored pixels."""
    return {6: 8, 8: 6}.get(orientation, orientation)


def shares(levels: Shaped[ndarray, "*shape"]) -> Float32[ndarray, "*shape"]:
    """Return levels as shares of full scale, 0..1."""
    if levels.dtype.kind == "f":
        return np.clip(levels.astype(np.float32), 0.0, 1.0)
    return levels.astype(np.float32) / np.float32(np.iinfo(levels.dtype).max)


def box_averaged(values: Grey32, size: tuple[int, int]) -> Reduced32:
    """Return values averaged over the pixels of a picture of `size` (width, height)."""
    if (values.shape[1], values.shape[0]) == size:
        return values
    image = Image.fromarray(np.ascontiguousarray(values, dtype=np.float32))
    return np.asarray(image.resize(size, Image.Resampling.BOX))

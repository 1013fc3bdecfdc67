"""Writing relit pictures: PNG for screens, EXR for further work.

PNG: sRGB-encoded 8 bit, straight alpha. EXR: linear Rec. 709 with stated primaries, colours multiplied
by alpha as the format demands. Source: docs/reference/conventions.md (colour).
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from lambent_relight.aovs import ATTRIBUTES, exr_channels
from lambent_relight.exr import write_exr
from lambent_relight.picture import RelitPicture


def srgb_from_linear(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return sRGB-encoded values of linear ones, both clipped to [0, 1]."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def linear_from_srgb(encoded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return linear values of sRGB-encoded ones in [0, 1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def encode_png(picture: RelitPicture) -> NDArray[np.uint8]:
    """Return 8-bit sRGB pixels [height, width, 4] with straight alpha, or 3 channels if all are opaque."""
    colour = srgb_from_linear(picture.rgb)
    if picture.opacity.min() < 1.0:
        colour = np.concatenate([colour, np.clip(picture.opacity, 0.0, 1.0)], axis=-1)
    return np.round(255.0 * colour).astype(np.uint8)


def write_png(path: Path | str, picture: RelitPicture) -> None:
    """Write a picture as sRGB PNG; radiance above 1 is clipped (use `RelitPicture.exposed` before)."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    PillowImage.fromarray(encode_png(picture)).save(path)


def write_picture_exr(
    path: Path | str,
    picture: RelitPicture,
    *,
    half: bool = True,
    passes: bool = True,
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Write a picture as linear EXR with channels R, G, B (times alpha) and A.

    With `passes` also every pass of `lambent_relight.aovs`, as layers. `attributes` are written into the
    header beside what it says of colour, normals and depth.
    """
    header = {**ATTRIBUTES, **(attributes or {})}
    write_exr(Path(path), exr_channels(picture, passes=passes), half=half, attributes=header)

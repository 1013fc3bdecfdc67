"""Writing relit pictures: PNG for screens, EXR for further work.

PNG: sRGB-encoded 8 bit, straight alpha. EXR: linear Rec. 709 with stated primaries, colours multiplied
by alpha as the format demands. Source: docs/reference/conventions.md (colour).
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image as PillowImage

from lambent_core.colour import srgb_from_linear
from lambent_relight import cryptomatte
from lambent_relight.aovs import ATTRIBUTES, FULL_PRECISION, OBJECT_NAME, as_written_now, exr_channels
from lambent_relight.arguments import file_path, instance
from lambent_relight.environment.exr import write_exr
from lambent_relight.picture import RelitPicture
from lambent_relight.tone_mapping import tone_mapped

_MADE_BY = "give what Renderer.render returns"


def encode_png(picture: RelitPicture, *, tone_mapping: str = "linear") -> NDArray[np.uint8]:
    """Return 8-bit sRGB pixels [height, width, 4] with straight alpha, or 3 channels if all are opaque.

    `tone_mapping` is a name of `lambent_relight.tone_mapping`.
    """
    colour = srgb_from_linear(tone_mapped(picture.rgb, tone_mapping))
    if picture.opacity.min() < 1.0:
        colour = np.concatenate([colour, np.clip(picture.opacity, 0.0, 1.0)], axis=-1)
    return np.round(255.0 * colour).astype(np.uint8)


def write_png(path: Path | str, picture: RelitPicture, *, tone_mapping: str = "linear") -> None:
    """Write a picture as sRGB PNG through a curve of `lambent_relight.tone_mapping`.

    The curve `linear` clips radiance above 1; use `RelitPicture.exposed` before.
    """
    path = file_path(path, "path")
    instance(picture, RelitPicture, "picture", _MADE_BY)
    path.parent.mkdir(parents=True, exist_ok=True)
    PillowImage.fromarray(encode_png(picture, tone_mapping=tone_mapping)).save(path)


def write_picture_exr(
    path: Path | str,
    picture: RelitPicture,
    *,
    half: bool = True,
    passes: bool | Collection[str] = True,
    attributes: Mapping[str, str] | None = None,
    layers: Mapping[str, NDArray[np.floating]] | None = None,
    object_name: str = OBJECT_NAME,
) -> None:
    """Write a picture as linear EXR with channels R, G, B (times alpha) and A.

    With `passes` also every pass of `lambent_relight.aovs`, or those that are named, as layers. `attributes`
    are written into the header beside what it says of colour, camera, normals and depth. `layers` are
    channels of the same picture that are made already. With `half` channels are half floats, but for depth
    and the mask. `object_name` is what the Cryptomatte calls the object.
    """
    instance(picture, RelitPicture, "picture", _MADE_BY)
    header: dict[str, Any] = {**ATTRIBUTES, **picture.camera_attributes, **(attributes or {})}
    channels = {**(layers or {}), **exr_channels(picture, passes=passes, object_name=object_name)}
    if not channels.keys().isdisjoint(cryptomatte.CHANNELS):
        header |= cryptomatte.cryptomatte_attributes(object_name)
    write_exr(file_path(path, "path"), channels, half=half, full_precision=FULL_PRECISION, attributes=header)


def read_picture_exr(path: Path | str) -> dict[str, NDArray[np.floating]]:
    """Return the channels [height, width] of an EXR that `write_picture_exr` wrote, now or in the past.

    Names and meanings are those of files written now, see `lambent_relight.aovs.as_written_now`. The file is
    trusted: one that cannot be decoded raises what OpenEXR does.
    """
    with OpenEXR.File(str(path), separate_channels=True) as file:
        part = file.parts[0]
        planes = {name: channel.pixels.copy() for name, channel in part.channels.items()}
        return as_written_now(planes, part.header)

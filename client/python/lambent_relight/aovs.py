"""The passes of a relit picture as layers of one EXR file, for compositing.

Layers are named as compositing programs expect: "layer.R" and so on; the beauty pass is R, G, B, A. What has
channels R, G and B is multiplied by coverage, albedo like radiance: edges are as soft as the beauty pass's,
and layers add up under any background: direct + indirect = diffuse + specular = the beauty pass (where it has
no background). What is measured (X, Y, Z, V) is the mean over the covered part of a pixel, so that normals
are unit vectors up to the edge. Depth is planar and far where nothing is, as compositing programs expect it.
Source: docs/reference/conventions.md (colour, depth).
"""

from collections.abc import Collection, Mapping
from typing import get_args

import numpy as np
from lambent_core.pictures import Pass
from numpy.typing import NDArray

from lambent_relight import cryptomatte
from lambent_relight.picture import RelitPicture

PASSES = get_args(Pass)
"""Every pass there is, besides the beauty pass."""
RADIANCE_PASSES = PASSES[:4]
ATTRIBUTES: Mapping[str, str] = {
    "lambent:colorspace": "Linear Rec.709 (sRGB)",
    "colorInteropID": "lin_rec709_scene",
    "lambent:premultiplied": "R, G, B of every layer",
    "lambent:normal": "world, right-handed, z up",
    "lambent:depth": "Z: along the camera's axis, distance.V: along the ray, scene units; 1e10 where empty",
}
"""Attributes that describe the channels, besides chromaticities."""
EMPTY_DEPTH = 1e10
"""Z and distance.V where there is no object, scene units."""
FULL_PRECISION = frozenset({"Z", "distance.V", *cryptomatte.CHANNELS})
"""Channels that are 32-bit floats in every file: depth beyond 65504, and ids, which are their bits."""
OBJECT_NAME = "object"
"""Name of the object in a Cryptomatte where it has no other."""
_OLD_DEPTH = "distance from the camera along the ray, scene units"
"""`lambent:depth` of files before there was planar depth: Z is the distance, and 0 where empty."""


def exr_channels(
    picture: RelitPicture, *, passes: bool | Collection[str], object_name: str = OBJECT_NAME
) -> dict[str, NDArray[np.floating]]:
    """Return the channels of a picture's EXR by name, [height, width] each.

    R, G, B (times alpha) and A. With `passes`, all or some names of `PASSES`, also the radiance passes,
    albedo and standard_error (times coverage; R, G, B each), as they are normal (X, Y, Z), visibility,
    perceptual_roughness, metalness (V), for depth Z along the camera's axis and distance.V along the ray,
    both `EMPTY_DEPTH` where there is no object, and for cryptomatte the mask of the object `object_name`.
    """
    wanted = (PASSES if passes else ()) if isinstance(passes, bool) else passes
    channels: dict[str, NDArray[np.floating]] = {}

    def layer(name: str, image: NDArray[np.floating], letters: str) -> None:
        for index, letter in enumerate(letters):
            channels[f"{name}.{letter}" if name else letter] = image[..., index]

    layer("", picture.rgb * picture.opacity, "RGB")
    layer("", picture.opacity, "A")
    for name in RADIANCE_PASSES:
        if name in wanted:
            layer(name, getattr(picture, name) * picture.coverage, "RGB")
    if "standard_error" in wanted:
        layer("standard_error", picture.standard_error * picture.opacity, "RGB")
    if "albedo" in wanted:
        layer("albedo", picture.albedo * picture.coverage, "RGB")
    for name, letters in (
        ("normal", "XYZ"),
        ("visibility", "V"),
        ("perceptual_roughness", "V"),
        ("metalness", "V"),
    ):
        if name in wanted:
            layer(name, getattr(picture, name), letters)
    if "depth" in wanted:
        empty = picture.coverage <= 0.0
        layer("", np.where(empty, EMPTY_DEPTH, picture.depth), "Z")
        layer("distance", np.where(empty, EMPTY_DEPTH, picture.distance), "V")
    if "cryptomatte" in wanted:
        channels |= cryptomatte.cryptomatte_channels(object_name, picture.coverage[..., 0])
    return channels


def as_written_now(
    channels: Mapping[str, NDArray[np.floating]], attributes: Mapping[str, object]
) -> dict[str, NDArray[np.floating]]:
    """Return the channels of one of our EXRs, of any age, with the names and meanings of `exr_channels`.

    The Z of old files becomes distance.V; they have no planar depth, and the result has no Z then. Their
    albedo is not multiplied by coverage.
    """
    current = dict(channels)
    if "lambent:premultiplied" not in attributes:
        # Without the mask, alpha, which is the coverage of a picture without background.
        coverage = current.get("CryptoObject00.G", current.get("A"))
        for name in ("albedo.R", "albedo.G", "albedo.B"):
            if name in current and coverage is not None:
                current[name] = (current[name] * coverage).astype(current[name].dtype)
    if attributes.get("lambent:depth") == _OLD_DEPTH and "Z" in current:
        distance = current.pop("Z")
        current["distance.V"] = np.where(distance <= 0.0, np.float32(EMPTY_DEPTH), distance)
    return current

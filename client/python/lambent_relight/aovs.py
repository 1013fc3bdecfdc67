"""The passes of a relit picture as layers of one EXR file, for compositing.

Layers are named as compositing programs expect: "layer.R" and so on; the beauty pass is R, G, B, A. Radiance
is multiplied by coverage, so that layers add up under any background: direct + indirect = diffuse + specular
= the beauty pass (where it has no background). Source: docs/reference/conventions.md (passes).
"""

from collections.abc import Collection, Mapping
from typing import get_args

import numpy as np
from lambent_proto.pictures import Pass
from numpy.typing import NDArray

from lambent_relight.picture import RelitPicture

PASSES = get_args(Pass)
"""Every pass there is, besides the beauty pass."""
RADIANCE_PASSES = PASSES[:4]
ATTRIBUTES: Mapping[str, str] = {
    "lambent:colorspace": "Linear Rec.709 (sRGB)",
    "colorInteropID": "lin_rec709_scene",
    "lambent:normal": "world, right-handed, z up",
    "lambent:depth": "distance from the camera along the ray, scene units",
}
"""Attributes that describe the channels, besides chromaticities."""


def exr_channels(picture: RelitPicture, *, passes: bool | Collection[str]) -> dict[str, NDArray[np.floating]]:
    """Return the channels of a picture's EXR by name, [height, width] each.

    R, G, B (times alpha) and A. With `passes`, all or some names of `PASSES`, also the radiance passes and
    standard_error (times coverage; R, G, B each), albedo (R, G, B), normal (X, Y, Z), visibility,
    perceptual_roughness, metalness (V), and for depth Z, the distance from the camera along the ray.
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
    for name, letters in (
        ("albedo", "RGB"),
        ("normal", "XYZ"),
        ("visibility", "V"),
        ("perceptual_roughness", "V"),
        ("metalness", "V"),
    ):
        if name in wanted:
            layer(name, getattr(picture, name), letters)
    if "depth" in wanted:
        layer("", picture.distance, "Z")
    return channels

"""The passes of a relit picture as layers of one EXR file, for compositing.

Layers are named as compositing programs expect: "layer.R" and so on; the beauty pass is R, G, B, A. Radiance
is multiplied by coverage, so that layers add up under any background: direct + indirect = diffuse + specular
= the beauty pass (where it has no background). Source: docs/reference/conventions.md (passes).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lambent_relight.picture import RelitPicture

RADIANCE_PASSES = ("direct", "indirect", "diffuse", "specular")
PASSES = (
    *RADIANCE_PASSES,
    "standard_error",
    "visibility",
    "albedo",
    "normal",
    "perceptual_roughness",
    "metalness",
    "depth",
)
"""Every pass there is, besides the beauty pass."""
ATTRIBUTES: Mapping[str, str] = {
    "lambent:colorspace": "Linear Rec.709 (sRGB)",
    "colorInteropID": "lin_rec709_scene",
    "lambent:normal": "world, right-handed, z up",
    "lambent:depth": "distance from the camera along the ray, scene units",
}
"""What the file says about its numbers, besides chromaticities."""


def exr_channels(picture: RelitPicture, *, passes: bool) -> dict[str, NDArray[np.floating]]:
    """Return the channels of a picture's EXR by name, [height, width] each.

    R, G, B (times alpha) and A; with `passes` also the radiance passes and standard_error (times coverage;
    R, G, B each), albedo (R, G, B), normal (X, Y, Z), visibility, perceptual_roughness, metalness (V), and Z,
    the distance from the camera along the ray.
    """
    channels: dict[str, NDArray[np.floating]] = {}

    def layer(name: str, image: NDArray[np.floating], letters: str) -> None:
        for index, letter in enumerate(letters):
            channels[f"{name}.{letter}" if name else letter] = image[..., index]

    layer("", picture.rgb * picture.opacity, "RGB")
    layer("", picture.opacity, "A")
    if passes:
        for name in RADIANCE_PASSES:
            layer(name, getattr(picture, name) * picture.coverage, "RGB")
        layer("standard_error", picture.standard_error * picture.opacity, "RGB")
        layer("albedo", picture.albedo, "RGB")
        layer("normal", picture.normal, "XYZ")
        layer("visibility", picture.visibility, "V")
        layer("perceptual_roughness", picture.perceptual_roughness, "V")
        layer("metalness", picture.metalness, "V")
        layer("", picture.distance, "Z")
    return channels

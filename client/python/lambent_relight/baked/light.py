"""An environment prepared for `preview` and `baked`, and the irradiance it causes at every texel.

The light is stored as a few dominant lights, harmonics of the remainder, and
prefiltered levels of the whole map for the specular lobe. Rotating it rotates coefficients and directions;
nothing is filtered again. Source: docs/reference/conventions.md.
"""

from dataclasses import dataclass

import numpy as np
from lambent_core.directions import rotate_about_z
from numpy.typing import NDArray

from lambent_relight.baked.scene import BakedScene
from lambent_relight.baked.transport import NUM_SHADOW_DIRECTIONS, shadow_directions
from lambent_relight.environment import harmonics
from lambent_relight.environment.dominant_lights import split
from lambent_relight.environment.maps import Environment
from lambent_relight.environment.prefilter import Prefiltered, prefilter

PREVIEW_BANDS = 3
MAX_DOMINANT = 4
BLOCK_WEIGHTS = (0.5625, 0.1875, 0.1875, 0.0625)
"""Of `BakedScene.blocks_around`: the middle of a texel is a quarter of a block from that of its own."""
_NEIGHBOURS = 6
"""Stored directions that decide whether a light is visible."""


@dataclass(frozen=True, eq=False)
class BakedLight:
    """One environment, prepared."""

    prefiltered: Prefiltered
    coefficients: NDArray[np.float64]
    """Harmonics of the light without `directions`, [bands^2, 3]."""
    directions: NDArray[np.float32]
    """Towards the dominant lights, [light, 3]."""
    irradiance: NDArray[np.float32]
    """Of a surface that faces the light, [light, 3]."""
    radii_rad: NDArray[np.float32]
    """Of discs as wide as the lights, [light]."""

    def rotated(self, degrees: float) -> "BakedLight":
        """Return the same light turned by a further +`degrees` about +z."""
        return BakedLight(
            self.prefiltered.rotated(degrees),
            harmonics.rotate_z(self.coefficients, degrees),
            rotate_about_z(self.directions, degrees),
            self.irradiance,
            self.radii_rad,
        )


def prepare_light(
    environment: Environment, bands: int, dominant_lights: int, prefiltered: Prefiltered | None = None
) -> BakedLight:
    """Return `environment` for transport of `bands` bands, with up to `dominant_lights` split off.

    `prefiltered` are its levels, where they are known.
    """
    lights = split(environment, dominant_lights)
    return BakedLight(
        prefiltered or prefilter(environment),
        harmonics.project(lights.residual, bands),
        lights.directions,
        lights.radiance_solid_angle,
        lights.radii_rad,
    )


@dataclass(frozen=True, eq=False)
class LitTexels:
    """The requested texels, with their transport in contiguous arrays."""

    direct: NDArray[np.float32]
    """[bands^2, texel]."""
    indirect: NDArray[np.float32]
    """Of the coarse texels they lie in, channels one after another, [channel, bands^2, coarse]."""
    coarse: NDArray[np.int32]
    """Index of the coarse texel that every texel lies in, [texel]."""
    around: NDArray[np.int32]
    """Indices of the coarse texels of `BakedScene.blocks_around`, [texel, 4]."""
    normal: NDArray[np.float32]
    shadow_bits: NDArray[np.uint8] | None


def lit_texels(scene: BakedScene, texels: NDArray[np.integer] | None = None) -> LitTexels:
    """Return `texels` (default: all) of a scene."""
    transport = scene.transport
    which: NDArray[np.integer] | slice = slice(None) if texels is None else texels
    blocks, around = np.unique(scene.blocks_around[which], return_inverse=True)
    nearby = around.reshape(-1, 4).astype(np.int32)
    indirect = np.ascontiguousarray(transport.indirect[:, :, blocks].transpose(1, 0, 2))
    bits = transport.shadow_bits
    return LitTexels(
        np.ascontiguousarray(transport.direct[:, which]),
        indirect,
        np.ascontiguousarray(nearby[:, 0]),
        nearby,
        scene.normal[which],
        None if bits is None else bits[which],
    )


def seen_lights(lit: LitTexels, light: BakedLight) -> NDArray[np.float32]:
    """Return the share of each dominant light that every texel receives, 0..1; 0 where it faces away."""
    result = np.zeros((len(light.directions), len(lit.normal)), np.float32)
    for row, direction in zip(result, light.directions, strict=True):
        facing = np.flatnonzero(lit.normal @ direction > 0.0)
        row[facing] = free_share(lit.shadow_bits, direction, facing)
    return result


def texel_irradiance(
    lit: LitTexels, light: BakedLight, bands: int, seen: NDArray[np.float32] | None = None
) -> NDArray[np.float32]:
    """Return the direct irradiance of every texel, [texel, 3], not clipped at zero.

    Fewer `bands` than there are give a smoother, cheaper result. `seen` is `seen_lights`, if known.
    """
    seen = seen_lights(lit, light) if seen is None else seen
    result = sky_irradiance(lit, light, bands)
    for direction, irradiance, share in zip(light.directions, light.irradiance, seen, strict=True):
        cosine = np.maximum(lit.normal @ direction, np.float32(0.0)) * share
        result += cosine[:, None] * irradiance
    return result


def sky_irradiance(lit: LitTexels, light: BakedLight, bands: int) -> NDArray[np.float32]:
    """Return the direct irradiance of every texel without the dominant lights, [texel, 3], not clipped."""
    planes = lit.direct[: bands**2]
    coefficients = light.coefficients[: len(planes)].T.astype(np.float32)
    return np.ascontiguousarray((coefficients @ planes[: coefficients.shape[1]]).T)


def coarse_bounce(lit: LitTexels, light: BakedLight) -> NDArray[np.float32]:
    """Return the indirect irradiance of every coarse texel, [coarse, 3].

    Dominant lights are included through their harmonics: the surfaces they illuminate are not in their
    shadow.
    """
    count = lit.indirect.shape[1]
    coefficients = light.coefficients[:count].copy()
    if len(light.directions):
        coefficients += harmonics.basis(light.directions, round(count**0.5)).T @ light.irradiance
    rows = coefficients.astype(np.float32)
    return np.stack([rows[:, channel] @ lit.indirect[channel] for channel in range(3)], axis=-1)


def texel_bounce(lit: LitTexels, light: BakedLight) -> NDArray[np.float32]:
    """Return the indirect irradiance of every texel, bilinear between coarse ones, [texel, 3]."""
    bounced = coarse_bounce(lit, light)
    result = np.zeros((len(lit.around), 3), np.float32)
    for blocks, weight in zip(lit.around.T, BLOCK_WEIGHTS, strict=True):
        result += np.float32(weight) * bounced[blocks]
    return result


def free_share(
    bits: NDArray[np.uint8] | None, direction: NDArray[np.float32], texels: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return the share of a light in `direction` that reaches `texels`, in [0, 1].

    A weighted mean over the bits of the nearest stored directions, which makes the border of a shadow as wide
    as their distance.
    """
    assert bits is not None, "lights are split off only where there are shadow bits"
    near, weight = shadow_weights(direction)
    result = np.zeros(len(texels), np.float32)
    for index, share in zip(near, weight, strict=True):
        result += np.float32(share) * ((bits[texels, index // 8] >> np.uint8(index % 8)) & 1)
    return result


def shadow_weights(direction: NDArray[np.floating]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the nearest stored directions and their weights, which sum to one."""
    cosine = shadow_directions() @ np.asarray(direction, np.float64)
    near = np.argsort(-cosine)[:_NEIGHBOURS]
    # Gaussian as wide as a cell; the last neighbour's weight is taken from all, so that none jumps in.
    sharpness = NUM_SHADOW_DIRECTIONS / 4.0
    weight = np.exp(sharpness * (cosine[near] - cosine[near[0]]))
    weight -= weight[-1]
    if weight.sum() <= 0.0:
        weight = np.ones(_NEIGHBOURS)
    return near, weight / weight.sum()

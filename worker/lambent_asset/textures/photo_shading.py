"""Shading of the texels of a surface, from baked transport and the recovered light.

With metalness m, F0 = m albedo + (1 - m) 0.04: outgoing radiance is linear in albedo,

    radiance = gain albedo + offset
    gain     = (1 - m) E / pi + m scale L,   offset = ((1 - m) 0.04 scale + bias) L

with E the texel's irradiance, L the light in the mirror direction after the lobe, and (scale, bias) the split
sum. Source: docs/reference/conventions.md (relighting), as `lambent_relight.baked.shading` evaluates it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int
from lambent_core.directions import dot, pixel_directions
from lambent_relight.baked.light import (
    MAX_DOMINANT,
    BakedLight,
    LitTexels,
    lit_texels,
    prepare_light,
    texel_bounce,
    texel_irradiance,
)
from lambent_relight.baked.scene import BakedScene
from lambent_relight.baked.split_sum import split_sum
from lambent_relight.baked.transport_lobes import open_share
from lambent_relight.brdf import base_reflectance
from lambent_relight.environment import harmonics
from lambent_relight.environment.maps import Environment, environment_from_array
from numpy import ndarray


@dataclass(frozen=True, slots=True, eq=False)
class LitSurface:
    """A surface under one light."""

    scene: BakedScene
    light: BakedLight
    turn: Float[ndarray, "3 3"]
    """From world directions to those of the light's map."""
    diffuse: Float32[ndarray, "texels 3"]
    """(1 - m) E / pi."""
    around: Float32[ndarray, "texels 3"]
    """Mean radiance of the surroundings that hide the open sky."""

    def linear_in_albedo(
        self, texels: Int[ndarray, " rows"], omega_o: Float[ndarray, "rows 3"]
    ) -> tuple[Float32[ndarray, "rows 3"], Float32[ndarray, "rows 3"]]:
        """Return gain and offset of `texels` seen from `omega_o`: radiance = gain albedo + offset."""
        scene = self.scene
        normal, roughness = scene.normal[texels], scene.perceptual_roughness[texels, 0]
        metal = scene.metalness[texels]
        cosine = np.maximum(dot(normal, omega_o), 0.0)
        mirror = (2.0 * cosine * normal - omega_o).astype(np.float32)
        scale, bias = (part[:, None] for part in split_sum(cosine[:, 0], roughness))
        free = open_share(mirror, roughness, scene.visibility[texels])
        seen = self.light.prefiltered.lookup(mirror @ self.turn.T, roughness)
        arriving = free * seen + (1.0 - free) * self.around[texels]
        gain = self.diffuse[texels] + metal * scale * arriving
        offset = (base_reflectance(np.zeros_like(metal), metal) * scale + bias) * arriving
        return gain.astype(np.float32), offset.astype(np.float32)


class SurfaceUnderLight:
    """A baked surface under a recovered light that may be turned from photograph to photograph."""

    def __init__(self, scene: BakedScene, radiance: Float[ndarray, "rows columns 3"]) -> None:
        """Prepare the light `radiance`, a map of the light in its own axes."""
        self._scene, self._environment = scene, environment_from_array(radiance)
        self._bands = round(len(scene.transport.direct) ** 0.5)
        self._dominant = MAX_DOMINANT if scene.transport.shadow_bits is not None else 0
        self._light = prepare_light(self._environment, self._bands, self._dominant)
        self._texels = lit_texels(scene)
        self._still: LitSurface | None = None

    def turned(self, turn: Float[ndarray, "3 3"] | None) -> LitSurface:
        """Return the surface where `turn` leads from world directions to those of the light; None: none."""
        if turn is None:
            if self._still is None:
                self._still = self._lit(self._light, np.eye(3))
            return self._still
        directions = pixel_directions(*self._environment.radiance.shape[:2]) @ turn.T
        rotated = Environment(self._environment.lookup(directions))
        light = BakedLight(
            self._light.prefiltered,
            harmonics.project(rotated, self._bands),
            np.zeros((0, 3), np.float32),
            np.zeros((0, 3), np.float32),
            np.zeros(0, np.float32),
        )
        return self._lit(light, turn)

    def _lit(self, light: BakedLight, turn: Float[ndarray, "3 3"]) -> LitSurface:
        scene, texels = self._scene, self._texels
        arriving, bounced = irradiance(texels, light, self._bands)
        diffuse = (1.0 - scene.metalness) * (arriving + bounced) / np.float32(np.pi)
        around = bounced * scene.surroundings[:, None]
        return LitSurface(scene, light, turn, diffuse.astype(np.float32), around.astype(np.float32))


def irradiance(
    texels: LitTexels, light: BakedLight, bands: int
) -> tuple[Float32[ndarray, "texels 3"], Float32[ndarray, "texels 3"]]:
    """Return direct and indirect irradiance of every texel, not negative.

    Indirect light is bilinear between the blocks where it was baked, as pictures show it: what photographs
    are divided by is what the albedo is multiplied by later.
    """
    bounced = np.maximum(texel_bounce(texels, light), 0.0)
    return np.maximum(texel_irradiance(texels, light, bands), 0.0), bounced

"""Radiance of hit points in refined relighting, from baked transport: all bounces, without additional noise.

The diffuse part comes from the irradiance of the nearest texel, the specular part from the split sum, as in
`lambent_relight.baked.shading`. Source: docs/reference/conventions.md (relighting).
"""

from functools import cached_property

import numpy as np
from lambent_core.directions import dot
from numpy.typing import NDArray

from lambent_relight.baked.light import BakedLight, coarse_bounce, lit_texels, texel_irradiance
from lambent_relight.baked.scene import BakedScene, texel_positions
from lambent_relight.baked.split_sum import split_sum
from lambent_relight.baked.transport_kernels import NearestPoint
from lambent_relight.baked.transport_lobes import open_share
from lambent_relight.brdf import base_reflectance
from lambent_relight.edits import MaterialEdit


class HitFinder:
    """Finds the texel at hit points; the same for every light."""

    def __init__(self, scene: BakedScene) -> None:
        """Sort the texels of `scene` in space."""
        self.scene = scene
        self.lit = lit_texels(scene)

    @cached_property
    def nearest(self) -> NearestPoint:
        """Finds the texel nearest to a point."""
        return NearestPoint(texel_positions(self.scene.mesh, self.scene.transport))


class BakedHits:
    """Outgoing radiance of hit points under one light."""

    def __init__(self, finder: HitFinder, light: BakedLight, edit: MaterialEdit) -> None:
        """Light all texels once."""
        scene = finder.scene
        self._finder, self._light = finder, light
        bands = round(len(scene.transport.direct) ** 0.5)
        gain = edit.bounce_gain(scene.mean_albedo)
        lit = finder.lit
        self.indirect: NDArray[np.float32] = np.maximum(coarse_bounce(lit, light) * gain, np.float32(0.0))
        """Irradiance from other surfaces at every block of 2 x 2 texels, [block, 3]."""
        bounced = self.indirect[lit.coarse]
        arriving = np.maximum(texel_irradiance(lit, light, bands), 0.0) + bounced
        albedo, self._roughness = edit.apply(scene.albedo, scene.perceptual_roughness)
        self._diffuse = (1.0 - scene.metalness) * albedo * arriving / np.float32(np.pi)
        self._f0 = base_reflectance(albedo, scene.metalness)
        self._around = bounced * scene.surroundings[:, None]

    def __call__(self, position: NDArray[np.float32], omega_o: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the radiance from points [n, 3] towards `omega_o` [n, 3]."""
        return self.at_texels(self._finder.nearest(position), omega_o)

    def at_texels(self, texel: NDArray[np.integer], omega_o: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the radiance from the middle of texels [n] towards `omega_o` [n, 3]."""
        scene = self._finder.scene
        normal = scene.normal[texel]
        cosine = dot(normal, omega_o)
        mirror = (2.0 * cosine * normal - omega_o).astype(np.float32)
        roughness = self._roughness[texel]
        scale, bias = split_sum(cosine[:, 0], roughness[:, 0])
        free = open_share(mirror, roughness[:, 0], scene.visibility[texel])
        prefiltered = self._light.prefiltered.lookup(mirror, roughness[:, 0])
        lit = free * prefiltered + (1.0 - free) * self._around[texel]
        reflectance = self._f0[texel] * scale[:, None] + bias[:, None]
        return (self._diffuse[texel] + (cosine > 0.0) * reflectance * lit).astype(np.float32)

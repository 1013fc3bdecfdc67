"""The detail of a bundle's textures on a surface that is seen by other means.

The networks know materials as they were trained, mixed along every ray, and the textures know what is printed
on the surface. So refined pictures take the networks' albedo times the textures' detail: what the albedo
texture says over what the model says at the same place of the atlas, which is 1 where no photograph gave
detail.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lambent_relight.baked.raster import Fragments, interpolate, rasterise
from lambent_relight.baked.scene import BakedScene
from lambent_relight.baked.texture_lookup import bilinear
from lambent_relight.bundle.graphs import PrimaryHits
from lambent_relight.cameras import Camera

NEAR = 4.0
"""A hit belongs to the mesh up to this distance along the ray, in texels of the transport."""
_LEAST_ALBEDO = 0.01
_MOST_DETAIL = 8.0
"""Detail is limited to this factor and its inverse."""


@dataclass(frozen=True)
class SurfaceDetail:
    """The detail on the mesh of a baked surface."""

    scene: BakedScene
    tolerance: float
    """Distance between a hit and the mesh up to which they are one surface, scene units."""
    model: NDArray[np.float32]
    """The model's albedo at every place of the transport's atlas, [size, size, 3]."""

    @classmethod
    def of(cls, scene: BakedScene) -> "SurfaceDetail":
        """Return the detail of `scene`."""
        assert scene.maps is not None, "there is no detail without textures"
        texel = scene.maps.texel_size * len(scene.maps.albedo[0]) / scene.transport.size
        return cls(scene, NEAR * texel, scene.albedo[scene.texel_plane])

    def applied(self, hits: PrimaryHits, camera: Camera, ray: NDArray[np.integer]) -> PrimaryHits:
        """Return `hits` of rays with these numbers of `camera` with the detail of their albedo.

        Hits that the mesh does not cover, or that lie elsewhere along the ray, stay as they are.
        """
        mesh = self.scene.mesh
        fragments = rasterise(mesh.vertices, mesh.faces, camera)
        depth = fragments.depth.ravel()[ray]
        near = np.flatnonzero(np.abs(depth - hits.distance[:, 0]) < self.tolerance)
        part = Fragments(
            fragments.face.ravel()[ray[near]][None],
            fragments.barycentric.reshape(-1, 2)[ray[near]][None],
            depth[near][None],
        )
        uv = interpolate(part, mesh.faces, mesh.uv)
        albedo = hits.albedo.copy()
        detail = self.at(uv, depth[near] / np.float32(camera.focal_x))
        albedo[near] = np.clip(albedo[near] * detail, 0.0, 1.0)
        return replace(hits, albedo=albedo)

    def at(self, uv: NDArray[np.floating], footprint: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the factors on the model's albedo at `uv` [n, 2], means over `footprint` [n] scene units."""
        assert self.scene.maps is not None, "there is no detail without textures"
        said = self.scene.maps.albedo_at(uv, footprint) + np.float32(_LEAST_ALBEDO)
        known = bilinear(self.model, uv) + np.float32(_LEAST_ALBEDO)
        return np.clip(said / known, 1.0 / _MOST_DETAIL, _MOST_DETAIL).astype(np.float32)

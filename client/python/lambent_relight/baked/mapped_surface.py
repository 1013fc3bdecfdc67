"""The mesh of a bundle with its textures, for whatever sees the surface by other means.

The networks know the surface better at outlines, and the textures know what is printed on it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lambent_relight.asset.textured_mesh import textured_mesh_from_glb
from lambent_relight.baked.material_maps import MaterialMaps, material_maps
from lambent_relight.baked.mesh import MAX_MESH_BYTES, MESH_PATH, AtlasMesh, mesh_from_glb
from lambent_relight.baked.raster import Fragments, interpolate, rasterise
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import PrimaryHits
from lambent_relight.cameras import Camera

NEAR = 4.0
"""A hit belongs to the mesh up to this distance along the ray, in texels of the model's own textures."""


@dataclass(frozen=True)
class MappedSurface:
    """A mesh and its textures."""

    mesh: AtlasMesh
    maps: MaterialMaps

    @cached_property
    def tolerance(self) -> float:
        """Distance between a hit and the mesh up to which they are one surface, scene units."""
        return NEAR * self.maps.texel_size * len(self.maps.albedo[0]) / len(self.maps.packed)

    def materials_of(self, hits: PrimaryHits, camera: Camera, ray: NDArray[np.integer]) -> PrimaryHits:
        """Return `hits` of rays with these numbers of `camera`, with the textures' materials.

        Hits that the mesh does not cover, or that lie elsewhere along the ray, stay as they are.
        """
        found = rasterise(self.mesh.vertices, self.mesh.faces, camera)
        depth = found.depth.ravel()[ray]
        near = np.flatnonzero(np.abs(depth - hits.distance[:, 0]) < self.tolerance)
        part = Fragments(
            found.face.ravel()[ray[near]][None],
            found.barycentric.reshape(-1, 2)[ray[near]][None],
            depth[near][None],
        )
        uv = interpolate(part, self.mesh.faces, self.mesh.uv)
        albedo, roughness, metalness = (
            values.copy() for values in (hits.albedo, hits.perceptual_roughness, hits.metalness)
        )
        albedo[near] = self.maps.albedo_at(uv, depth[near] / np.float32(camera.focal_x))
        roughness[near], metalness[near] = self.maps.roughness_and_metalness_at(uv)
        return replace(hits, albedo=albedo, perceptual_roughness=roughness, metalness=metalness)


def mapped_surface(bundle: Bundle) -> MappedSurface | None:
    """Return the mesh and the textures that all renderers read, or None for bundles before 1.3.

    Raises BundleError `bundle.mesh_invalid` where the manifest promises textures that are not there.
    """
    atlas = bundle.manifest.atlas
    if not atlas.albedo_source:
        return None
    data = bundle.read(MESH_PATH, MAX_MESH_BYTES)
    maps = material_maps(textured_mesh_from_glb(data), atlas.texel_size, atlas.material_size or atlas.size)
    return MappedSurface(mesh_from_glb(data), maps)

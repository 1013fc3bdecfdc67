"""A bundle's baked surface in memory: mesh, texels with their materials, and their light transport."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lambent_relight.baked.material_maps import MaterialMaps, material_maps
from lambent_relight.baked.mesh import MAX_MESH_BYTES, MESH_PATH, AtlasMesh, mesh_from_glb, read_mesh
from lambent_relight.baked.raster import interpolate, nearest_texel, rasterise_uv
from lambent_relight.baked.transport import Transport, read_transport
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.directions import normalise
from lambent_relight.errors import BundleError, UnsupportedQuality

_LEAST_BLOCKED = 0.05
"""Share of the hemisphere that is taken to be surrounded at least, where light from there is wanted."""


@dataclass(frozen=True, eq=False)
class BakedScene:
    """The object's data for `preview` and `baked`, independent of light and camera."""

    mesh: AtlasMesh
    transport: Transport
    texel_plane: NDArray[np.int32]
    """Number of the nearest covered texel at every place of the atlas, [size, size]."""
    albedo: NDArray[np.float32]
    """Of every covered texel, [texel, 3]; as are the next three."""
    perceptual_roughness: NDArray[np.float32]
    metalness: NDArray[np.float32]
    normal: NDArray[np.float32]
    maps: MaterialMaps | None = None
    """The mesh's textures, where they are finer than the texels' materials."""

    @cached_property
    def openness(self) -> NDArray[np.float32]:
        """The unoccluded share of the cosine-weighted hemisphere, [texel] in [0, 1]."""
        return np.clip(self.transport.direct[0] / np.float32(0.5 * np.sqrt(np.pi)), 0.0, 1.0)

    @cached_property
    def mean_albedo(self) -> NDArray[np.float32]:
        """The object's mean albedo, [3]."""
        return self.albedo.mean(axis=0)

    @cached_property
    def surroundings(self) -> NDArray[np.float32]:
        """Factor from indirect irradiance to the mean radiance of the surroundings, [texel]."""
        return 1.0 / (np.float32(np.pi) * np.maximum(1.0 - self.openness, _LEAST_BLOCKED))

    @cached_property
    def visibility(self) -> NDArray[np.float32]:
        """The sky's visibility as harmonics, coefficients last, [texel, bands^2]."""
        return np.ascontiguousarray(self.transport.visibility.T)

    def materials_at(
        self, uv: NDArray[np.floating], texel: NDArray[np.integer], footprint: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return albedo [n, 3], perceptual roughness and metalness [n, 1] at places `uv` [n, 2] of the atlas.

        `texel` are `texels_at` these places; albedo is a mean over about `footprint` [n] scene units.
        """
        if self.maps is None:
            return self.albedo[texel], self.perceptual_roughness[texel], self.metalness[texel]
        return (self.maps.albedo_at(uv, footprint), *self.maps.roughness_and_metalness_at(uv))

    def texels_at(self, uv: NDArray[np.floating]) -> NDArray[np.int32]:
        """Return the number of the texel at places `uv` [n, 2] of the atlas."""
        size = self.transport.size
        place = np.clip((uv * size).astype(np.int32), 0, size - 1)
        return self.texel_plane[place[:, 1], place[:, 0]]


def load_baked_scene(bundle: Bundle) -> BakedScene:
    """Return the baked surface of a bundle.

    Raises UnsupportedQuality when the bundle has no transport, BundleError when its parts do not fit.
    """
    transport = read_transport(bundle)
    if transport is None:
        raise UnsupportedQuality(
            "relight.quality_unsupported",
            "this bundle has no baked light transport (it was exported before version 1.1)",
            'export it again, or use the quality "refined"',
        )
    atlas = bundle.manifest.atlas
    if not atlas.albedo_source:
        return baked_scene(read_mesh(bundle), transport)
    data = bundle.read(MESH_PATH, MAX_MESH_BYTES)
    maps = material_maps(data, atlas.texel_size, transport.size)
    found, stated = (maps.albedo[0].shape[:2], maps.packed.shape[:2]), (atlas.size, atlas.material_size)
    if found != tuple((size, size) for size in stated):
        raise BundleError(
            "bundle.mesh_invalid",
            f"the textures of mesh/asset.glb have {found} texels, but the manifest states {stated} a side",
            "export the bundle again",
        )
    return baked_scene(mesh_from_glb(data), transport, maps)


def baked_scene(mesh: AtlasMesh, transport: Transport, maps: MaterialMaps | None = None) -> BakedScene:
    """Return the surface of a mesh, the transport of its atlas, and its textures where they are read."""
    columns = np.ascontiguousarray(transport.material.T)
    return BakedScene(
        mesh=mesh,
        transport=transport,
        texel_plane=nearest_texel(transport.texel_index, transport.size),
        albedo=np.clip(columns[:, 0:3], 0.0, 1.0),
        perceptual_roughness=np.clip(columns[:, 3:4], 0.0, 1.0),
        metalness=np.clip(columns[:, 4:5], 0.0, 1.0),
        normal=normalise(columns[:, 5:8]),
        maps=maps,
    )


def texel_positions(mesh: AtlasMesh, transport: Transport) -> NDArray[np.float32]:
    """Return the world position of every covered texel's centre, on the mesh, [texel, 3].

    A texel that the mesh does not cover takes the position of the nearest one it does cover.
    """
    fragments = rasterise_uv(mesh.uv, mesh.faces, transport.size)
    drawn = np.flatnonzero(fragments.covered.ravel()).astype(np.int32)
    if len(drawn) == 0:
        raise BundleError("bundle.mesh_invalid", "mesh/asset.glb covers no texel", "export it again")
    positions = interpolate(fragments, mesh.faces, mesh.vertices)
    return positions[nearest_texel(drawn, transport.size).ravel()[transport.texel_index]]

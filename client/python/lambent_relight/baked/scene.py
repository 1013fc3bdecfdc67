"""A bundle's baked surface in memory: mesh, texels with their materials, and their light transport."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from lambent_core.directions import normalise
from lambent_core.errors import BundleError, UnsupportedQuality
from numpy.typing import NDArray

from lambent_relight.baked.material_maps import MaterialMaps, material_maps
from lambent_relight.baked.mesh import MAX_MESH_BYTES, MESH_PATH, AtlasMesh, mesh_from_glb
from lambent_relight.baked.raster import Fragments, interpolate, nearest_texel, rasterise_uv
from lambent_relight.baked.transport import Transport, read_transport
from lambent_relight.bundle.bundle import Bundle

_LEAST_BLOCKED = 0.05
"""Share of the hemisphere that is taken to be surrounded at least, where light from there is wanted."""


@dataclass(frozen=True, eq=False)
class SurfacePlaces:
    """Places on the triangles of a mesh."""

    corners: NDArray[np.int32]
    """The vertices of each place's triangle, [n, 3]."""
    weights: NDArray[np.float32]
    """Of these vertices; they sum to one, [n, 3]."""
    uv: NDArray[np.float32]
    """The places in the atlas, [n, 2]."""

    def __call__(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return `values` per vertex [vertex, k] interpolated, [n, k]."""
        first, second, third = (values[self.corners[:, k]] for k in range(3))
        b, c = self.weights[:, 1:2], self.weights[:, 2:3]
        return (first + b * (second - first) + c * (third - first)).astype(np.float32)

    def __getitem__(self, which: NDArray[np.integer]) -> "SurfacePlaces":
        """Return some of the places."""
        return SurfacePlaces(self.corners[which], self.weights[which], self.uv[which])

    @classmethod
    def of(cls, fragments: Fragments, mesh: AtlasMesh) -> "SurfacePlaces":
        """Return the covered places of a grid, in row-major order."""
        corners = mesh.faces[fragments.face[fragments.covered]]
        second, third = fragments.barycentric[fragments.covered].T
        weights = np.stack([1.0 - second - third, second, third], axis=-1).astype(np.float32)
        places = cls(corners, weights, np.empty((0, 2), np.float32))
        return cls(corners, weights, places(mesh.uv))


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
    """The mesh's textures, the materials of what is seen; None while an export has yet to make them."""

    @cached_property
    def openness(self) -> NDArray[np.float32]:
        """The unoccluded share of the cosine-weighted hemisphere, [texel] in [0, 1]."""
        return np.clip(self.transport.direct[0] / np.float32(0.5 * np.sqrt(np.pi)), 0.0, 1.0)

    @cached_property
    def mean_albedo(self) -> NDArray[np.float32]:
        """The object's mean albedo, [3]."""
        return self.albedo.mean(axis=0)

    @cached_property
    def blocks_around(self) -> NDArray[np.int32]:
        """The coarse texels between which indirect light is bilinear at every texel, [texel, 4].

        First its own, then those beside it, above or below it, and both. Neighbours are looked up in the
        atlas of texels, so that they belong to the same chart.
        """
        size = self.transport.size
        row, column = np.divmod(self.transport.texel_index.astype(np.int64), size)
        beside = np.clip(column + 2 * (column % 2) - 1, 0, size - 1)
        above = np.clip(row + 2 * (row % 2) - 1, 0, size - 1)
        places = ((row, column), (row, beside), (above, column), (above, beside))
        texels = np.stack([self.texel_plane[r, c] for r, c in places], axis=-1)
        return self.transport.coarse_of_texel[texels].astype(np.int32)

    @cached_property
    def surroundings(self) -> NDArray[np.float32]:
        """Factor from indirect irradiance to the mean radiance of the surroundings, [texel]."""
        return 1.0 / (np.float32(np.pi) * np.maximum(1.0 - self.openness, _LEAST_BLOCKED))

    @cached_property
    def visibility(self) -> NDArray[np.float32]:
        """The sky's visibility as harmonics, coefficients last, [texel, bands^2]."""
        return np.ascontiguousarray(self.transport.visibility.T)

    def materials_at(
        self, uv: NDArray[np.floating], footprint: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return albedo [n, 3], perceptual roughness and metalness [n, 1] at places `uv` [n, 2] of the atlas.

        They are means over about `footprint` [n] scene units.
        """
        assert self.maps is not None, "a surface is seen with its textures"
        return (
            self.maps.albedo_at(uv, footprint),
            *self.maps.roughness_and_metalness_at(uv, footprint),
        )

    def normals_at(self, places: SurfacePlaces, footprint: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return unit normals at places of the mesh, [n, 3].

        They are the mesh's, interpolated, with the detail of its normal map. `footprint` as in
        `materials_at`.
        """
        mesh = self.mesh
        assert self.maps is not None, "a surface is seen with its textures"
        assert mesh.normals is not None, "a mesh with textures has frames"
        assert mesh.tangents is not None, "a mesh with textures has frames"
        normal, frame = normalise(places(mesh.normals)), places(mesh.tangents)
        along = normalise(frame[:, :3])
        across = normalise(np.sign(frame[:, 3:]) * np.cross(normal, along))
        local = self.maps.normal_at(places.uv, footprint)
        return normalise(local[:, 0:1] * along + local[:, 1:2] * across + local[:, 2:3] * normal)

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
            "this bundle has no baked light transport (it was exported with export.transport_tier=none)",
            'export it again with --tier full or lite, or use the quality "refined"',
        )
    atlas = bundle.manifest.atlas
    data = bundle.read(MESH_PATH, MAX_MESH_BYTES)
    maps = material_maps(data, atlas.texel_size, transport.size)
    sizes, stated = (maps.albedo[0].shape[:2], maps.packed[0].shape[:2]), (atlas.size, atlas.material_size)
    if sizes != tuple((size, size) for size in stated):
        raise BundleError(
            "bundle.mesh_invalid",
            f"the textures of mesh/asset.glb have {sizes} texels, but the manifest states {stated} a side",
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

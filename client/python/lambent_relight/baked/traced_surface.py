"""The surface that secondary rays meet where the bundle's mesh is traced.

The fast cache's opacity is partial near the surface that a ray leaves: matter that is still a little
transparent is in its own way. A mesh is met exactly, and not by rays that leave it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lambent_relight.brdf import materials_from_roughness
from lambent_relight.edits import MaterialEdit
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.surroundings import Met

if TYPE_CHECKING:
    from lambent_relight.baked.scene import BakedScene
    from lambent_relight.tracing.mesh_rays import MeshRays

Rows = NDArray[np.float32]

MESH_OFFSET = 1e-4
"""Rays start this far above a mesh, as a share of its size: rounding is a hundredth of it."""
SAME_SURFACE = 0.03
"""As a share of the mesh's size: a camera ray that ends this near to the mesh ends on it."""


@dataclass(frozen=True)
class Settled:
    """Where camera rays end."""

    position: Rows
    """[ray, 3]."""
    uv: Rows
    """Place in the atlas, [ray, 2]; meaningless away from the mesh."""
    near: NDArray[np.bool_]
    """Whether it is on the mesh, [ray]."""


class TracedSurface:
    """The mesh of a baked surface, the same for every light."""

    def __init__(self, scene: "BakedScene") -> None:
        """Prepare the mesh of `scene` for rays."""
        # Compiled code takes a second to import, which programs that only look at bundles do not pay.
        from lambent_relight.tracing.mesh_rays import MeshRays

        mesh = scene.mesh
        self.scene = scene
        self.rays = MeshRays(mesh.vertices, mesh.faces)
        self._uv = mesh.uv[mesh.faces]

    @property
    def origin_offset(self) -> float:
        """How far above the surface rays start, scene units."""
        return MESH_OFFSET * self.rays.size

    def meet(self, origin: Rows, direction: Rows) -> Met:
        """Return the faces that rays [ray, 3] meet, and the texels there."""
        first = self.rays(origin, direction)
        texel = np.zeros(len(origin), np.int32)
        hit = np.flatnonzero(first.blocked)
        texel[hit] = self.texels(first.face[hit], first.weights[hit])
        return Met(first.blocked[:, None].astype(np.float32), first.distance[:, None], texel)

    def texels(self, face: NDArray[np.int32], weights: Rows) -> NDArray[np.int32]:
        """Return the texels [ray] at places of faces [ray] by the weights of their corners [ray, 3]."""
        return self.scene.texels_at(np.einsum("nc,nci->ni", weights, self._uv[face]))

    def settled(self, origin: Rows, direction: Rows, distance: Rows) -> Settled:
        """Return the points of camera rays [ray, 3] at `distance` [ray, 1], on the mesh where it is near."""
        first = self.rays(origin, direction)
        far = first.distance[:, None]
        near = np.abs(far - distance) < SAME_SURFACE * self.rays.size
        position = (origin + np.where(near, far, distance) * direction).astype(np.float32)
        # The face of a ray that misses is -1, and means nothing.
        uv = np.einsum("nc,nci->ni", first.weights, self._uv[first.face])
        return Settled(position, np.where(near, uv, np.float32(0.0)), near[:, 0])


@dataclass(frozen=True)
class MeshSurroundings:
    """The bundle's mesh with the materials of its texels."""

    traced: TracedSurface
    edit: MaterialEdit
    texels: Callable[[NDArray[np.int32], Rows], Rows] | None = None
    """Radiance of texels [n] towards directions [n, 3]."""

    @property
    def origin_offset(self) -> float:
        """Secondary rays start this far along the normal, scene units."""
        return self.traced.origin_offset

    @property
    def has_radiance(self) -> bool:
        """Whether the light of all bounces is known."""
        return self.texels is not None

    @property
    def mesh(self) -> "MeshRays":
        """The mesh that holds light back."""
        return self.traced.rays

    def met(self, face: NDArray[np.int32], where: Rows) -> Met:
        """Return what rays met at faces [ray], at (distance, u, v) [ray, 3]."""
        weights = np.stack([1.0 - where[:, 1] - where[:, 2], where[:, 1], where[:, 2]], axis=1)
        opaque = np.ones((len(face), 1), np.float32)
        return Met(opaque, where[:, :1], self.traced.texels(face, weights.astype(np.float32)))

    def meet(self, origin: Rows, direction: Rows) -> Met:
        """Return what rays [ray, 3] from offset surface points meet."""
        return self.traced.meet(origin, direction)

    def surface(self, met: Met, position: Rows, omega_o: Rows) -> SurfacePoints:
        """Return the surface that was met at `position` [ray, 3], edited."""
        assert met.texel is not None
        scene, texel = self.traced.scene, met.texel
        albedo, roughness = self.edit.apply(scene.albedo[texel], scene.perceptual_roughness[texel])
        materials = materials_from_roughness(albedo, roughness, scene.metalness[texel])
        return SurfacePoints(position, scene.normal[texel], omega_o, materials)

    def radiance(self, met: Met, position: Rows, omega_o: Rows) -> Rows:
        """Return what it sends towards `omega_o` [ray, 3], all bounces included."""
        assert self.texels is not None
        assert met.texel is not None
        return self.texels(met.texel, omega_o)

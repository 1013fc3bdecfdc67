"""Surroundings that secondary rays meet: the fast cache's, or others (`baked.traced_surface`)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from lambent_core.directions import normalise
from numpy.typing import NDArray

from lambent_relight.brdf import materials_from_roughness
from lambent_relight.bundle.graphs import SurfaceCaches
from lambent_relight.edits import MaterialEdit
from lambent_relight.refined.scattering import SurfacePoints

if TYPE_CHECKING:
    # Compiled code takes a second to import, which programs that only look at bundles do not pay.
    from lambent_relight.tracing.mesh_rays import MeshRays

Rows = NDArray[np.float32]


@dataclass(frozen=True)
class Met:
    """What rays met."""

    opacity: Rows
    """Share of the light from behind that is held back, [ray, 1]."""
    distance: Rows
    """To what holds it back, scene units, [ray, 1]; meaningless where nothing does."""
    texel: NDArray[np.int32] | None = None
    """Texel of the surface there, 0 where nothing is, [ray]; None: not known."""

    def __getitem__(self, index: NDArray[np.intp]) -> "Met":
        """Return what some of the rays met."""
        texel = None if self.texel is None else self.texel[index]
        return Met(self.opacity[index], self.distance[index], texel)


class Surroundings(Protocol):
    """What is around the points that are lit."""

    @property
    def mesh(self) -> "MeshRays | None":
        """The mesh that holds light back, or None where that is something else."""

    def met(self, face: NDArray[np.int32], where: Rows) -> Met:
        """Return what rays met at faces [ray] of `mesh`, at (distance, u, v) [ray, 3]."""

    @property
    def origin_offset(self) -> float:
        """Secondary rays start this far along the normal, scene units."""

    def meet(self, origin: Rows, direction: Rows) -> Met:
        """Return what rays [ray, 3] from offset surface points meet."""

    def surface(self, met: Met, position: Rows, omega_o: Rows) -> SurfacePoints:
        """Return the surface that was met at `position` [ray, 3], edited."""

    def radiance(self, met: Met, position: Rows, omega_o: Rows) -> Rows:
        """Return what it sends towards `omega_o` [ray, 3], all bounces included; `has_radiance` only."""

    @property
    def has_radiance(self) -> bool:
        """Whether the light of all bounces is known."""


@dataclass(frozen=True)
class CacheSurroundings:
    """The learned visibility of the fast cache, with the learned materials where a ray ends."""

    caches: SurfaceCaches
    origin_offset: float
    edit: MaterialEdit
    hits: Callable[[Rows, Rows], Rows] | None = None
    """Radiance of points [n, 3] towards directions [n, 3]."""

    @property
    def mesh(self) -> None:
        """None: there is no mesh."""
        return None

    def met(self, face: NDArray[np.int32], where: Rows) -> Met:
        """Not to be called: there is no mesh."""
        raise AssertionError("there is no mesh")

    @property
    def has_radiance(self) -> bool:
        """Whether the light of all bounces is known."""
        return self.hits is not None

    def meet(self, origin: Rows, direction: Rows) -> Met:
        """Return what rays [ray, 3] from offset surface points meet."""
        seen = self.caches.secondary(origin, direction)
        return Met(seen.opacity, seen.distance)

    def surface(self, met: Met, position: Rows, omega_o: Rows) -> SurfacePoints:
        """Return the surface that was met at `position` [ray, 3], edited."""
        properties = self.caches.material(position)
        albedo, roughness = self.edit.apply(properties.albedo, properties.perceptual_roughness)
        materials = materials_from_roughness(albedo, roughness, properties.metalness)
        return SurfacePoints(position, normalise(properties.normal), omega_o, materials)

    def radiance(self, met: Met, position: Rows, omega_o: Rows) -> Rows:
        """Return what it sends towards `omega_o` [ray, 3]."""
        assert self.hits is not None, "there is no light of all bounces"
        return self.hits(position, omega_o)

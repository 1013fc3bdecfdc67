"""Shape and materials of a trained model, as a light bake needs them."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.fields.materials import scaled
from flashcache.geometry.rays import Rays
from flashcache.physical.brdf import Materials
from flashcache.physical.incident import RayLimits, SecondaryRays
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from flashcache.training.distillation_rays import solid_points
from flashcache.training.light_bake import Hits

RAYS_PER_POINT = 2
"""Rays drawn for each point wanted: about half of those into an object's box miss it."""


def rays_into_box(
    viewpoints: Float[Tensor, "views 3"],
    box: tuple[Float[Tensor, "3"], Float[Tensor, "3"]],
    count: int,
    generator: torch.Generator,
) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, "rays 3"]]:
    """Return origins and unit directions from random viewpoints to random points of the box, world space."""
    device = viewpoints.device
    view = torch.randint(len(viewpoints), (count,), generator=generator, device=device)
    low, high = box
    target = low + torch.rand(count, 3, generator=generator, device=device) * (high - low)
    origins = viewpoints[view]
    return origins, torch.nn.functional.normalize(target - origins, dim=-1)


@dataclass(frozen=True, eq=False)
class ModelScene:
    """The NeRF cache's geometry and the material field of `model`."""

    model: InverseModel
    viewpoints: Float[Tensor, "views 3"]
    """Viewpoints, world coordinates."""
    box: tuple[Float[Tensor, "3"], Float[Tensor, "3"]]
    """Lower and upper corner of a box around the object."""
    albedo_ratio: Float[Tensor, "3"]
    """Factor on the albedo, per channel; the result is kept in [0, 1]."""

    @property
    def limits(self) -> RayLimits:
        """Where secondary rays start and end."""
        return self.model.limits

    def starts(self, count: int, generator: torch.Generator) -> ShadingPoints:
        """Return at most `count` points, drawn by render weight on rays from the viewpoints into the box."""
        origins, directions = rays_into_box(self.viewpoints, self.box, RAYS_PER_POINT * count, generator)
        near, far = (origins.new_full((len(origins),), end) for end in self.model.domain.primary)
        geometry = self.model.nerf.trace(Rays(origins, directions, near, far), generator=None)
        light = torch.zeros(len(origins), dtype=torch.long, device=origins.device)
        points, _ = solid_points(geometry, directions, light, generator, count)
        return points

    def meet(self, rays: SecondaryRays, generator: torch.Generator) -> Hits:
        """Return the points that secondary rays meet according to the NeRF cache, one each."""
        ends = [rays.origins.new_full((len(rays),), end) for end in (rays.near, rays.far)]
        inside = Rays(rays.origins, rays.directions, *ends)
        met = self.model.nerf.meet(inside, 1, generator)
        normal = self.model.nerf.normals(met.positions, met.hidden)
        return Hits(met.opacity, met.distance, met.factors[:, 0], met.positions, normal)

    def materials(self, positions: Float[Tensor, "points 3"]) -> Materials:
        """Return the materials at points, with the albedo ratio applied."""
        return scaled(self.model.materials(positions), self.albedo_ratio)

"""Radiance of surface points under an environment they were never photographed in."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Float32, Int
from numpy import ndarray
from torch import Tensor

from flashcache.fields.materials import scaled
from flashcache.geometry.directions import facing, look_up
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, relight
from flashcache.physical.incident import (
    Incident,
    LightSources,
    RadianceSource,
    SecondaryRays,
    visibility_only,
)
from flashcache.physical.model import InverseModel
from flashcache.physical.sampling import EnvironmentMapSampler
from flashcache.physical.shading import ShadingPoints

BOUNCE_COUNTS = DirectionCounts(cosine=1, sampler=2, specular=1)
"""Directions that shade what a secondary ray hits."""


@dataclass(frozen=True, slots=True, eq=False)
class MapLight:
    """A known environment: its picture, and a sampler of its bright parts."""

    image: Float[Tensor, "rows columns 3"]
    sampler: EnvironmentMapSampler

    @classmethod
    def from_image(cls, image: Float32[ndarray, "rows columns 3"], device: torch.device) -> "MapLight":
        """Return the light of a linear latitude-longitude picture in the documented convention."""
        tensor = torch.tensor(image, dtype=torch.float32, device=device)
        return cls(tensor, EnvironmentMapSampler(tensor))

    def __call__(
        self, directions: Float[Tensor, "rays 3"], light_index: Int[Tensor, " rays"]
    ) -> Float[Tensor, "rays 3"]:
        """Return the bilinearly interpolated radiance from `directions`; the light index is ignored."""
        return look_up(self.image[None], directions, torch.zeros_like(light_index))


def relit_radiance(
    model: InverseModel,
    points: ShadingPoints,
    light: MapLight,
    ratio: Float[Tensor, "3"],
    *,
    cache: RadianceSource,
    num_directions: int,
    indirect: bool,
    generator: torch.Generator,
) -> Float[Tensor, "points 3"]:
    """Return radiance towards the viewer under `light`, with the shadows of `cache`.

    With `indirect`, a secondary ray that is blocked (decided at random with its opacity, which keeps the
    mean) finds the radiance of the point it hits: direct light under the same environment, with that
    point's material.
    """
    config = EstimatorConfig(stratified=True)
    direct = LightSources(visibility_only(cache), light, model.limits)

    def near_field(rays: SecondaryRays) -> Incident:
        answer = cache(rays)
        blocked = torch.rand(len(rays), generator=generator, device=rays.origins.device) < answer.opacity
        radiance = torch.zeros_like(rays.origins)
        index = blocked.nonzero()[:, 0]
        if len(index):
            hit = rays.origins[index] + answer.distance[index, None] * rays.directions[index]
            radiance[index] = _direct(hit, -rays.directions[index], rays.light_index[index])
        return Incident(radiance, answer.opacity, answer.distance)

    def _direct(positions: Tensor, omega_o: Tensor, light_index: Tensor) -> Tensor:
        hidden = model.nerf.density(positions).hidden
        normal = facing(model.nerf.normals(positions, hidden), omega_o)
        return relight(
            ShadingPoints(positions, normal, omega_o, light_index),
            scaled(model.materials(positions), ratio),
            direct,
            light=light.sampler,
            counts=BOUNCE_COUNTS,
            config=config,
            generator=generator,
        ).rgb

    return relight(
        points,
        scaled(model.materials(points.positions), ratio),
        replace(direct, near=near_field) if indirect else direct,
        light=light.sampler,
        counts=DirectionCounts.of_picture(num_directions),
        config=config,
        generator=generator,
        continued=True,
    ).rgb

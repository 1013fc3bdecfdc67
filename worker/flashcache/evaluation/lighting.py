"""Radiance of surface points under the lights of the photographs."""

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.evaluation.monte_carlo import RenderRule
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, relight
from flashcache.physical.incident import Incident, LightSources, RadianceSource, SecondaryRays
from flashcache.physical.model import InverseModel
from flashcache.physical.sampling import EnvironmentMapSampler, Strategy
from flashcache.physical.shading import ShadingPoints

_ESTIMATOR = EstimatorConfig(stratified=True)
CORRECTION_COUNTS = DirectionCounts(cosine=1, sampler=2, specular=1)
"""Directions of a point that both caches answer."""
SKY_ROWS = 64
"""Of the picture of a learned environment from which directions are drawn."""


def sky_sampler(model: InverseModel, light: int) -> EnvironmentMapSampler:
    """Return the strategy that draws from what the model's environment sends in the light number `light`."""
    return EnvironmentMapSampler(model.environment.image(SKY_ROWS, light))


def lit_radiance(
    model: InverseModel,
    points: ShadingPoints,
    *,
    num_directions: int,
    rule: RenderRule,
    generator: torch.Generator,
    sky: EnvironmentMapSampler | None = None,
) -> Float[Tensor, "points 3"]:
    """Return the radiance that `points` send to their viewers under their own lights; no gradients.

    The fast estimate with `num_directions` per point plus the correction, as in training, or what `rule`
    leaves of them. `sky` draws from what the model's environment sends and takes the light sampler's place:
    that knows what hides the light, but is so soft that its pictures have twice the variance, also where
    little of the light arrives (docs/benchmarks/variance.md). Source: paper Eq. 9; `sky` is beyond the paper.
    """
    materials = model.materials(points.positions)
    light: Strategy | None = sky
    if sky is None and rule.sampler == "vmf":
        light = model.light_sampler(points.positions, points.light_index)
    nerf, fast = model.nerf_source(generator), model.fast_source()

    def shaded(source: RadianceSource, counts: DirectionCounts) -> Tensor:
        return relight(
            points,
            materials,
            LightSources(source, model.environment, model.limits),
            light=light,
            counts=counts,
            config=_ESTIMATOR,
            generator=generator,
            continued=True,
        ).rgb

    def difference(rays: SecondaryRays) -> Incident:
        # The estimator adds (1 - opacity) times the environment: an opacity of 1 + A - a makes that a - A.
        exact, known = nerf(rays), fast(rays)
        near = exact.near_radiance - known.near_radiance
        return Incident(near, 1.0 + exact.opacity - known.opacity, exact.distance)

    if rule.control_variate == "off":
        return shaded(nerf, CORRECTION_COUNTS)
    radiance = shaded(fast, DirectionCounts.of_picture(num_directions))
    if rule.control_variate == "on":
        radiance = radiance + shaded(difference, CORRECTION_COUNTS)
    return radiance

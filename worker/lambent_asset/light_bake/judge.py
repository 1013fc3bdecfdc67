"""Errors of an adapted cache and of baked transport relative to the physical model, on held-out rays.

The model's estimate of a ray is the training target of a light bake, with two bounces of its own; light from
three or more bounces is the adapted cache's. Its noise does not count as an error: of two independent
estimates r and r', the mean of (answer - r) (answer - r') is the squared distance to what both estimate.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from flashcache.physical.incident import SecondaryRays
from flashcache.randomness import generator_for
from flashcache.training.light_bake import STAGE, LightBake
from jaxtyping import Float
from lambent_relight.bundle.adapted import AdaptedLight, error_names
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.maps import Environment
from lambent_relight.renderer import Renderer
from torch import Tensor

Answer = Callable[[SecondaryRays], Float[Tensor, "rays 3"]]
"""The premultiplied radiance that arrives along rays from their hit points."""

_ROUNDS = 4
"""Draws of surface points and rays, as many of each as a step of the bake has."""
_ESTIMATES = 8
"""Estimates of every ray, one half for each factor of the squared distance."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Errors:
    """Root mean squared errors over the mean radiance, all rays and channels."""

    adapted: float
    transport: float | None
    """None: the bundle has no baked transport."""

    def figures(self, light: str) -> Mapping[str, float]:
        """Return the errors by their names among a manifest's metrics."""
        adapted, transport = error_names(light)
        named = {adapted: self.adapted}
        return named if self.transport is None else {**named, transport: self.transport}


@torch.no_grad()
def judged(stage: LightBake, transported: Answer | None) -> Errors:
    """Return the errors of a bake's cache and of `transported` on rays of their own."""

    def adapted(rays: SecondaryRays) -> Tensor:
        return stage.model(rays.origins, rays.directions, rays.light_index).near_radiance

    answers = {"adapted": adapted} if transported is None else {"adapted": adapted, "transport": transported}
    squares, total, count = dict.fromkeys(answers, 0.0), 0.0, 0
    device = next(stage.model.parameters()).device
    for number in range(_ROUNDS):
        generator = generator_for(stage.seed, STAGE, number, "judge", device)
        rays = stage.taught_rays(generator)
        one, other = (
            torch.stack([stage.radiance(rays, generator) for _ in range(_ESTIMATES // 2)]).mean(dim=0)
            for _ in range(2)
        )
        for name, answer in answers.items():
            answered = answer(rays)
            squares[name] += float(((answered - one) * (answered - other)).double().sum())
        total += float((0.5 * (one + other)).double().sum())
        count += one.numel()
    unit = max(total / max(count, 1), 1e-12)
    errors = {name: float(np.sqrt(max(value / max(count, 1), 0.0))) / unit for name, value in squares.items()}
    return Errors(adapted=errors["adapted"], transport=errors.get("transport"))


def transported(bundle: Bundle, environment: Environment, light: AdaptedLight) -> Answer | None:
    """Return the radiance that refined relighting takes from baked transport; None without transport.

    `environment` is turned already.
    """
    if not bundle.manifest.HasField("transport"):
        return None
    renderer = Renderer(bundle, num_threads=torch.get_num_threads())
    hits = renderer.baked().hits(environment, MaterialEdit(albedo_gain=light.albedo_ratio))

    def radiance(rays: SecondaryRays) -> Tensor:
        origin, direction = rays.origins.cpu().numpy(), rays.directions.cpu().numpy()
        seen = renderer.caches.secondary(origin, direction)
        arriving = seen.opacity * hits(origin + seen.distance * direction, -direction)
        return torch.from_numpy(arriving).to(rays.origins)

    return radiance

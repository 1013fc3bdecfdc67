"""The gate of the polish: elements whose unseen photographs stage two explains better keep its material."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.color import srgb_from_linear
from flashcache.data.ray_batches import TrainingPixels
from flashcache.evaluation.lighting import lit_radiance, sky_sampler
from flashcache.evaluation.monte_carlo import RenderRule
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.directions import normalize
from flashcache.physical.model import InverseModel
from flashcache.physical.sampling import EnvironmentMapSampler
from flashcache.physical.shading import ShadingPoints
from flashcache.polish.elements import Elements
from flashcache.polish.light import Reflectance
from flashcache.polish.neighbours import Neighbours
from flashcache.randomness import generator_for
from flashcache.volume.quadrature import draw_points

STAGE = "polish"
WORSE = 10.0**0.01
"""Factor by which the error of unseen photographs may grow in all: a tenth of a decibel."""
MOST_PIXELS = 8000
POINTS, DIRECTIONS = 2, 16
"""Points of a pixel that are shaded, and directions of each."""
CHUNK_PIXELS = 1024
LOOKED_UP = 1 << 14
"""Photographs' pixels that are looked up at once."""
POOL = 8
"""Steps along the graph over which errors are averaged."""
BLEND = 2
"""Steps over which the choice is smoothed, so that no border shows."""
LEAST_SHARE = 0.25
"""Share of the elements from which on a polish is worth having."""


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """What stays of a fit."""

    share: Float[Tensor, " elements"]
    """Of the fit in each element, 0..1."""
    before: float
    """Mean error of stage two in photographs that the fit has not seen."""
    fitted: float
    """That of the whole fit."""


def rendered(
    model: InverseModel, pixels: TrainingPixels, index: Int[Tensor, " some"], repeat: int, *, seed: int
) -> Float[Tensor, "some 3"]:
    """Return the radiance of rendered pixels, linear Rec. 709, from the fast cache alone.

    Each in the light of its photograph. Every model gets the same random numbers, so that models can be
    compared; every `repeat` gets its own.
    """
    rule = RenderRule(control_variate="fast_only")
    picture = torch.zeros(len(index), 3)
    light = torch.cat([pixels.at(part).light_index for part in index.split(LOOKED_UP)])
    skies = [sky_sampler(model, number) for number in range(len(model.domain.lights))]
    parts_by_light = [
        (sky, part)
        for number, sky in enumerate(skies)
        for part in (light == number).nonzero()[:, 0].split(CHUNK_PIXELS)
    ]

    def fill(numbered: tuple[int, tuple[EnvironmentMapSampler, Tensor]]) -> None:
        number, (sky, some) = numbered
        batch = pixels.at(index[some])
        generator = generator_for(seed, STAGE, number, f"pixels_{repeat}", batch.colour.device)
        geometry = model.nerf.trace(batch.rays, generator=None)
        parts = (torch.arange(POINTS) + 0.5) / POINTS
        drawn = draw_points(geometry.weights, parts.expand(len(some), POINTS)).index[..., None]
        places = geometry.samples.positions.reshape(len(some), -1, 3)
        points = ShadingPoints(
            places.gather(1, drawn.expand(-1, -1, 3)).reshape(-1, 3),
            geometry.normal.reshape(len(some), -1, 3).gather(1, drawn.expand(-1, -1, 3)).reshape(-1, 3),
            (-batch.rays.directions).repeat_interleave(POINTS, dim=0),
            batch.light_index.repeat_interleave(POINTS),
        )
        radiance = lit_radiance(
            model, points, num_directions=DIRECTIONS, rule=rule, generator=generator, sky=sky
        )
        picture[some] = radiance.reshape(len(some), POINTS, 3).mean(dim=1)

    on_all_cores(fill, enumerate(parts_by_light), index.device)
    return picture


def picture_errors(
    model: InverseModel, pixels: TrainingPixels, index: Int[Tensor, " some"], seed: int
) -> Float[Tensor, " some"]:
    """Return the squared error of rendered pixels as pictures show it: sRGB-encoded and at most white.

    The mean of the channels. It is the product of two renderings' errors, so that the variance of neither is
    in it: metals have more of that, and would be given up for it. Single values may be negative.
    """
    colour = _shown(torch.cat([pixels.at(part).colour for part in index.split(LOOKED_UP)]))
    one, other = (_shown(rendered(model, pixels, index, repeat, seed=seed)) - colour for repeat in range(2))
    return (one * other).mean(dim=1)


def _shown(radiance: Float[Tensor, "pixels 3"]) -> Float[Tensor, "pixels 3"]:
    return srgb_from_linear(radiance.clamp(0.0, 1.0))


def gate(
    before: InverseModel,
    fitted: InverseModel,
    pixels: TrainingPixels,
    checks: Elements,
    neighbours: Neighbours,
    seed: int,
) -> Gate:
    """Return how much of a fit stays in each element, given the models before and after it.

    `checks` are the elements in photographs that had no part in the fit: a material that follows noise or a
    wrong normal has no advantage there. Where their pixels get worse in all by more than `WORSE`, elements
    fall back to stage two, the worst neighbourhoods first, until the rest is within that.
    """
    generator = generator_for(seed, STAGE, 0, "checks", pixels.device)
    some = torch.randperm(len(checks.pixel), generator=generator)[:MOST_PIXELS].sort().values
    errors = [picture_errors(model, pixels, checks.pixel[some], seed) for model in (before, fitted)]
    element, excess = checks.element[some], errors[1] - errors[0]
    amount = torch.bincount(element, minlength=len(checks)).float()
    total = torch.zeros(len(checks)).index_add_(0, element, excess)
    around = neighbours.pooled((total / amount.clamp_min(1.0))[:, None], amount, POOL)[:, 0]
    order = around.argsort(descending=True)
    # What remains when the worst 0, 1, 2, ... elements are given up. Of means over neighbours: the worst of
    # single pixels are the unluckiest, and giving them up would promise too much.
    worth = (around * amount)[order]
    remaining = worth.sum() - torch.cat([torch.zeros(1), worth.cumsum(0)])
    allowed = (WORSE - 1.0) * errors[0].sum()
    given_up = int((remaining <= allowed).to(torch.uint8).argmax())
    kept = torch.ones(len(checks))
    kept[order[:given_up]] = 0.0
    share = neighbours.pooled(kept[:, None], torch.ones(len(checks)), BLEND)[:, 0] if given_up else kept
    return Gate(share, float(errors[0].mean()), float(errors[1].mean()))


def blended(one: Reflectance, other: Reflectance, share: Float[Tensor, " elements"]) -> Reflectance:
    """Return `one` with `share` of `other`: albedo and width by their logarithms."""

    def of_logs(a: Tensor, b: Tensor, weight: Tensor) -> Tensor:
        return torch.lerp(a.clamp_min(1e-4).log(), b.clamp_min(1e-4).log(), weight).exp()

    return Reflectance(
        of_logs(one.albedo, other.albedo, share[:, None]),
        of_logs(one.alpha, other.alpha, share),
        torch.lerp(one.metalness, other.metalness, share),
        normalize(torch.lerp(one.normal, other.normal, share[:, None])),
    )

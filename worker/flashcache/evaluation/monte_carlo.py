"""Pictures as means of many estimates, with the standard error of the mean.

Every repeat shades K points of a ray, the k-th drawn from the k-th of K equal parts (strata) of the render
weight. Values of different strata and repeats are independent, but not equally distributed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from lambent_core.scene import Camera
from torch import Tensor

from flashcache.errors import ConfigError
from flashcache.evaluation.gbuffer import CHUNK_RAYS, OPACITY_FLOOR, camera_rays
from flashcache.evaluation.supersampling import Picture, PictureSamples, finer, mean_picture
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.rays import Rays
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from flashcache.randomness import generator_for
from flashcache.volume.quadrature import draw_points, median_point


@dataclass(frozen=True, kw_only=True, slots=True)
class RenderRule:
    """How a model is rendered: an ablated model in the same way as it was trained."""

    control_variate: Literal["on", "off", "fast_only"] = "on"
    """"off" uses the NeRF cache only, in pictures and for shadows: the fast cache was not trained."""
    sampler: Literal["vmf", "none"] = "vmf"
    """"none" draws from the cosine where pictures would draw from the light, as the training did."""
    points: Literal["categorical", "depth"] = "categorical"
    """Shade points drawn by their weight, or the point where half the weight is passed (biased)."""
    shadows: Literal["fast", "nerf"] = "fast"
    """Cache for shadows under a new light; the paper's figures use the NeRF cache."""

    @property
    def shadow_cache(self) -> Literal["fast", "nerf"]:
        """Return the cache that answers secondary rays under a new light."""
        return "nerf" if self.control_variate == "off" else self.shadows


Shade = Callable[[ShadingPoints, torch.Generator], Tensor]
"""Returns an estimate of the radiance [points, 3] that points reflect, from fresh random numbers."""


class Spread:
    """Running means and squared deviations of equally many values per stratum (Welford's update)."""

    def __init__(self, first: Float[Tensor, "pixels strata 3"]) -> None:
        self.count = 1
        self.mean = first.clone()
        self.squares = torch.zeros_like(first)

    def add(self, values: Float[Tensor, "pixels strata 3"]) -> None:
        """Add the values of one more repeat."""
        self.count += 1
        change = values - self.mean
        self.mean += change / self.count
        self.squares += change * (values - self.mean)


def variance_of_mean(spread: Spread) -> Float[Tensor, "pixels 3"]:
    """Return the estimated variance of the mean over all strata and repeats.

    From two repeats on it is unbiased: (sum of the strata's variances) / (K^2 R). One repeat alone cannot
    tell a difference between two strata from noise; then neighbouring strata are compared, which is unbiased
    where they have the same mean and too large otherwise (Cochran, Sampling Techniques, 5A.12). A single
    value has no spread: the result is NaN.
    """
    strata = spread.mean.shape[1]
    if spread.count > 1:
        per_stratum = spread.squares / (spread.count - 1)
        return per_stratum.sum(dim=1) / (strata**2 * spread.count)
    if strata == 1:
        return torch.full_like(spread.mean[:, 0], float("nan"))
    total = torch.zeros_like(spread.mean[:, 0])
    pairs = [2] * (strata // 2 - strata % 2) + [3] * (strata % 2)
    for group in spread.mean.split(pairs, dim=1):
        total += group.shape[1] * group.var(dim=1)
    return total / strata**2


@torch.no_grad()
def monte_carlo(
    model: InverseModel,
    camera: Camera,
    shade: Shade,
    samples: PictureSamples,
    *,
    light: int,
    seed: int,
    purpose: str,
    points: Literal["categorical", "depth"] = "categorical",
) -> Picture:
    """Return the mean of `shade` over points drawn along the rays of every pixel, with its standard error."""
    points_per_ray = samples.points_per_ray
    if samples.num_repeats < 1:
        raise ConfigError(
            f"a picture needs at least one repeat and one point per ray, "
            f"got {samples.num_repeats} and {points_per_ray}"
        )
    camera = finer(camera, samples.antialias)
    device = next(model.parameters()).device
    rays = camera_rays(model, camera, device)
    colour = torch.zeros(len(rays), 3, device=device)
    error = torch.zeros(len(rays), 3, device=device)
    opacity = torch.zeros(len(rays), 1, device=device)
    # In blocks, so that the rays of one pixel are neighbours in a batch and avoid each other's directions.
    order = _by_blocks(camera, samples.antialias, device)
    hits = order[(rays.far > rays.near)[order]]

    def fill(part: tuple[int, Tensor]) -> None:
        """Write the pictures' values for some rays, which are in no other part."""
        number, some = part
        generator = generator_for(seed, purpose, number, camera_key(camera), device)
        geometry = model.nerf.trace(rays.select(some), generator=None)
        opacity[some, 0] = geometry.opacity
        seen = geometry.opacity > OPACITY_FLOOR
        if not bool(seen.any()):
            return
        pixels, weights = some[seen], geometry.weights[seen]
        first_sample = weights.shape[-1] * seen.nonzero()
        positions = geometry.samples.positions.reshape(-1, 3)
        spread: Spread | None = None
        for _ in range(samples.num_repeats):
            index = _drawn(weights, points_per_ray, points, generator) + first_sample
            shading = _shading_points(rays, pixels, index, positions, geometry.normal, light)
            values = shade(shading, generator).reshape(len(pixels), points_per_ray, 3)
            if spread is None:
                spread = Spread(values)
            else:
                spread.add(values)
        assert spread is not None
        colour[pixels] = spread.mean.mean(dim=1)
        error[pixels] = variance_of_mean(spread).sqrt()

    on_all_cores(fill, enumerate(hits.split(CHUNK_RAYS) if len(hits) else ()), device)
    shape = (camera.height, camera.width, -1)
    to_numpy = [values.reshape(shape).cpu().numpy() for values in (colour, error, opacity)]
    return mean_picture(Picture(*to_numpy), samples.antialias)


def _by_blocks(camera: Camera, block: int, device: torch.device) -> Tensor:
    """Return the numbers of all rays, those of a block of `block` x `block` one after another."""
    number = torch.arange(camera.height * camera.width, device=device)
    blocks = number.reshape(camera.height // block, block, camera.width // block, block)
    return blocks.transpose(1, 2).reshape(-1)


def _drawn(weights: Tensor, count: int, points: str, generator: torch.Generator) -> Tensor:
    """Return which of a ray's samples are shaded [pixels, points]."""
    if points == "depth":
        return median_point(weights).index.expand(-1, count)
    u = torch.rand(len(weights), count, generator=generator, device=weights.device)
    # One draw per stratum of the cumulative weight: the same mean with less noise.
    strata = torch.arange(count, device=weights.device)
    return draw_points(weights, (u + strata) / count).index


def _shading_points(
    rays: Rays, pixels: Tensor, index: Tensor, positions: Tensor, normal: Tensor, light: int
) -> ShadingPoints:
    flat = index.reshape(-1)
    owner = pixels.repeat_interleave(index.shape[1])
    return ShadingPoints(
        positions=positions[flat],
        normal=normal[flat],
        omega_o=-rays.directions[owner],
        light_index=torch.full((len(flat),), light, device=flat.device),
    )


def camera_key(camera: Camera) -> str:
    """Return a text that differs between cameras, for independent random streams."""
    return ",".join(f"{value:.6f}" for value in camera.camera_to_world[:3].reshape(-1))

"""The exported functions in torch: what the graphs of `flashcache.export.graphs` must equal.

Rays and points are world coordinates in scene units, radiance is linear, and results are by output name
[row, size].
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.caches.fast_cache import FastCache
from flashcache.color import perceptual_roughness_from_alpha
from flashcache.errors import ConfigError
from flashcache.physical.model import InverseModel

Outputs = dict[str, Tensor]

OPACITY_FLOOR = 1e-3
"""Means over a ray are divided by its opacity, or by this where the opacity is smaller."""
UPRIGHT_OPACITY = 0.01
"""Below this opacity the mean normal leans towards +z, so that empty rays have one."""
SURFACE_THICKNESS = 0.01
"""Thickness of matter, in scene units, whose opacity the material function returns."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GbufferRule:
    """Sampling of the gbuffer function along a ray: at fixed fractions of its stretch inside a box.

    With fixed samples, the result is a smooth function of the ray that every runtime rounds alike; samples
    from proposal networks would be closer to training, but their rounding errors grow with the density.
    """

    box_min: tuple[float, float, float]
    box_max: tuple[float, float, float]
    num_samples: int = 128
    """Samples along a ray at which density is evaluated."""
    group: int = 4
    """Neighbouring samples that share one lookup of normal and materials, at their mean position."""

    def __post_init__(self) -> None:
        if self.num_samples < 1 or self.num_samples % self.group:
            raise ConfigError(
                f"gbuffer_samples must be a positive multiple of {self.group}, got {self.num_samples}"
            )


def gbuffer(
    model: InverseModel,
    rule: GbufferRule,
    origin: Float[Tensor, "rays 3"],
    direction: Float[Tensor, "rays 3"],
) -> Outputs:
    """Return opacity and means over the render weights along camera rays (paper Eq. 3).

    The stretch [a, b] of the ray inside the box starts at the ray's origin at the earliest and is empty where
    the ray misses. Density is looked up at t_k = a + s_k, s_k = (k + 1/2)/S (b - a), and gives weights w_k of
    intervals of equal length around t_k; opacity = sum w_k, distance = sum w_k t_k / max(opacity, 1e-3).
    A group of neighbouring places has W = sum w_k and s = sum w_k s_k / max(W, 1e-6) over its members.
    Albedo, perceptual roughness and metalness are sum W v(a + s) / max(opacity, 1e-3) over the groups. The
    normal is sum W n(a + s) + relu(0.01 - opacity) z, normalised.
    """
    start, end = stretch(rule, origin, direction)
    count, group = rule.num_samples, rule.group
    fractions = ((torch.arange(count, device=origin.device) + 0.5) / count).to(origin.dtype)
    # Distances are counted from the box, not from the camera: small numbers keep their last digits.
    entry = origin + start * direction
    inside = fractions * (end - start)
    positions = entry[:, None] + inside[..., None] * direction[:, None]
    depth = model.nerf.density.density(positions) * ((end - start) / count)
    before = torch.nn.functional.pad(depth[:, :-1].cumsum(dim=-1), (1, 0))
    weights = -torch.expm1(-depth) * torch.exp(-before)
    opacity = weights.sum(dim=-1, keepdim=True)
    share = 1.0 / opacity.clamp_min(OPACITY_FLOOR)

    grouped = weights.reshape(-1, count // group, group)
    mass = grouped.sum(dim=-1)
    moment = (grouped * inside.reshape(grouped.shape)).sum(dim=-1)
    middles = entry[:, None] + (moment / mass.clamp_min(1e-6))[..., None] * direction[:, None]
    properties = surface(model, middles.reshape(-1, 3))

    def mean(name: str) -> Tensor:
        values = properties[name].reshape(*mass.shape, -1)
        return (mass[..., None] * values).sum(dim=1)

    upright = (UPRIGHT_OPACITY - opacity).relu() * origin.new_tensor([0.0, 0.0, 1.0])
    return {
        "opacity": opacity,
        "distance": (weights * (start + inside)).sum(dim=-1, keepdim=True) * share,
        "normal": torch.nn.functional.normalize(mean("normal") + upright, dim=-1, eps=1e-8),
        "albedo": mean("albedo") * share,
        "perceptual_roughness": mean("perceptual_roughness") * share,
        "metalness": mean("metalness") * share,
    }


def stretch(
    rule: GbufferRule, origin: Float[Tensor, "rays 3"], direction: Float[Tensor, "rays 3"]
) -> tuple[Float[Tensor, "rays 1"], Float[Tensor, "rays 1"]]:
    """Return where rays enter and leave the box, not before their origins; equal where they miss it."""
    safe = torch.where(direction.abs() < 1e-9, torch.full_like(direction, 1e-9), direction)
    first = (origin.new_tensor(rule.box_min) - origin) / safe
    second = (origin.new_tensor(rule.box_max) - origin) / safe
    start = torch.minimum(first, second).amax(dim=-1, keepdim=True).clamp_min(0.0)
    end = torch.maximum(first, second).amin(dim=-1, keepdim=True)
    return start, torch.maximum(start, end)


def surface(model: InverseModel, positions: Float[Tensor, "points 3"]) -> Outputs:
    """Return normal, materials and density at points."""
    density = model.nerf.density(positions)
    materials = model.materials(positions)
    return {
        "albedo": materials.albedo,
        "perceptual_roughness": perceptual_roughness_from_alpha(materials.alpha),
        "metalness": materials.metalness,
        "normal": model.nerf.normals(positions, density.hidden),
        "density": density.density[:, None],
    }


def material(model: InverseModel, position: Float[Tensor, "points 3"]) -> Outputs:
    """Return surface properties at points; opacity is that of 0.01 scene units of the matter there."""
    properties = surface(model, position)
    properties["opacity"] = -torch.expm1(-SURFACE_THICKNESS * properties.pop("density"))
    return properties


def fast_cache(
    model: InverseModel, light: int, origin: Float[Tensor, "rays 3"], direction: Float[Tensor, "rays 3"]
) -> Outputs:
    """Return the fast cache's near radiance (premultiplied) under a training light, opacity and distance."""
    return cache_outputs(model.fast, light, origin, direction)


def cache_outputs(
    fast: FastCache, light: int, origin: Float[Tensor, "rays 3"], direction: Float[Tensor, "rays 3"]
) -> Outputs:
    """Return the outputs of `fast_cache`, for any fast cache and one of its heads."""
    index = torch.full((len(origin),), light, dtype=torch.long, device=origin.device)
    answer = fast(origin, direction, index)
    return {
        "radiance": answer.near_radiance,
        "opacity": answer.opacity[:, None],
        "distance": answer.distance[:, None],
    }

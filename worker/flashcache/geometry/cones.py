"""Pixels as cones: six points with a width in place of the middle of an interval (Zip-NeRF's multisampling).

Distances, radii and widths are in scene units; a cone's radius is the one at distance one.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.geometry.directions import tangent_frame
from flashcache.geometry.rays import Rays

ANGLES = tuple(angle * math.pi / 3.0 for angle in (0, 2, 4, 3, 5, 1))
"""Around the axis, in the order of the points along it: two triangles, one turned against the other."""
WIDTH_SCALE = 0.5
"""Widths are half of what moment matching gives, as in Zip-NeRF."""


class ConePoints(NamedTuple):
    """Six points in each of `points` intervals."""

    positions: Float[Tensor, "points 6 3"]
    width: Float[Tensor, "points 6"]
    """Standard deviation of the blob that each point stands for."""


def cone_points(
    rays: Rays,
    distances: Float[Tensor, "rays edges"],
    generator: torch.Generator | None = None,
) -> ConePoints:
    """Return the points that stand for the intervals of `rays`, ray after ray.

    Their mean and spread along and across the ray are those of the cone's frustum. A generator turns the
    pattern of every interval at random. Rays without a radius are lines. Source: Zip-NeRF, multisampling.
    """
    start, end = distances[:, :-1, None], distances[:, 1:, None]
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    j = torch.arange(6, dtype=middle.dtype, device=middle.device)
    spread = 3.0 / math.sqrt(7.0) * (2.0 * j / 5.0 - 1.0)
    root = torch.sqrt((half.square() - middle.square()).square() + 4.0 * middle.pow(4))
    scale = half / (half.square() + 3.0 * middle.square()).clamp_min(1e-12)
    t = start + scale * (end.square() + 2.0 * middle.square() + spread * root)
    radius = torch.zeros_like(rays.near) if rays.radius is None else rays.radius
    width = radius[:, None, None] * t / math.sqrt(2.0)
    angle = torch.tensor(ANGLES, dtype=t.dtype, device=t.device).expand_as(t)
    if generator is not None:
        turn = torch.rand(t.shape[:2], generator=generator, dtype=t.dtype, device=t.device)
        angle = angle + 2.0 * math.pi * turn[..., None]
    across, up = tangent_frame(rays.directions)
    along = rays.origins[:, None, None] + t[..., None] * rays.directions[:, None, None]
    sideways = angle.cos()[..., None] * across[:, None, None] + angle.sin()[..., None] * up[:, None, None]
    positions = along + width[..., None] * sideways
    return ConePoints(positions.reshape(-1, 6, 3), WIDTH_SCALE * width.reshape(-1, 6))


def pixel_radius(focal: Float[Tensor, "*rays"]) -> Float[Tensor, "*rays"]:
    """Return the radius at distance one of the cone with a pixel's variance; `focal` in pixels."""
    return 2.0 / math.sqrt(12.0) / focal

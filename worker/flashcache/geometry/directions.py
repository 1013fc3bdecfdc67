"""Unit vectors: normalising, reflecting, local frames, and where a direction lies in an environment picture.

The world is right-handed with z up. Environment pictures are equirectangular: row 0 looks along +z, column
W/2 along +x, and the azimuth decreases to the right. Picture coordinates `uv` are in [0, 1), u to the right
and v downwards.
"""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

SQUARED_FLOOR = 1e-20
GRADIENT_SQUARED_FLOOR = 1.2e-7


def dot(a: Float[Tensor, "*#batch 3"], b: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 1"]:
    """Return the scalar product, with the axis kept."""
    return (a * b).sum(dim=-1, keepdim=True)


def normalize(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Return unit vectors; vectors shorter than 1e-10 come out shorter than 1, and zero stays zero.

    The gradient is that of a division by max(length, 3.5e-4), so that a vanishing vector cannot blow it up.
    """
    squared = dot(vectors, vectors)
    if not (torch.is_grad_enabled() and vectors.requires_grad):
        return vectors * squared.clamp_min(SQUARED_FLOOR).rsqrt()
    smooth = vectors * squared.clamp_min(GRADIENT_SQUARED_FLOOR).rsqrt()
    exact = (vectors * squared.clamp_min(SQUARED_FLOOR).rsqrt()).detach()
    return smooth + (exact - smooth.detach())


def reflect(omega: Float[Tensor, "*#batch 3"], axis: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Return `omega` mirrored about the unit vector `axis`; both point away from the surface."""
    return 2.0 * dot(omega, axis) * axis - omega


def facing(
    normal: Float[Tensor, "*batch 3"], omega_o: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Return unit normals that face `omega_o`: those that do not are tilted until they just do.

    Surfaces are always seen from outside: opaque matter has no back side, whatever its normal says.
    """
    away = dot(normal, omega_o).clamp_max(0.0)
    return normalize(normal - 1.01 * away * omega_o)


def tangent_frame(
    normal: Float[Tensor, "*batch 3"],
) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Return unit vectors (tangent, bitangent) that make a right-handed frame with the unit vector `normal`.

    The tangent is up x normal, where up is +z, or +y for normals within 26 degrees of the z axis: robust for
    every direction, and discontinuous on that cone.
    """
    x, y, z = normal.unbind(dim=-1)
    zero = torch.zeros_like(x)
    steep = (z.abs() >= 0.9).unsqueeze(-1)
    across = torch.where(steep, torch.stack([z, zero, -x], dim=-1), torch.stack([-y, x, zero], dim=-1))
    tangent = across * dot(across, across).clamp_min(SQUARED_FLOOR).rsqrt()
    return tangent, torch.linalg.cross(normal, tangent)


def from_frame(
    local: Float[Tensor, "*#batch 3"], normal: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """Return world directions of `local` ones, whose z axis is `normal`."""
    tangent, bitangent = tangent_frame(normal)
    return local[..., 0:1] * tangent + local[..., 1:2] * bitangent + local[..., 2:3] * normal


def direction_from_uv(uv: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3"]:
    """Return the unit direction in which the picture coordinates `uv` of an environment look."""
    azimuth = math.pi - 2.0 * math.pi * uv[..., 0]
    polar = math.pi * uv[..., 1]
    ring = torch.sin(polar)
    return torch.stack([ring * torch.cos(azimuth), ring * torch.sin(azimuth), torch.cos(polar)], dim=-1)


def uv_from_direction(direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 2"]:
    """Return the picture coordinates in [0, 1) x [0, 1] of unit directions; u is arbitrary at the poles."""
    x, y, z = direction.unbind(dim=-1)
    u = (0.5 - torch.atan2(y, x) / (2.0 * math.pi)).remainder(1.0)
    v = torch.atan2(torch.hypot(x, y), z) / math.pi
    return torch.stack([u, v], dim=-1)


def environment_directions(
    height: int, width: int, dtype: torch.dtype = torch.float32
) -> Float[Tensor, "height width 3"]:
    """Return the unit direction through the centre of every pixel of an environment picture."""
    u = (torch.arange(width, dtype=dtype) + 0.5) / width
    v = (torch.arange(height, dtype=dtype) + 0.5) / height
    grid = torch.stack(torch.meshgrid(u, v, indexing="xy"), dim=-1)
    return direction_from_uv(grid)


def environment_solid_angles(
    height: int, width: int, dtype: torch.dtype = torch.float32
) -> Float[Tensor, "height"]:
    """Return the solid angle of one pixel in each row, in sr; the whole picture has 4 pi."""
    edges = torch.arange(height + 1, dtype=dtype) * (math.pi / height)
    return (torch.cos(edges[:-1]) - torch.cos(edges[1:])) * (2.0 * math.pi / width)


def look_up(
    images: Float[Tensor, "pictures height width 3"],
    directions: Float[Tensor, "rays 3"],
    index: Int[Tensor, " rays"],
) -> Float[Tensor, "rays 3"]:
    """Return the bilinearly interpolated radiance of each ray's picture; azimuth wraps, the poles do not."""
    _, rows, columns, _ = images.shape
    uv = uv_from_direction(directions)
    x, y = uv[:, 0] * columns - 0.5, uv[:, 1] * rows - 0.5
    x0, y0 = x.floor(), y.floor()
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    left, right = x0.long() % columns, (x0.long() + 1) % columns
    top, bottom = y0.long().clamp(0, rows - 1), (y0.long() + 1).clamp(0, rows - 1)
    upper = torch.lerp(images[index, top, left], images[index, top, right], fx)
    lower = torch.lerp(images[index, bottom, left], images[index, bottom, right], fx)
    return torch.lerp(upper, lower, fy)

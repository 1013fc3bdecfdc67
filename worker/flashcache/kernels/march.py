"""The stretch of a ray on which a lattice has occupied cells, in plain torch; `cells` has the compiled loop.

Points are at near + (k + 1/2) step, k = 0, 1, ... up to far. The stretch begins a step before the first
one in an occupied cell, and ends a step behind the last one, within near and far; without any it is empty.
"""

import math

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from flashcache.geometry.rays import Rays

_CHUNK = 1 << 22
"""Points that are looked up at once."""


def stretch(
    rays: Rays, cells: UInt8[Tensor, "x y z"], low: Float[Tensor, "3"], high: Float[Tensor, "3"], step: float
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """Return new near and far distances; `low` and `high` are the lattice's corners, all in scene units."""
    origins, directions, near, far = rays.origins, rays.directions, rays.near, rays.far
    longest = float((far - near).max()) if len(near) else 0.0
    number = max(1, math.ceil(longest / step))
    parts = []
    rows = max(1, _CHUNK // number)
    k = torch.arange(number, device=near.device, dtype=near.dtype) + 0.5
    for start in range(0, len(near), rows):
        some = slice(start, start + rows)
        t = near[some, None] + k * step
        points = origins[some, None] + t[..., None] * directions[some, None]
        count = cells.shape[0]
        place = (points - low) * (count / (high - low))
        inside = ((place >= 0.0) & (place < count)).all(dim=-1) & (t < far[some, None])
        x, y, z = place.long().clamp(0, count - 1).unbind(dim=-1)
        hit = inside & (cells.view(-1)[(x * count + y) * count + z] > 0)
        any_hit = hit.any(dim=-1)
        begin = torch.where(hit, t, t.new_tensor(torch.inf)).amin(dim=-1) - step
        end = torch.where(hit, t, t.new_tensor(-torch.inf)).amax(dim=-1) + step
        begin = torch.where(any_hit, torch.maximum(begin, near[some]), near[some])
        end = torch.where(any_hit, torch.minimum(end, far[some]), near[some])
        parts.append(torch.stack([begin, end]))
    if not parts:
        return near, far
    begin, end = torch.cat(parts, dim=1)
    return begin, end

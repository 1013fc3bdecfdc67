"""Rays: origins, directions, and near and far distances.

World frame: right-handed, z up, scene units. Camera frame: x right, y up, looking along -z.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Rays:
    """A batch of rays; `directions` are unit vectors and distances are in scene units."""

    origins: Float[Tensor, "rays 3"]
    directions: Float[Tensor, "rays 3"]
    near: Float[Tensor, " rays"]
    far: Float[Tensor, " rays"]

    def __len__(self) -> int:
        return self.origins.shape[0]

    def at(self, distances: Float[Tensor, "rays samples"]) -> Float[Tensor, "rays samples 3"]:
        """Return the points at `distances` from the origins, in world coordinates."""
        return self.origins[:, None] + distances[..., None] * self.directions[:, None]

    def select(self, index: Tensor | slice) -> "Rays":
        """Return the rays that `index` (a mask, indices or a slice) picks."""
        return Rays(self.origins[index], self.directions[index], self.near[index], self.far[index])


def pixel_directions(
    columns: Float[Tensor, " rays"],
    rows: Float[Tensor, " rays"],
    focal_xy: Float[Tensor, "*rays 2"],
    centre_xy: Float[Tensor, "*rays 2"],
    camera_to_world: Float[Tensor, "*rays 4 4"],
) -> Float[Tensor, "rays 3"]:
    """Return unit world directions through image positions given in pixels.

    Pixel (row r, column c) has its centre at (c + 0.5, r + 0.5); rows grow downwards.
    """
    x = (columns - centre_xy[..., 0]) / focal_xy[..., 0]
    y = -(rows - centre_xy[..., 1]) / focal_xy[..., 1]
    local = torch.stack([x, y, -torch.ones_like(x)], dim=-1)
    world = (camera_to_world[..., :3, :3] @ local[..., None])[..., 0]
    return torch.nn.functional.normalize(world, dim=-1)


def clip_to_box(
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    box_min: Float[Tensor, "3"],
    box_max: Float[Tensor, "3"],
    near: float,
    far: float,
) -> Rays:
    """Return rays limited to their stretch inside an axis-aligned box, within [near, far].

    A ray that misses the box gets an empty stretch (`far == near`), so that it renders nothing.
    """
    safe = torch.where(directions.abs() < 1e-9, torch.full_like(directions, 1e-9), directions)
    first = (box_min - origins) / safe
    second = (box_max - origins) / safe
    enter = torch.minimum(first, second).amax(dim=-1).clamp(near, far)
    leave = torch.maximum(first, second).amin(dim=-1).clamp(near, far)
    return Rays(origins, directions, enter, torch.maximum(enter, leave))

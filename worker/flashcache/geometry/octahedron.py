"""Directions as places in a square, by way of the octahedron: nearly even, and without trigonometry.

Row and column run along y and x; +z is the middle of the square, -z its corners. Source: Cigolle et al.,
"A Survey of Efficient Representations for Independent Unit Vectors" (2014).
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.geometry.directions import normalize

SUBDIVISIONS = 8
"""Parts of a cell's side from which its solid angle is found."""


def octahedral_directions(side: int) -> Float[Tensor, "cells 3"]:
    """Return the unit direction of the centre of each cell of a square with `side` cells per side."""
    at = (2.0 * (torch.arange(side, dtype=torch.float64) + 0.5) / side) - 1.0
    y, x = torch.meshgrid(at, at, indexing="ij")
    return _direction(x, y).reshape(-1, 3).float()


def octahedral_solid_angles(side: int) -> Float[Tensor, " cells"]:
    """Return the solid angle of each cell, in sr; the whole square has 4 pi up to rounding."""
    fine = side * SUBDIVISIONS
    at = 2.0 * (torch.arange(fine, dtype=torch.float64) + 0.5) / fine - 1.0
    y, x = torch.meshgrid(at, at, indexing="ij")
    folded_x, folded_y, z = _folded(x, y)
    # A face's solid angle over its area in the square: 1 / |p|^3 for the point p of the octahedron.
    length = (folded_x.square() + folded_y.square() + z.square()).sqrt()
    parts = length.pow(-3) * (2.0 / fine) ** 2
    cells = parts.reshape(side, SUBDIVISIONS, side, SUBDIVISIONS).sum(dim=(1, 3))
    return cells.reshape(-1).float()


def look_up_octahedral(
    pictures: Float[Tensor, "pictures cells 3"],
    directions: Float[Tensor, "rays 3"],
    which: Int[Tensor, " rays"],
) -> Float[Tensor, "rays 3"]:
    """Return the values of `pictures[which]` in unit `directions`, bilinear between the cells' centres.

    The square's border is not crossed: outside of its outermost centres they count alone.
    """
    side = round(pictures.shape[1] ** 0.5)
    x, y, z = (directions / directions.abs().sum(dim=-1, keepdim=True)).unbind(dim=-1)
    # Folding is its own inverse.
    u, v, _ = _folded(x, y, below=z < 0.0)
    column, row = (((part + 1.0) * 0.5 * side - 0.5).clamp(0.0, side - 1.0) for part in (u, v))
    left, top = (part.long().clamp_max(side - 2) for part in (column, row))
    across, down = ((part - whole)[:, None] for part, whole in ((column, left), (row, top)))
    first = top * side + left
    values = [pictures[which, first + step] for step in (0, 1, side, side + 1)]
    upper, lower = (values[k] + across * (values[k + 1] - values[k]) for k in (0, 2))
    return upper + down * (lower - upper)


def _direction(x: Tensor, y: Tensor) -> Tensor:
    return normalize(torch.stack(_folded(x, y), dim=-1))


def _folded(x: Tensor, y: Tensor, below: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """Return the place with what is `below` the equator folded over the square's diagonals, and its height.

    By default, what lies outside of the diamond |x| + |y| = 1.
    """
    z = 1.0 - x.abs() - y.abs()
    below = z < 0.0 if below is None else below
    sign_x, sign_y = (torch.where(part >= 0.0, 1.0, -1.0).to(part) for part in (x, y))
    folded_x = torch.where(below, (1.0 - y.abs()) * sign_x, x)
    folded_y = torch.where(below, (1.0 - x.abs()) * sign_y, y)
    return folded_x, folded_y, z

"""Costs of reflectances at surface elements: every GGX width, dielectric or metal, with its best albedo.

An observation is (1 - m) rho E + F0 A + B: irradiance over pi E, and the specular integral split by Schlick's
formula into A, which F0 = 0.04 (1 - m) + m rho multiplies, and B. Source: supplement Eqs. 3-5.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.fields.packing import arrays_of
from flashcache.geometry.octahedron import octahedral_directions, octahedral_solid_angles
from flashcache.kernels.cpu import over_rows
from flashcache.physical.brdf import DIELECTRIC_F0
from flashcache.polish import compiled_fit
from flashcache.polish.elements import Elements
from flashcache.polish.incoming import IncomingTables

ALPHAS = (0.02, 0.045, 0.09, 0.16, 0.28, 0.5, 0.85)
DIRECTIONS = (6, 8, 12, 16, 20, 24, 24)
"""Half vectors per observation and width."""
NOISE_FLOOR = 0.03
OUTLIER = 0.15
LEAST_ALBEDO = 0.01
NOT_TRIED = 1e9
"""Cost of what was not tried."""
BLOCK = 32
INVERSE_GOLDEN_RATIO = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Costs:
    """What each width and hypothesis (0 dielectric, 1 metal) costs each element, with what is best then."""

    cost: Float[Tensor, "elements widths 2"]
    """Mean squared error over the observed radiance, robust."""
    tilt: Int[Tensor, "elements widths 2"]
    albedo: Float[Tensor, "elements widths 2 3"]

    @classmethod
    def none(cls, count: int) -> "Costs":
        """Return the costs of `count` elements before anything is tried."""
        shape = (count, len(ALPHAS), 2)
        return cls(
            torch.full(shape, NOT_TRIED), torch.zeros(shape, dtype=torch.int64), torch.zeros(*shape, 3)
        )

    def copy(self) -> "Costs":
        """Return costs that may be changed without these."""
        return Costs(self.cost.clone(), self.tilt.clone(), self.albedo.clone())


@dataclass(frozen=True, slots=True, eq=False)
class Tilts:
    """Moves of the normal in its tangent plane, and what each costs."""

    moves: Float[Tensor, "tilts 2"]
    cost: Float[Tensor, " tilts"]

    @classmethod
    def grid(cls, steps: tuple[float, ...], weight: float) -> "Tilts":
        """Return all pairs of `steps`, with the cost `weight` times the squared length."""
        at = torch.tensor(steps)
        moves = torch.cartesian_prod(at, at)
        return cls(moves, weight * moves.square().sum(dim=-1))

    @classmethod
    def rings(cls, radii: tuple[float, ...], weight: float) -> "Tilts":
        """Return no move and six on a circle of each radius, every other circle turned by half a step."""
        sixth = torch.arange(6) * (math.pi / 3.0)
        rings = [torch.zeros(1, 2)]
        for number, radius in enumerate(radii):
            angle = sixth + (number % 2) * math.pi / 6.0
            rings.append(radius * torch.stack([angle.cos(), angle.sin()], dim=-1))
        moves = torch.cat(rings)
        return cls(moves, weight * moves.square().sum(dim=-1))


NO_TILT = Tilts(torch.zeros(1, 2), torch.zeros(1))


def half_vectors(count: int) -> Float[Tensor, "count 3"]:
    """Return variates of half vectors: tangent over alpha, and cosine and sine of the azimuth.

    Stratified in the first: D (n.h) puts its squared tangent at alpha^2 u / (1 - u) for uniform u.
    """
    number = torch.arange(count, dtype=torch.float64)
    u = (number + 0.5) / count
    azimuth = 2.0 * math.pi * (number * INVERSE_GOLDEN_RATIO % 1.0)
    return torch.stack([(u / (1.0 - u)).sqrt(), azimuth.cos(), azimuth.sin()], dim=-1).float()


def costs(
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    *,
    normal: Float[Tensor, "elements 3"] | None = None,
    tilts: Tilts = NO_TILT,
    untilted: Costs | None = None,
) -> Costs:
    """Return the costs of `ALPHAS` under the environments `sky`, with the best tilt of `normal` for each.

    The first tilt is none. Where its costs are known, `untilted` saves computing them again.
    """
    every = torch.arange(len(elements))
    best = Costs.none(len(elements)) if untilted is None else untilted.copy()
    _sweep(best, every, elements, tables, sky, normal, tilts, 0 if untilted is None else 1)
    return best


def costs_of_some(
    some: Bool[Tensor, " elements"],
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    normal: Float[Tensor, "elements 3"],
    others: Costs,
) -> Costs:
    """Return the costs of `ALPHAS` with `normal` at `some` of the elements, and `others` at the rest."""
    best = others.copy()
    rows = some.nonzero()[:, 0]
    best.cost[rows] = NOT_TRIED
    _sweep(best, rows, elements, tables, sky, normal, NO_TILT, 0)
    return best


def _sweep(
    best: Costs,
    rows: Int[Tensor, " some"],
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    normal: Float[Tensor, "elements 3"] | None,
    tilts: Tilts,
    first_tilt: int,
) -> None:
    """Write into `best` what costs less than it in the elements `rows`."""
    widths = len(ALPHAS)
    side = math.isqrt(tables.clear.shape[1])
    halves = torch.zeros(widths, max(DIRECTIONS), 3)
    for row, number in enumerate(DIRECTIONS):
        halves[row, :number] = half_vectors(number)
    seen = (
        elements.first,
        elements.omega_o,
        elements.detail,
        elements.colour,
        elements.clipped,
        elements.light,
    )
    directions = octahedral_directions(side), octahedral_solid_angles(side)
    over_rows(
        compiled_fit.sweep,
        len(rows),
        BLOCK,
        first_tilt,
        *arrays_of(rows),
        compiled_fit.Observations(*arrays_of(*seen)),
        compiled_fit.Arriving(*arrays_of(tables.clear, tables.near, sky, *directions)),
        compiled_fit.Lobes(*arrays_of(torch.tensor(ALPHAS), halves, torch.tensor(DIRECTIONS))),
        *arrays_of(elements.normal if normal is None else normal, tilts.moves, tilts.cost),
        compiled_fit.Noise(*map(np.float32, (NOISE_FLOOR, OUTLIER, DIELECTRIC_F0, LEAST_ALBEDO))),
        compiled_fit.Costs(best.cost.numpy(), best.tilt.numpy(), best.albedo.numpy()),
    )

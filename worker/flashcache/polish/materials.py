"""The choice of every element's material from pooled costs, drawn to stage two's where evidence is weak."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.fields.materials import Materials
from flashcache.geometry.directions import normalize
from flashcache.polish.elements import Elements
from flashcache.polish.fit import ALPHAS, Tilts, costs
from flashcache.polish.incoming import IncomingTables
from flashcache.polish.light import Reflectance
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.normals import tilted

TILTS = Tilts.grid((-0.4, -0.2, 0.0, 0.2, 0.4), 0.005)
"""Both hypotheses may turn the normal, or the one that happens to fit wrong normals would win."""
COST_FLOOR = 3e-4
"""Added to costs before their logarithm: the noise of an 8-bit photograph."""
WIDTH_PRIOR = 0.1
"""Cost of a GGX width that is e times stage two's, in the logarithm of cost."""
WIDE_METAL = 0.16
WIDE_METAL_PRIOR = 0.2
"""The same for metals wider than `WIDE_METAL`: they look as dielectrics with a wrong normal do."""
METAL_TOLERANCE, METAL_SOFTNESS = 0.08, 0.03
"""How much worse metals may fit, and over how much they become dielectrics: a metal's picture suffers more
from wrong normals."""
NORMAL_MARGIN, NORMAL_POOL = 0.03, 5
"""How much better another normal than the predicted one must fit, in the logarithm of cost, and over how many
steps along the graph costs are pooled for that."""
SHARE = 0.5
"""Part of the fit in a dielectric's albedo; the rest is stage two's. Errors of both are independent."""
GAMMA = 1.0 / 2.2


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """Materials of all elements, and how sure they are."""

    reflectance: Reflectance
    gain: Float[Tensor, " elements"]
    """By how much the chosen width fits better than stage two's, in the logarithm of cost; pooled."""


def encoded(albedo: Float[Tensor, "elements 3"]) -> Float[Tensor, "elements 3"]:
    """Return albedo as it is compared: equal steps look about equally large."""
    return albedo.clamp(0.005, 1.0).pow(GAMMA)


def choose(
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    normal: Float[Tensor, "elements 3"],
    trained: Materials,
    neighbours: Neighbours,
) -> Choice:
    """Return the best materials under the environments `sky`; `trained` are stage two's at the elements."""
    count, widths = len(elements), torch.tensor(ALPHAS)
    amount = elements.counts.float()
    still = costs(elements, tables, sky, normal=normal)
    turned = costs(elements, tables, sky, normal=normal, tilts=TILTS)

    base = neighbours.among_alike(encoded(trained.albedo), 0.07).pooled(trained.albedo, amount, 4)
    close = neighbours.among_alike(encoded(base), 0.25)
    wide = neighbours.among_alike(encoded(base), 0.35)
    pooled_still = close.pooled((still.cost + COST_FLOOR).log()[:, :, 0], amount, 40)
    both = (turned.cost + COST_FLOOR).log().reshape(count, -1)
    pooled_turned = wide.pooled(both, amount, 40).reshape(count, len(ALPHAS), 2)

    beyond = (widths / WIDE_METAL).log().clamp_min(0.0).square()
    of_metal = pooled_turned[:, :, 1] + WIDE_METAL_PRIOR * beyond
    apart = of_metal.min(dim=1).values - pooled_turned[:, :, 0].min(dim=1).values
    metal = torch.sigmoid((METAL_TOLERANCE - apart) / METAL_SOFTNESS)
    metal = wide.pooled(metal[:, None], amount, 3)[:, 0]

    before = trained.alpha[:, 0].clamp(ALPHAS[0], ALPHAS[-1])
    prior = WIDTH_PRIOR * (widths.log() - before.log()[:, None]).square()
    width_of_dielectric, gain = _lowest(pooled_still + prior, before)
    width_of_metal, _ = _lowest(of_metal, before)
    is_metal = metal > 0.5
    alpha = torch.where(is_metal, width_of_metal, width_of_dielectric)
    alpha = close.pooled(alpha.log()[:, None], amount, 10)[:, 0].exp()

    row = torch.arange(count)
    fitted = still.albedo[row, (pooled_still + prior).argmin(dim=1), 0]
    albedo = (base.clamp_min(0.005).log() * (1.0 - SHARE) + fitted.log() * SHARE).exp()
    albedo = neighbours.among_alike(encoded(albedo), 0.07).pooled(albedo, amount, 4)
    level = of_metal.argmin(dim=1)
    among_metals = Neighbours(wide.index, wide.weight * is_metal[wide.index])
    f0 = among_metals.pooled(turned.albedo[row, level, 1], amount, 4)
    albedo = torch.where(is_metal[:, None], f0, albedo)

    moved = tilted(normal, TILTS.moves[turned.tilt[row, level, 1]])
    sure = amount / (turned.cost[row, level, 1] + 0.002)
    smooth = normalize(neighbours.pooled(moved, sure, 2))
    # A smoothed tilt may fit worse than what it began with: of three normals the best one stays.
    best = torch.where(is_metal, level, (pooled_still + prior).argmin(dim=1))
    candidates = [elements.normal, normal, torch.where(is_metal[:, None], smooth, normal)]
    fits = []
    for candidate, price in zip(candidates, (0.0, NORMAL_MARGIN, NORMAL_MARGIN), strict=True):
        of_it = costs(elements, tables, sky, normal=candidate).cost[row, best, is_metal.long()]
        fits.append(neighbours.pooled((of_it + COST_FLOOR).log()[:, None], amount, NORMAL_POOL)[:, 0] + price)
    which = torch.stack(fits).argmin(dim=0)
    found = torch.stack(candidates)[which, row]
    return Choice(Reflectance(albedo, alpha, metal, found), gain)


def _lowest(
    cost: Float[Tensor, "elements widths"], before: Float[Tensor, " elements"]
) -> tuple[Float[Tensor, " elements"], Float[Tensor, " elements"]]:
    """Return the width of least cost, by a parabola through the three around it, and what it gains."""
    logs = torch.tensor(ALPHAS).log()
    row, best = torch.arange(len(cost)), cost.argmin(dim=1)
    middle = best.clamp(1, len(ALPHAS) - 2)
    x0, x1, x2 = logs[middle - 1], logs[middle], logs[middle + 1]
    y0, y1, y2 = cost[row, middle - 1], cost[row, middle], cost[row, middle + 1]
    first, second = (y1 - y0) / (x1 - x0), (y2 - y1) / (x2 - x1)
    bend = (second - first) / (x2 - x0)
    lowest = 0.5 * (x0 + x1) - 0.5 * first / bend.clamp_min(1e-9)
    inside = torch.minimum(
        torch.maximum(lowest, logs[(best - 1).clamp_min(0)]), logs[(best + 1).clamp_max(6)]
    )
    width = torch.where(bend > 1e-9, inside, logs[best]).exp()
    near = (logs - before.log()[:, None]).abs().argmin(dim=1)
    return width, cost[row, near] - cost[row, best]

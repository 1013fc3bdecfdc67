"""The choice of every element's material from pooled costs, drawn to stage two's where evidence is weak."""

from functools import partial

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.fields.materials import Materials
from flashcache.geometry.directions import normalize
from flashcache.polish.elements import Elements
from flashcache.polish.fit import ALPHAS, Costs, Tilts, costs, costs_of_some
from flashcache.polish.incoming import IncomingTables
from flashcache.polish.light import Reflectance
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.normals import tilted

TILTS = Tilts.rings((0.18, 0.4), 0.005)
"""Both hypotheses may turn the normal, or the one that happens to fit wrong normals would win."""
COST_FLOOR = 3e-4
"""Added to costs before their logarithm: the noise of an 8-bit photograph."""
WIDTH_PRIOR = 0.3
"""Cost of a GGX width that is e times stage two's, in the logarithm of cost."""
WIDE_METAL = 0.16
WIDE_METAL_PRIOR = 0.2
"""The same for metals wider than `WIDE_METAL`: they look as dielectrics with a wrong normal do."""
METAL_TOLERANCE, METAL_SOFTNESS = 0.42, 0.04
"""How much worse metals may fit, in the logarithm of cost, and over how much they become dielectrics: a
metal's picture suffers more from wrong normals."""
DIELECTRIC, SUSPECT = 0.05, 0.4
"""Metalness of stage two up to which nothing is granted, and from which all of the tolerance is."""
NORMAL_MARGIN, NORMAL_POOL = 0.03, 5
"""How much better another normal than the predicted one must fit, in the logarithm of cost, and over how many
steps along the graph costs are pooled for that."""
SMOOTHED = (2, 8)
"""Steps along the graph over which turned normals are smoothed."""
SHARE = 0.5
"""Part of the fit in a dielectric's albedo; the rest is stage two's. Errors of both are independent."""
GRAIN, GRAIN_STEPS = 0.07, 4
"""Difference of encoded albedo that is grain rather than paint, and over how many steps it is smoothed."""
GAMMA = 1.0 / 2.2


def encoded(albedo: Float[Tensor, "elements 3"]) -> Float[Tensor, "elements 3"]:
    """Return albedo as it is compared: equal steps look about equally large."""
    return albedo.clamp(0.005, 1.0).pow(GAMMA)


def smoothed_albedo(
    elements: Elements, trained: Materials, neighbours: Neighbours
) -> Float[Tensor, "elements 3"]:
    """Return stage two's albedo without its grain: means over neighbours of similar albedo."""
    alike = neighbours.among_alike(encoded(trained.albedo), GRAIN)
    return alike.pooled(trained.albedo, elements.counts.float(), GRAIN_STEPS)


def choose(
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    normals: list[Float[Tensor, "elements 3"]],
    trained: Materials,
    neighbours: Neighbours,
) -> Reflectance:
    """Return the best materials under the environments `sky`; `trained` are stage two's at the elements.

    `normals` are candidates; the first one is turned, and the predicted one is always among them.
    """
    cost_of = partial(costs, elements, tables, sky)
    amount, row = elements.counts.float(), torch.arange(len(elements))
    of_plane = cost_of(normal=normals[0])
    turned = cost_of(normal=normals[0], tilts=TILTS, untilted=of_plane)
    base = smoothed_albedo(elements, trained, neighbours)
    close, wide = (neighbours.among_alike(encoded(base), width) for width in (0.25, 0.35))

    # What is metal, by the costs of both hypotheses pooled over surfaces of one colour.
    metal, level = _metals(turned, trained.metalness, wide, amount)
    is_metal = metal > 0.5
    which = is_metal.long()

    # The normal: metals' turns of the first candidate are smoothed. A smoothed turn may fit worse than what
    # it began with: the normal that fits best around stays.
    smooth = [
        torch.where(is_metal[:, None], each, normals[0])
        for each in _smoothed_turns(normals[0], turned, level, neighbours, amount)
    ]
    candidates = [elements.normal, *normals, *smooth]
    still = [
        cost_of(normal=elements.normal),
        of_plane,
        *(cost_of(normal=other) for other in normals[1:]),
        *(costs_of_some(is_metal, elements, tables, sky, each, of_plane) for each in smooth),
    ]
    best = _best_normals(still, which, neighbours, amount)
    normal = torch.stack(candidates)[best, row]
    cost, albedo_of = (
        torch.stack([getattr(each, name) for each in still])[best, row] for name in ("cost", "albedo")
    )

    # The width that fits with the normal that stays: where that is wrong, a wide lobe errs least.
    before = trained.alpha[:, 0].clamp(ALPHAS[0], ALPHAS[-1])
    prior = WIDTH_PRIOR * (torch.tensor(ALPHAS).log() - before.log()[:, None]).square()
    pooled_still = close.pooled((cost[row, :, which] + COST_FLOOR).log(), amount, 40)
    alpha = _lowest(pooled_still + prior * (~is_metal)[:, None])
    alpha = close.pooled(alpha.log()[:, None], amount, 10)[:, 0].exp()

    # Albedo: of dielectrics between stage two's and the fitted one, of metals what they reflect.
    fitted = albedo_of[row, (pooled_still + prior).argmin(dim=1), 0]
    albedo = _mean(base, fitted)
    albedo = neighbours.among_alike(encoded(albedo), GRAIN).pooled(albedo, amount, GRAIN_STEPS)
    among_metals = Neighbours(wide.index, wide.weight * is_metal[wide.index])
    f0 = among_metals.pooled(turned.albedo[row, level, 1], amount, 4)
    return Reflectance(torch.where(is_metal[:, None], f0, albedo), alpha, metal, normal)


def _metals(
    turned: Costs, believed: Float[Tensor, "elements 1"], wide: Neighbours, amount: Float[Tensor, " elements"]
) -> tuple[Float[Tensor, " elements"], Int[Tensor, " elements"]]:
    """Return metalness, and the number of the width that fits best as a metal."""
    count = len(amount)
    pooled = wide.pooled((turned.cost + COST_FLOOR).log().reshape(count, -1), amount, 40)
    pooled = pooled.reshape(count, len(ALPHAS), 2)
    beyond = (torch.tensor(ALPHAS) / WIDE_METAL).log().clamp_min(0.0).square()
    of_metal = pooled[:, :, 1] + WIDE_METAL_PRIOR * beyond
    apart = of_metal.min(dim=1).values - pooled[:, :, 0].min(dim=1).values
    around = wide.pooled(believed, amount, 10)[:, 0]
    metal = wide.pooled(metalness(apart, around)[:, None], amount, 3)[:, 0]
    return metal, of_metal.argmin(dim=1)


def _smoothed_turns(
    normal: Float[Tensor, "elements 3"],
    turned: Costs,
    level: Int[Tensor, " elements"],
    neighbours: Neighbours,
    amount: Float[Tensor, " elements"],
) -> list[Float[Tensor, "elements 3"]]:
    """Return normals with the turns that fit metals of the width `level` best, smoothed a little and more."""
    row = torch.arange(len(normal))
    moved = tilted(normal, TILTS.moves[turned.tilt[row, level, 1]])
    sure = amount / (turned.cost[row, level, 1] + 0.002)
    return [normalize(neighbours.pooled(moved, sure, times)) for times in SMOOTHED]


def _best_normals(
    still: list[Costs],
    which: Int[Tensor, " elements"],
    neighbours: Neighbours,
    amount: Float[Tensor, " elements"],
) -> Int[Tensor, " elements"]:
    """Return the number of the candidate normal that fits best around, given the costs with each of them.

    `which` is the hypothesis of each element. The first candidate, the predicted one, has a margin.
    """
    row = torch.arange(len(which))
    fits = torch.stack(
        [
            neighbours.pooled((each.cost[row, :, which] + COST_FLOOR).log(), amount, NORMAL_POOL)
            .min(dim=1)
            .values
            for each in still
        ]
    )
    fits[1:] += NORMAL_MARGIN
    return fits.argmin(dim=0)


def metalness(
    apart: Float[Tensor, " elements"], believed: Float[Tensor, " elements"]
) -> Float[Tensor, " elements"]:
    """Return metalness 0..1 where metals fit worse by `apart`, in the logarithm of cost.

    Where stage two's metalness `believed` says so, they may fit worse and still be metals.
    """
    suspected = ((believed - DIELECTRIC) / (SUSPECT - DIELECTRIC)).clamp(0.0, 1.0)
    return torch.sigmoid((METAL_TOLERANCE * suspected - apart) / METAL_SOFTNESS)


def _mean(one: Tensor, other: Tensor) -> Tensor:
    """Return the geometric mean with `SHARE` of `other`."""
    return torch.lerp(one.clamp_min(0.005).log(), other.clamp_min(0.005).log(), SHARE).exp()


def _lowest(cost: Float[Tensor, "elements widths"]) -> Float[Tensor, " elements"]:
    """Return the width of least cost, by a parabola through the three around it."""
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
    return torch.where(bend > 1e-9, inside, logs[best]).exp()

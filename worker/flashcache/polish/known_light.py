"""The test whether photographs contradict an environment that was given as known.

Observations are compared with what they would be under the given light, and under one that was fitted to them
freely; with both, materials are the same kind of fit. What the second leaves unexplained is the noise level:
errors of photographs, shape, materials and caches together. The given light is contradicted where it adds
more to the errors than all of these, and in more places than chance explains.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.evaluation.ambiguity import Priors
from flashcache.polish.elements import Elements
from flashcache.polish.fit import NOISE_FLOOR
from flashcache.polish.incoming import IncomingTables
from flashcache.polish.light import Prediction, Reflectance
from flashcache.polish.neighbours import Neighbours

STEP = 1.0 / 255.0
"""Error of an 8-bit photograph: no fit can claim to be better than this."""
BOUND = 25.0
"""Cost of a place, in noise levels, that counts at most: five standard deviations."""
SURE = 4.75
"""Standard errors above which an excess is not taken for chance: one false alarm in a million."""
CODE = "light.known_contradicted"
LEVEL_STEPS = 20
"""Steps along the graph over which the level of albedo is settled. Fewer, and albedo takes in what is wrong
with a light, piece by piece; without any, an error of all albedo looks like one of the light."""
LEAST_LEVEL, MOST_LEVEL = 0.2, 5.0


@dataclass(frozen=True, slots=True)
class KnownLightVerdict:
    """How well a given light explains photographs, relative to one that was fitted freely."""

    contradicted: bool
    error: float
    """Root mean square error under the given light, in units of that under the free one; 1 is as good."""
    excess: float
    """What the given light adds to the mean squared error, over all other errors."""
    sureness: float
    """The excess in its standard errors."""

    @property
    def findings(self) -> tuple[tuple[str, str], ...]:
        """Return code and message for the user; empty where the light is not contradicted."""
        if not self.contradicted:
            return ()
        return (
            (
                CODE,
                "the photographs contradict the environment that was given as known: they differ from it "
                f"{self.error:.1f} times as much as from the light that fits them best. Look whether the map "
                "belongs to these photographs, is turned as the scene is (z up, +x in the middle of the map, "
                "counter-clockwise to the left) and whether the light stood still (--light-fixed-to); or "
                "train without --known-light",
            ),
        )


def judge_known_light(
    observed: Float[Tensor, "observations 3"],
    known: Float[Tensor, "observations 3"],
    free: Float[Tensor, "observations 3"],
    place: Int[Tensor, " observations"],
    *,
    clipped: Bool[Tensor, "observations 3"] | None = None,
    num_fitted: int = 0,
    independent: float = Priors().independent_points,
) -> KnownLightVerdict:
    """Return whether `observed` radiance contradicts the predictions `known` under the given light.

    `free` are the predictions under a light of `num_fitted` numbers that was fitted to the same observations:
    the more numbers, the more of the noise it explains, which is allowed for. `place` numbers the piece of
    surface of each observation; errors of one place, and of neighbours, are alike, so that at most
    `independent` places count as independent. Predictions above the scale of a photograph agree with channels
    that are `clipped`. Without observations nothing is contradicted.
    """
    if not len(observed):
        return KnownLightVerdict(contradicted=False, error=1.0, excess=0.0, sureness=0.0)
    weight = 1.0 / (observed + NOISE_FLOOR)
    left = observed.numel() / max(observed.numel() - num_fitted, 1)
    step = _of_places(STEP**2 * weight, place)
    noise = (_of_places(_squares(observed, free, clipped) * weight, place) * left).maximum(step)
    cost = _of_places(_squares(observed, known, clipped) * weight, place).maximum(step)
    # The bound is on both sides, or outliers that no light explains would speak for the given one.
    most = BOUND * noise.median()
    noise, cost = noise.clamp_max(most), cost.clamp_max(most)
    added = cost - noise
    level, mean = float(noise.mean()), float(added.mean())
    counted = min(float(len(added)), independent)
    spread = float(added.std(unbiased=False)) / counted**0.5
    sureness = mean / spread if spread > 0.0 else (float("inf") if mean > 0.0 else 0.0)
    return KnownLightVerdict(
        contradicted=mean > level and sureness > SURE,
        error=max(1.0 + mean / level, 0.0) ** 0.5,
        excess=mean / level,
        sureness=sureness,
    )


def judge_by_elements(
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    reflectance: Reflectance,
    neighbours: Neighbours,
    *,
    known: Sequence[int],
    refit: Callable[[Prediction], Float[Tensor, "lights cells 3"]],
) -> KnownLightVerdict:
    """Return whether observations of `elements` contradict the lights `known`, which `sky` holds.

    `reflectance` was fitted under `sky`. The level of its albedo is settled once more, over large
    neighbourhoods, before `refit` returns the environments that explain a prediction best. Dull dielectrics
    contradict hardly any light, for another albedo explains as much; what is glossy does.
    """
    fine = round(sky.shape[1] ** 0.5)
    given = sky.numpy()
    dark = replace(reflectance, albedo=torch.zeros_like(reflectance.albedo))
    whole, rest = (
        torch.from_numpy(Prediction(elements, tables, each, fine)(given)).double()
        for each in (reflectance, dark)
    )
    by_albedo, observed = whole - rest, elements.colour.double()
    weight = (~elements.clipped).double() / (observed + NOISE_FLOOR)
    sums = torch.cat([weight * by_albedo * (observed - rest), weight * by_albedo.square()], dim=1)
    sums = sums.new_zeros(len(elements), 6).index_add_(0, elements.element, sums)
    sums = neighbours.pooled(sums, sums.new_ones(len(elements)), LEVEL_STEPS)
    level = (sums[:, :3] / sums[:, 3:].clamp_min(1e-12)).clamp(LEAST_LEVEL, MOST_LEVEL).float()
    settled = replace(reflectance, albedo=reflectance.albedo * level)
    prediction = Prediction(elements, tables, settled, fine)
    under_known, under_free = (
        torch.from_numpy(prediction(each)).float() for each in (given, refit(prediction).numpy())
    )
    of_known = torch.isin(elements.light, torch.tensor(list(known)))
    return judge_known_light(
        elements.colour[of_known],
        under_known[of_known],
        under_free[of_known],
        elements.element[of_known],
        clipped=elements.clipped[of_known],
        num_fitted=len(known) * sky[0].numel(),
    )


def _squares(
    observed: Float[Tensor, "observations 3"],
    predicted: Float[Tensor, "observations 3"],
    clipped: Bool[Tensor, "observations 3"] | None,
) -> Float[Tensor, "observations 3"]:
    error = predicted - observed
    if clipped is not None:
        error = torch.where(clipped, error.clamp_max(0.0), error)
    return error.square()


def _of_places(
    values: Float[Tensor, "observations 3"], place: Int[Tensor, " observations"]
) -> Float[Tensor, " places"]:
    """Return the mean over the observations of each place that has any, in double precision."""
    _, index, counts = place.unique(return_inverse=True, return_counts=True)
    total = values.new_zeros(len(counts), dtype=torch.float64)
    return total.index_add_(0, index, values.double().mean(dim=-1)) / counts

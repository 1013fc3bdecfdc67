"""Sampling budget of a refined picture: a fixed number of directions, or a target standard error.

A mean of errors is lowest, for a number of directions in all, where every pixel has as many as the 2/3 power
of what its error would be after one. So a first round measures all pixels alike, and the next ones give each
what it lacks. The numbers come from means over neighbours, so that they hardly depend on a pixel's own noise.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
from lambent_core.pictures import RenderSettings
from numpy.typing import NDArray

from lambent_relight.refined.known_light import KnownLight
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.running import Running
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Scene, outgoing_radiance, split_samples

MAX_FACTOR = 64
"""A pixel that is still noisier than requested gets no more than this many times the first round's
directions."""
GROWTH = 3
"""Largest ratio of a round to all before it, which say how much is needed, and a short one says little."""
AIM = 0.98
"""Share of the target that rounds are planned for, so that chance seldom asks for another."""
_STEPS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48])
"""Lengths of a round, in first rounds: pixels that need about as much are sampled together."""
_NEXT_ROUND = 1_000_003


def estimated(
    points: SurfacePoints,
    pixels: PixelRays,
    scene: Scene,
    settings: RenderSettings,
    progress: Callable[[float], None] | None,
    known: KnownLight | None = None,
) -> Running:
    """Return the radiance of `points`, the rays of `pixels`, after one round, or as many as the target needs.

    The rays of a pixel share its directions, two each at least.
    """
    per_ray = max(2, -(-settings.spp // settings.antialias**2))
    known = KnownLight.nothing(len(points.position)) if known is None else known
    total, number, shares, most = Running.of(pixels), 0, None, 0
    costs = costs_of(per_ray, pixels.most)
    every = np.full(len(pixels.first), per_ray)
    wanted, done, left = every, 0.0, float(every.sum())
    while True:
        for length in _lengths(wanted):
            chosen, there, rays = pixels.chosen(wanted == length)
            work = float(length * len(chosen))

            def advance(part: float, done: float = done, work: float = work, left: float = left) -> None:
                if progress is not None:
                    progress(min(1.0, (done + part * work) / max(done + left, 1e-9)))

            radiance = outgoing_radiance(
                points[there],
                scene,
                num_samples=int(length),
                seed=settings.seed + _NEXT_ROUND * number,
                pixels=rays,
                known=known[there],
                shares=None if shares is None else shares[:, chosen],
                progress=advance,
            )
            total.add(radiance, chosen, there)
            shares = radiance.shares if shares is None else shares
            number, done, left = number + 1, done + work, left - work
        target = settings.until_stderr
        if not target or not len(every) or total.relative_error() <= target:
            return total
        # Of the first round, which is whole passes too.
        most = most or MAX_FACTOR * int(total.num_samples.max())
        mean = float(pixels.mean(total.direct + total.indirect).mean())
        needed = numbers_for(total.spread(), total.num_samples, AIM * target * mean, most)
        left = float((needed - total.num_samples).sum())
        room = np.searchsorted(costs, most - total.num_samples, side="right")
        lacking, spent = needed - total.num_samples, total.num_samples
        wanted = per_ray * steps_for(lacking / per_ray, spent / per_ray, room)
        if not wanted.any():
            return total


def numbers_for(
    spread: NDArray[np.float64], spent: NDArray[np.int64], error: float, most: int
) -> NDArray[np.float64]:
    """Return how many directions every pixel should have, [pixel], from `spent` to `most`.

    They are the fewest that make the mean of spread / sqrt(number) as low as `error`, or all.
    """
    share = np.maximum(spread, 1e-12 * max(float(spread.max(initial=0.0)), 1e-30)) ** (2.0 / 3.0)
    high = float(most / share.min())
    low = 1e-18 * high
    for _ in range(60):
        middle = (low * high) ** 0.5
        number = np.clip(middle * share, spent, most)
        enough = float((spread / np.sqrt(number)).mean()) <= error
        low, high = (low, middle) if enough else (middle, high)
    return np.clip(high * share, spent, most)


def steps_for(
    lacking: NDArray[np.float64], spent: NDArray[np.float64], room: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Return the length of the next round of every pixel in first rounds, [pixel]; 0: none.

    `room` says how many of `_STEPS`, from the shortest, keep a pixel within its limit.
    """
    wanted = np.minimum(lacking, GROWTH * spent)
    nearest = np.argmin(np.abs(np.log(np.maximum(wanted, 1e-9))[:, None] - np.log(_STEPS)), axis=1)
    longest = _STEPS[np.maximum(np.minimum(nearest, room - 1), 0)]
    steps = np.where((wanted >= 0.5) & (room > 0), longest, 0)
    if steps.any() or not (room > 0).any():
        return steps
    # All of them nearly there: those that lack most.
    return np.where((room > 0) & (lacking >= np.quantile(lacking[room > 0], 0.75)), 1, 0)


def costs_of(per_ray: int, most_rays: int) -> NDArray[np.int64]:
    """Return the directions of a ray that rounds of `_STEPS` take at most, [step]: passes are whole."""
    counts = [
        max(math.prod(split_samples(step * per_ray, rays)) for rays in range(1, most_rays + 1))
        for step in _STEPS.tolist()
    ]
    return np.maximum.accumulate(np.array(counts, np.int64))


def _lengths(wanted: NDArray[np.integer]) -> Iterator[int]:
    """Yield the different lengths of a round, the longest first."""
    yield from (int(length) for length in np.unique(wanted)[::-1] if length > 0)

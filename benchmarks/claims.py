"""Claims that one way is faster than another, and the comparison of two sets of them."""

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict

WORST = 1.15
"""Factor by which a ratio may fall below that of an earlier run."""


class Times(TypedDict):
    """Repeated measurements of one thing."""

    median: float
    low: float
    high: float
    count: int


class Claim(TypedDict):
    """One way is `ratio` times as fast as the reference, both measured in turns in one run."""

    name: str
    unit: str
    ours: Times
    reference: Times
    ratio: float
    """Median of the reference by median of ours: more is better."""


def times(values: Sequence[float]) -> Times:
    """Return median and range of measurements."""
    return Times(median=statistics.median(values), low=min(values), high=max(values), count=len(values))


def claim(name: str, unit: str, ours: Sequence[float], reference: Sequence[float]) -> Claim:
    """Return what two series of measurements, smaller is better, say about one another."""
    own, other = times(ours), times(reference)
    return Claim(name=name, unit=unit, ours=own, reference=other, ratio=other["median"] / own["median"])


def in_turns(
    ways: Mapping[str, Callable[[], Any]], turns: int, clock: Callable[[], float] = time.perf_counter
) -> dict[str, list[float]]:
    """Return the seconds of every way in every turn; each runs once before, and the turns alternate."""
    for way in ways.values():
        way()
    timings: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(turns):
        for name, way in ways.items():
            began = clock()
            way()
            timings[name].append(clock() - began)
    return timings


def table(claims: Sequence[Claim]) -> str:
    """Return the claims as a table."""
    lines = ["| claim | ours | reference | ratio |", "| --- | --- | --- | --- |"]
    for one in claims:
        sides = (
            f"{side['median']:.3g} {one['unit']} ({side['low']:.3g} to {side['high']:.3g})"
            for side in (one["ours"], one["reference"])
        )
        lines.append(f"| {one['name']} | {' | '.join(sides)} | {one['ratio']:.2f} |")
    return "\n".join(lines)


def worse(old: Sequence[Claim], new: Sequence[Claim]) -> list[str]:
    """Return a sentence for every claim that became worse by more than `WORST`, or is gone."""
    timings, before = {one["name"]: one for one in new}, []
    for one in old:
        now = timings.get(one["name"])
        if now is None:
            before.append(f"{one['name']}: no longer measured")
        elif not math.isfinite(now["ratio"]) or now["ratio"] * WORST < one["ratio"]:
            before.append(f"{one['name']}: ratio {now['ratio']:.2f}, before {one['ratio']:.2f}")
    return before

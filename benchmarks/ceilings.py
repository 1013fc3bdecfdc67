"""Measure what one core of this machine can do at most: products, memory, gathers, calls.

    python -m benchmarks ceilings [--turns 7]

These are the limits with which the times of kernels and steps are compared: matrix products in large and in
our shapes [GFLOP/s], reading and writing memory beyond all caches [GB/s], gathers of 8-byte rows from tables
of several sizes [ns each, by compiled code], and calls of an operation on a few numbers, with and without
gradient [us each]. Median and range over `--turns`.
"""

import argparse
from collections.abc import Callable

import numba
import numpy as np
import torch

from benchmarks.claims import Times, in_turns, times

QUICK = "--turns 2 --scale 0.02"
CLAIMS = ""

WIDTH = 64
"""Width of the networks of preset `fast`."""


@numba.njit(cache=True, fastmath=True)
def gather(table: np.ndarray, index: np.ndarray) -> float:
    """Return the sum of the rows at `index` of a [rows, 2] table."""
    total = np.float32(0.0)
    for row in index:
        total += table[row, 0] + table[row, 1]
    return total


def ways(scale: float) -> dict[str, tuple[Callable[[], object], float, str]]:
    """Return what is measured by name, the amount of it in one call, and the unit of its rate."""
    rng = np.random.default_rng(0)
    ceilings: dict[str, tuple[Callable[[], object], float, str]] = {}

    def product(rows: int, inner: int, columns: int, calls: int) -> tuple[Callable[[], object], float, str]:
        one, other = torch.randn(rows, inner), torch.randn(inner, columns)
        amount = 2e-9 * rows * inner * columns * calls
        return (lambda: [one @ other for _ in range(calls)]), amount, "GFLOP/s"

    calls = max(1, round(20 * scale))
    ceilings["product, 1024 x 1024 x 1024"] = product(1024, 1024, 1024, max(1, round(4 * scale)))
    ceilings[f"product, 8192 x {WIDTH} x {WIDTH}"] = product(8192, WIDTH, WIDTH, 5 * calls)
    ceilings[f"product, 512 x {WIDTH} x {WIDTH}"] = product(512, WIDTH, WIDTH, 50 * calls)
    large = torch.zeros(max(1, round(5e7 * scale)))
    ceilings["memory, read and written"] = (lambda: large.add_(1.0)), 8e-9 * large.numel(), "GB/s"
    index = rng.integers(0, 1 << 30, max(1, round(2_000_000 * scale)))
    for name, rows in (("32 KB", 1 << 12), ("1 MB", 1 << 17), ("64 MB", 1 << 23)):
        rows_of, places = rng.random((rows, 2), dtype=np.float32), (index % rows).astype(np.int64)
        run = lambda table=rows_of, at=places: gather(table, at)  # noqa: E731
        ceilings[f"gather from {name}"] = run, 1e-9 * len(index), "rows per ns"
    few = torch.zeros(8)
    learned = torch.zeros(8, requires_grad=True)
    ceilings["call without gradient"] = (
        (lambda: [few + few for _ in range(500 * calls)]),
        5e-4 * calls,
        "per us",
    )

    def with_gradient() -> None:
        value = learned
        for _ in range(50 * calls):
            value = value + few
        value.sum().backward()

    ceilings["call with gradient, forward and backward"] = with_gradient, 5e-5 * calls, "per us"
    return ceilings


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--scale", type=float, default=1.0, help="share of the work of each turn")


def main(arguments: argparse.Namespace) -> dict[str, Times]:
    """Print and return rates by name."""
    torch.set_num_threads(1)
    measured = ways(arguments.scale)
    seconds = in_turns({name: way for name, (way, _, _) in measured.items()}, arguments.turns)
    rates = {}
    print("| one core | rate | range |\n| --- | --- | --- |")
    for name, (_, amount, unit) in measured.items():
        rate = times([amount / second for second in seconds[name]])
        rates[f"{name} [{unit}]"] = rate
        print(f"| {name} | {rate['median']:.3g} {unit} | {rate['low']:.3g} to {rate['high']:.3g} |")
    return rates

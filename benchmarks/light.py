"""Time the preparation of an environment: reading, harmonics, prefiltered levels, look-ups, dominant lights.

    OMP_NUM_THREADS=1 python -m benchmarks light

Figures are milliseconds of processor time in this thread, the least of the repeats, so that a busy neighbour
matters little. Maps hold random values; look-ups go in random directions with random roughness.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lambent_core.directions import normalise
from lambent_relight.baked.split_sum import split_sum, table
from lambent_relight.environment.dominant_lights import split
from lambent_relight.environment.harmonics import project, rotate_z
from lambent_relight.environment.maps import environment_from_array, load_environment, write_environment
from lambent_relight.environment.prefilter import prefilter
from lambent_relight.environment.sun_clamp import clamp_sun

QUICK = "--heights 128 --repeats 2"

COVERED_PIXELS = 104_858
"""40 % of 512 x 512."""


def least_ms(work: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of `work`, after one call that does not count."""
    work()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return 1000.0 * min(times)


def rows(heights: list[int], folder: Path) -> list[tuple[str, str, Callable[[], object]]]:
    """Return (step, size, work) of everything that is timed."""
    rng = np.random.default_rng(0)
    found: list[tuple[str, str, Callable[[], object]]] = []
    for height in heights:
        environment = environment_from_array(rng.gamma(0.5, 1.0, (height, 2 * height, 3)))
        path = folder / f"{height}.exr"
        write_environment(path, environment.radiance)
        size = f"{2 * height} x {height}"
        found += [
            ("read EXR", size, lambda path=path: load_environment(path)),
            ("project to 7 bands (49 coefficients)", size, lambda e=environment: project(e, 7)),
            ("prefilter, 9 levels", size, lambda e=environment: prefilter(e)),
            ("4 dominant lights and residual", size, lambda e=environment: split(e, 4)),
            ("sun clamp with report", size, lambda e=environment: clamp_sun(e, 5.0)),
        ]
    coefficients = rng.normal(size=(49, 3))
    levels = prefilter(environment_from_array(rng.random((256, 512, 3))))
    directions = normalise(rng.normal(size=(COVERED_PIXELS, 3))).astype(np.float32)
    roughness, cosine = rng.random((2, COVERED_PIXELS)).astype(np.float32)
    pixels = f"{COVERED_PIXELS} pixels"
    return [
        *found,
        ("turn coefficients about z", "7 bands", lambda: rotate_z(coefficients, 33.0)),
        ("look up prefiltered radiance", pixels, lambda: levels.lookup(directions, roughness)),
        ("split sum", pixels, lambda: split_sum(cosine, roughness)),
        ("make the split-sum table, once", "32 x 32", lambda: (table.cache_clear(), table())),
    ]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--heights", type=int, nargs="+", default=[128, 512, 2048], help="rows of the maps")
    parser.add_argument("--repeats", type=int, default=7)


def main(arguments: argparse.Namespace) -> None:
    """Print a Markdown table."""
    print("| step | size | ms |\n| --- | --- | --- |")
    with tempfile.TemporaryDirectory() as folder:
        for step, size, work in rows(arguments.heights, Path(folder)):
            print(f"| {step} | {size} | {least_ms(work, arguments.repeats):.2f} |", flush=True)

"""Time the desktop viewer's response to another light, another camera and other display settings.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python -m benchmarks desktop_viewer BUNDLE --env MAP [--size N]

Figures are processor time of this process, the median over the repeats and their range, so that a busy
neighbour matters little; ratios are to a light that is turned.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from lambent.desktop.painter import Painter
from lambent.desktop.state import ViewerState
from lambent.desktop.viewer import DesktopOptions, open_model
from lambent_relight import Renderer, load_bundle
from lambent_relight.environment.maps import load_environment

QUICK = "{bundle} --env {maps}/morning.hdr --size 96 --repeats 1"


def timed_ms(work: Callable[[int], object], repeats: int) -> list[float]:
    """Return the processor time of `work`, called with a number that grows, after one call without count."""
    work(0)
    times = []
    for number in range(1, repeats + 1):
        start = time.process_time()
        work(number)
        times.append(1000.0 * (time.process_time() - start))
    return times


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--env", type=Path, required=True)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=7)


def main(arguments: argparse.Namespace) -> None:
    """Print one line per action."""
    renderer = Renderer(load_bundle(arguments.bundle), num_threads=1)
    size = (arguments.size, arguments.size)
    model = open_model(renderer.bundle, DesktopOptions(environments=(arguments.env,), size=size))
    painter = Painter(renderer, model.lights, [])
    start = model.state

    def turned(number: int) -> ViewerState:
        return replace(start, orbit=start.orbit.turned(7.0 * number + 3.0, 0.0))

    def new_map(number: int) -> None:
        opened = load_environment(arguments.env)
        opened = replace(opened, radiance=opened.radiance * np.float32(1.0 + 0.1 * number))
        model.lights._open[0] = opened
        painter.paint(replace(start, rotate_deg=0.01 * number))

    painter.paint(start)
    coverage = float((painter.picture(start, 0).coverage > 0.0).mean())
    height, width = model.lights.environment(0).radiance.shape[:2]
    print(f"{size[0]} x {size[1]} pixels, {100 * coverage:.0f} % covered; map {width} x {height}")
    rows = (
        ("light turned", lambda n: painter.paint(replace(start, rotate_deg=11.0 * n + 1.0))),
        ("exposure", lambda n: painter.paint(replace(start, exposure_ev=0.1 * n))),
        (
            "tone curve agx, exposure",
            lambda n: painter.paint(replace(start, exposure_ev=0.1 * n, tone_mapping="agx")),
        ),
        ("channel", lambda n: painter.paint(replace(start, channel=("albedo", "normal")[n % 2]))),
        ("material", lambda n: painter.paint(replace(start, roughness_scale=1.0 + 0.02 * n))),
        ("another map", new_map),
        ("camera, rough outline", lambda n: painter.paint(turned(n), full=False)),
        ("camera, full", lambda n: painter.paint(turned(n), full=True)),
    )
    base = 0.0
    for name, work in rows:
        times = timed_ms(work, arguments.repeats)
        median = statistics.median(times)
        base = base or median
        print(
            f"{name:26} {median:8.0f} ms  ({min(times):.0f} to {max(times):.0f})  x {median / base:.2f}",
            flush=True,
        )

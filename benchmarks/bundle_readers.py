"""Measure the size of a bundle's files, and the time per secondary ray of each reader of its fast cache.

    OMP_NUM_THREADS=1 python -m benchmarks bundle_readers BUNDLE [BUNDLE ...] [--rays 4096]

Sizes are those of every BUNDLE, times those of the first. Readers take turns, and the shortest of their turns
counts, so that ratios hold on a busy machine. Both readers use one thread.
"""

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from lambent_relight import Bundle, load_bundle
from lambent_relight.bundle.graphs import OnnxGraph, Rows
from lambent_relight.fused.reader import FusedCaches

from benchmarks.claims import Claim, claim, in_turns

QUICK = "{bundle} --rays 2048 --turns 1"
CLAIMS = "{bundle} --rays 8192 --turns 5"

ALL = {"radiance": 3, "opacity": 1, "distance": 1}
OCCLUSION = {"opacity": 1, "distance": 1}


def print_sizes(bundles: list[Bundle]) -> None:
    """Print megabytes (10^6 bytes) by folder and in all, a column per bundle."""
    columns = []
    for bundle in bundles:
        megabytes: dict[str, float] = defaultdict(float)
        for file in bundle.manifest.files:
            megabytes[file.path.rpartition("/")[0] or "cameras.json"] += file.size_bytes / 1e6
        megabytes["manifest.json"] = bundle.source.size_bytes("manifest.json") / 1e6
        columns.append({**megabytes, "all": sum(megabytes.values())})
    names = [name for name in dict.fromkeys(key for column in columns for key in column) if name != "all"]
    print("| MB | " + " | ".join(bundle.path.name for bundle in bundles) + " |")
    print("| --- |" + " --- |" * len(bundles))
    for name in (*sorted(names), "all"):
        print(f"| {name} | " + " | ".join(f"{column.get(name, 0.0):.2f}" for column in columns) + " |")


def print_rounding(bundle: Bundle) -> None:
    """Print what float16 tables changed, and how far graphs are from their models."""
    print(
        "\n| graph | output | ONNX vs torch | float16: rms | float16: max |\n| --- | --- | --- | --- | --- |"
    )
    for graph in bundle.manifest.graphs:
        for item in graph.rounding:
            values = (graph.parity.max_abs_error, item.rms_error, item.max_abs_error)
            print(f"| {graph.name} | {item.output} | " + " | ".join(f"{v:.1e}" for v in values) + " |")


def random_rays(bundle: Bundle, count: int) -> tuple[Rows, Rows]:
    """Return origins in the bundle's box and unit directions, [ray, 3] each."""
    rng = np.random.default_rng(0)
    low, high = (
        np.array(corner) for corner in (bundle.manifest.bounds.minimum, bundle.manifest.bounds.maximum)
    )
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return rng.uniform(low, high, (count, 3)).astype(np.float32), direction.astype(np.float32)


def graph_of(bundle: Bundle, outputs: dict[str, int]) -> OnnxGraph:
    """Return the fast cache's graph for some outputs, on one thread."""
    return OnnxGraph(
        bundle,
        bundle.graph_path("fast_cache"),
        ("origin", "direction"),
        outputs,
        threads=1,
        rows_per_call=8192,
    )


def processor_times(bundle: Bundle, count: int, turns: int) -> Claim:
    """Print microseconds per ray on one thread, and return our reader's against onnxruntime's."""
    rays = random_rays(bundle, count)
    whole, trimmed = graph_of(bundle, ALL), graph_of(bundle, OCCLUSION)
    fused = FusedCaches(bundle, num_threads=1)
    seconds = in_turns(
        {
            "onnxruntime, the graph as it is": lambda: whole(*rays),
            "onnxruntime, opacity and distance": lambda: trimmed(*rays),
            "fused (numba), opacity and distance": lambda: fused.secondary(*rays),
        },
        turns,
        time.process_time,
    )
    print(
        "\n| on a processor, one thread | us per ray | middle of turns | fused is faster by |\n"
        + "| --- " * 4
        + "|"
    )
    best = min(seconds["fused (numba), opacity and distance"])
    for name, values in seconds.items():
        each, middle = min(values) / count * 1e6, float(np.median(values)) / count * 1e6
        print(f"| {name} | {each:.2f} | {middle:.2f} | {min(values) / best:.1f} |")
    per_ray = {name: [1e6 * value / count for value in values] for name, values in seconds.items()}
    return claim(
        "fast cache of a bundle, opacity and distance",
        "us per ray",
        per_ray["fused (numba), opacity and distance"],
        per_ray["onnxruntime, opacity and distance"],
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundles", type=Path, nargs="+")
    parser.add_argument("--rays", type=int, default=65_536)
    parser.add_argument("--turns", type=int, default=7)


def main(arguments: argparse.Namespace) -> list[Claim]:
    """Measure and print the tables of docs/benchmarks/bundle.md; return what they claim."""
    bundles = [load_bundle(path) for path in arguments.bundles]
    print_sizes(bundles)
    print_rounding(bundles[0])
    return [processor_times(bundles[0], arguments.rays, arguments.turns)]

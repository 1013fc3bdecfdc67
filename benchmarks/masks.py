"""Compare the built-in masks with true ones: captures before known backgrounds, IoU for each picture.

    python -m benchmarks masks SCENE_DIR... [--environment sky.hdr] [--every N] [-o DIR]

Writes into OUT for each capture and background a sheet of thumbnails.
"""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.masks.estimate import EstimateSettings, estimate_masks
from lambent_capture.masks.folder import contact_sheet
from lambent_core.errors import SceneRefusedError

from benchmarks.painted_scene import Background, Painted, overlap, paint, plain, surroundings, table

QUICK = "{sample} --every 4 --only grey"

SAMPLE = Path(__file__).parents[1] / "tests" / "data" / "still_life"


def backgrounds(folder: Path, environment: Path) -> dict[str, Background]:
    """Return the backgrounds of a capture; the table is just below its box."""
    bounds = describe_scene(folder).bounds
    size = max(high - low for low, high in zip(bounds.minimum, bounds.maximum, strict=True))
    far = surroundings(environment)
    return {
        "grey": plain(0.5, 0.5, 0.5),
        "dark": plain(0.02, 0.02, 0.03),
        "green": plain(0.05, 0.4, 0.1),
        "surroundings": far,
        "table": table(bounds.minimum[2], 0.02 * size, far),
    }


def measure(painted: Painted) -> dict[str, object]:
    """Return the overlap of each estimated mask with the true one, or why there is no estimate."""
    began = time.process_time()
    try:
        estimated = estimate_masks(painted.views, EstimateSettings())
    except SceneRefusedError as error:
        return {"refused": error.report.findings[0].message, "seconds": time.process_time() - began}
    seconds = time.process_time() - began
    pairs = zip(estimated.coverages, painted.coverages, strict=True)
    return {
        "iou": [round(overlap(mine, true), 4) for mine, true in pairs],
        "agreement": float(np.median(estimated.consistency.overlap)),
        "explained": float(np.median(estimated.consistency.explained)),
        "separation": float(np.median(estimated.separation)),
        "seconds": seconds,
        "coverages": estimated.coverages,
    }


def row(scene: str, background: str, scores: dict) -> str:
    """Return a line of the table."""
    if "refused" in scores:
        return f"| {scene} | {background} | refused | | | | {scores['seconds']:.0f} |"
    iou = scores["iou"]
    return (
        f"| {scene} | {background} | {statistics.mean(iou):.3f} | {statistics.pstdev(iou):.3f} "
        f"| {min(iou):.3f} | {scores['agreement']:.3f} / {scores['separation']:.3f} "
        f"| {scores['seconds']:.0f} |"
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--environment", type=Path, default=SAMPLE / "envmaps" / "morning.hdr")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--only", default="", help="backgrounds, with commas")


def main(options: argparse.Namespace) -> dict[str, dict]:
    """Measure, print the table, and write what was found."""
    print("| capture | background | mean IoU | spread | worst | agreement / separation | processor s |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    record = {}
    for scene in options.scenes:
        for name, background in backgrounds(scene, options.environment).items():
            if options.only and name not in options.only.split(","):
                continue
            painted = paint(scene, background, options.every)
            scores = measure(painted)
            print(row(scene.name, name, scores), flush=True)
            coverages = scores.pop("coverages", painted.coverages)
            contact_sheet(painted.views, coverages).save(options.out / f"{scene.name}_{name}.jpg", quality=85)
            record[f"{scene.name}/{name}"] = scores
    return record

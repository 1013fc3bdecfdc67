"""Measure how well exposure is estimated: captures whose brightness is changed by known factors.

    python -m benchmarks exposure SCENE_DIR... [--spread 0,0.2,0.5] [--seed 0] [-o DIR]

The photographs of the first light are multiplied by 2^EV in linear light before they are encoded and clipped,
and carry no EXIF; the masks are those of the capture.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
from lambent_capture.checks.examine import examine_capture
from lambent_capture.checks.exposure_estimate import even_out_exposure
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.lights import select_lights
from lambent_capture.problems import Problems
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from lambent_proto.v1 import scene_pb2
from numpy import ndarray
from PIL import Image

QUICK = "{sample} --spread 0.5"


def expose(folder: Path, manifest: scene_pb2.SceneManifest, out: Path, changes: ndarray) -> None:
    """Write the manifest's photographs to `out`, brighter by `changes` [EV]."""
    for frame, change in zip(manifest.frames, changes, strict=True):
        for image in frame.images:
            pixels = np.asarray(Image.open(folder / image.path)) / 255.0
            pixels[..., :3] = srgb_from_linear(
                np.clip(linear_from_srgb(pixels[..., :3]) * 2.0**change, 0.0, 1.0)
            )
            (out / image.path).parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.round(255.0 * pixels).astype(np.uint8)).save(out / image.path)


def measure(folder: Path, spread: float, seed: int) -> dict[str, float]:
    """Return the standard deviation of exposure before and after evening out, and the mismatch, in EV."""
    manifest = describe_scene(folder)
    manifest = select_lights(manifest, tuple(manifest.lights)[:1])
    del manifest.relight_lights[:]
    for frame in manifest.frames:
        kept = [image for image in frame.images if image.light in manifest.lights]
        del frame.images[:]
        frame.images.extend(kept)
    # The reader's name stands for a data set of fixed exposure, which is left alone.
    manifest.layout = "nerf_blender"
    changes = spread * np.random.default_rng(seed).standard_normal(len(manifest.frames))
    out = Path(tempfile.mkdtemp())
    try:
        expose(folder, manifest, out, changes)
        figures = examine_capture(out, manifest, CaptureLimits()).figures
        even_out_exposure(manifest, figures, Problems())
    finally:
        shutil.rmtree(out)
    rest = changes + np.log2([frame.exposure or 1.0 for frame in manifest.frames])
    mismatch = float(np.median([view.mismatch_ev for view in figures.views]))
    return {"before": float(changes.std()), "after": float(rest.std()), "mismatch": mismatch}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--spread", default="0,0.2,0.5", help="standard deviations in EV, with commas")
    parser.add_argument("--seed", type=int, default=0)


def main(options: argparse.Namespace) -> dict[str, dict]:
    """Measure, print the table, and return what was found."""
    print("| capture | exposure before [EV] | after [EV] | median mismatch [EV] |")
    print("| --- | --- | --- | --- |")
    record = {}
    for scene in options.scenes:
        for spread in (float(text) for text in options.spread.split(",")):
            found = measure(scene, spread, options.seed)
            record[f"{scene.name}/{spread:g}"] = found
            columns = " | ".join(f"{found[name]:.3f}" for name in ("before", "after", "mismatch"))
            print(f"| {scene.name} | {columns} |", flush=True)
    return record

"""Photograph the six tabletop captures, path traced, with everything that is true about them.

    python examples/make_tabletop_capture.py -o FOLDER [--only carpet] [--size 1600] [--views 40] [--spp 16]

Needs Mitsuba 3 (in the `dev` extra) and an LLVM library (Debian: `apt-get install libllvm19`). Each capture
becomes FOLDER/<name> when it is complete: `photographs/` (JPEG with EXIF and nothing else), `photographs-16/`
(sixteen of them), and `truth/` (`tabletop/truth.py` says what is in it). Until then it grows in
FOLDER/<name>.partial; started again, the program continues where it stopped. The sixteen of every capture are
taken first. The same options give the same pictures.
"""

import argparse
import json
import os
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from make_sample_scene import check_environment, load_renderer, write_png

if TYPE_CHECKING:
    from tabletop.cameras import Shot
    from tabletop.captures import Stage
    from tabletop.phone import Exposure

SMALL = {
    "only": "carpet",
    "size": 448,
    "views": 20,
    "quality": 80,
    "spp": 32,
    "cells": 128,
    "held_out": 2,
    "held_out_size": 192,
    "truth_spp": 512,
}
METER_SIZE, METER_SPP = 160, 8


def main(arguments: list[str] | None = None) -> None:
    """Photograph all captures, or one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", help="this capture alone")
    parser.add_argument("--size", type=int, default=1600, help="pixels of the longer side")
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--held-out", type=int, default=4, help="views with truth that are not photographed")
    parser.add_argument("--held-out-size", type=int, default=400, help="pixels of their longer side")
    parser.add_argument("--quality", type=int, default=92, help="of JPEGs")
    parser.add_argument("--spp", type=int, default=16, help="paths per pixel of a photograph's object")
    parser.add_argument("--truth-spp", type=int, default=128, help="paths per pixel of relit pictures")
    parser.add_argument("--cells", type=int, default=320, help="cells along the object's longest side")
    parser.add_argument("--no-truth", action="store_true", help="leave held-out views for a later call")
    parser.add_argument("--small", action="store_true", help="the small capture that the tests use")
    if "--small" in (sys.argv[1:] if arguments is None else arguments):
        parser.set_defaults(**SMALL)
    options = parser.parse_args(arguments)
    load_renderer()
    check_environment()
    from tabletop.captures import CAPTURES

    if options.only and options.only not in CAPTURES:
        parser.error(f"there is no capture {options.only!r}; there are {', '.join(CAPTURES)}")
    names = [options.only] if options.only else list(CAPTURES)
    for name in names if len(names) > 1 else []:
        make(name, options, few_alone=True)
    for name in names:
        make(name, options)


def make(name: str, options: argparse.Namespace, *, few_alone: bool = False) -> None:
    """Make one capture, where it is not complete yet; `few_alone`: only its sixteen photographs for now."""
    final, partial = options.output / name, options.output / f"{name}.partial"
    if few_alone and (final.is_dir() or (partial / "photographs-16").is_dir()):
        return
    if not (final / "truth" / "cameras.json").is_file():
        partial.mkdir(parents=True, exist_ok=True)
        photographs(name, partial, options, few_alone=few_alone)
        if few_alone:
            return
        partial.rename(final)
        print(f"{name}: photographs done", flush=True)
    if not options.no_truth and not (final / "truth" / "scene.json").is_file():
        held_out(name, final / "truth", options)
        print(f"{name}: truth done", flush=True)


def photographs(name: str, folder: Path, options: argparse.Namespace, *, few_alone: bool) -> None:
    """Take the photographs that are missing, all or the few, and write cameras and masks."""
    from tabletop.captures import CAPTURES, Stage
    from tabletop.phone import develop, write_photograph
    from tabletop.photograph import photograph

    stage = Stage(CAPTURES[name], options.cells)
    shots = stage.shots(options.views, options.size)
    exposures = meter_all(stage, shots)
    pictures, masks = folder / "photographs", folder / "truth" / "masks"
    for sub in (pictures, masks):
        sub.mkdir(parents=True, exist_ok=True)
    names = [f"IMG_{k + 1:04d}.jpg" for k in range(len(shots))]
    few = [names[k] for k in stage.few(len(shots))]
    # The few first: they are of use before the others are there.
    for k in sorted(range(len(shots)), key=lambda k: names[k] not in few):
        shot, exposure, stem = shots[k], exposures[k], names[k].removesuffix(".jpg")
        if (pictures / names[k]).is_file():
            continue
        began = time.perf_counter()
        scene, thing = stage.scene(shot.turn_deg)
        seed = 100 * stage.capture.seed + k
        seen = photograph(scene, thing, shot.camera, options.spp, seed, 8.0 / exposure.factor)
        write_png(masks / f"{stem}.png", seen[..., 3:])
        picture = develop(seen[..., :3], exposure, seed)
        write_photograph(pictures / names[k], picture, exposure, shot.orientation, k, options.quality)
        print(f"{name} {stem} {time.perf_counter() - began:.0f} s", flush=True)
        if sorted(path.name for path in pictures.glob("*.jpg")) == few:
            write_cameras(folder, stage, shots, exposures, few)
            print(f"{name}: photographs-16 done", flush=True)
            if few_alone:
                return
    write_cameras(folder, stage, shots, exposures, few)


def write_cameras(
    folder: Path, stage: "Stage", shots: list["Shot"], exposures: list["Exposure"], few: list[str]
) -> None:
    """Write cameras.json and the folder of the few photographs."""
    from tabletop.truth import camera_record

    cameras = {}
    for k, (shot, exposure) in enumerate(zip(shots, exposures, strict=True)):
        exposed = {"exposure_factor": exposure.factor, "iso": exposure.iso, "exposure_s": exposure.seconds}
        cameras[f"IMG_{k + 1:04d}.jpg"] = camera_record(shot) | exposed
    (folder / "photographs-16").mkdir(exist_ok=True)
    for file in few:
        shutil.copy2(folder / "photographs" / file, folder / "photographs-16" / file)
    record = {"capture": stage.capture.name, "about": stage.capture.about, "few": few, "cameras": cameras}
    partial = folder / "truth" / "cameras.partial"
    partial.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    os.replace(partial, folder / "truth" / "cameras.json")


def meter_all(stage: "Stage", shots: list["Shot"]) -> list["Exposure"]:
    """Return the exposure of every shot: its own with auto-exposure, else their median for all."""
    from tabletop.phone import Exposure, meter
    from tabletop.tracing import radiance

    factors = []
    for k, shot in enumerate(shots):
        if k > 0 and stage.capture.turntable:
            continue
        scene, _ = stage.scene(shot.turn_deg)
        small = radiance(scene, shot.camera.resized(METER_SIZE), METER_SPP, 900_000 + k)
        factors.append(meter(small, stage.capture.grey))
    if not stage.capture.auto_exposure:
        factors = [float(np.median(factors))] * len(shots)
    return [Exposure(factor=factor) for factor in factors]


def held_out(name: str, folder: Path, options: argparse.Namespace) -> None:
    """Write the truth of views that were not photographed; scene.json is written last."""
    from tabletop.captures import CAPTURES, Stage
    from tabletop.truth import write_scene, write_view

    stage = Stage(CAPTURES[name], options.cells)
    shots = stage.held_out(options.held_out, options.held_out_size)
    partial = folder / "scene.partial"
    partial.mkdir(exist_ok=True)
    lights = write_scene(partial, stage, len(shots), options.truth_spp, small=options.small)
    for k, shot in enumerate(shots):
        view = folder / f"test_{k:03d}"
        if not view.is_dir():
            write_view(view, stage, shot, lights, options.truth_spp, k, small=options.small)
            print(f"{name} {view.name}", flush=True)
    for path in [*partial.iterdir()]:
        if path.name != "scene.json":
            os.replace(path, folder / path.name)
    os.replace(partial / "scene.json", folder / "scene.json")
    partial.rmdir()


if __name__ == "__main__":
    main()

"""Train nerfstudio's radiance fields beside our stage one and compare novel views over time, on the CPU.

    python -m benchmarks peer_nerfstudio SUITE/cowcrate --python PEER/bin/python --seconds 200 -o OUT

PEER is a virtual environment with nerfstudio 1.1.5; docs/benchmarks/peers.md says how to make it. Without
`--python`, or where nerfstudio does not import there, the peer is left out, and the table says so. Each
method of `--methods` trains on the photographs that `--preset` trains on, at the same size, with the scene's
box and cameras, for `--seconds`. `nerfacto` and `tensorf` have nerfstudio's sizes and rates, `nerfacto-small`
grids, samples and batches near those of `fast` and rates that fall over the given time. Marks on the way are
scored as in `time_to_quality`: PSNR over white on the whole frame, encoded, with four rays per pixel. Novel
views only: these peers recover neither materials nor light, so nothing of theirs can be relit.
"""

import argparse
import json
import math
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from flashcache.evaluation.metrics import over_white
from flashcache.presets import preset
from jaxtyping import Float32
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from lambent_core.scene import Scene, View
from lambent_core.startup import prepare
from lambent_run.report.predictions import encoded
from lambent_run.report.request import evenly_spaced
from numpy import ndarray

from benchmarks.time_to_quality import ANTIALIAS, Mark, curve

QUICK = "{sample} --preset tiny --methods nerfacto-small --seconds 4 --marks 1 --views 1"

TRAINER = Path(__file__).with_name("nerfstudio_training.py")
PROPOSAL = {"hidden_dim": 16, "log2_hashmap_size": 15, "num_levels": 5, "use_linear": False}
SMALL = {
    "num_levels": 8,
    "max_res": 256,
    "log2_hashmap_size": 17,
    "num_proposal_samples_per_ray": [32, 16],
    "num_nerf_samples_per_ray": 12,
    "use_appearance_embedding": False,
    "proposal_warmup": 500,
    "proposal_weights_anneal_max_num_iters": 100,
    "proposal_net_args_list": [{**PROPOSAL, "max_res": 128}, {**PROPOSAL, "max_res": 256}],
}
OWN = {"model": {}, "rays": 4096, "rate": 0.0, "final_rate": 0.0}
METHODS: dict[str, dict[str, Any]] = {
    "nerfacto": {**OWN, "method": "nerfacto"},
    "nerfacto-small": {"method": "nerfacto", "model": SMALL, "rays": 256, "rate": 2e-2, "final_rate": 0.05},
    "tensorf": {**OWN, "method": "tensorf"},
    "vanilla-nerf": {**OWN, "method": "vanilla-nerf", "rays": 1024},
    "instant-ngp": {**OWN, "method": "instant-ngp"},
}
"""Settings by name: of the model where they differ, rays per step, rates; zero for nerfstudio's schedule."""


def pixels(view: View, light: str) -> Float32[ndarray, "height width 4"]:
    """Return the encoded photograph with straight alpha."""
    picture = view.images[light]
    return encoded(picture[..., :3], picture[..., 3:]).astype(np.float32)


def missing(python: Path | None) -> str:
    """Return why the peer cannot be run with this interpreter, or nothing."""
    if python is None:
        return "no --python was given"
    if not python.is_file():
        return f"{python} does not exist"
    command = [str(python), "-c", "import nerfstudio.models.nerfacto"]
    done = subprocess.run(command, capture_output=True, text=True)
    return (done.stderr.strip().splitlines() or ["it fails"])[-1] if done.returncode else ""


def lens(view: View) -> tuple[float, ...]:
    """Return focal lengths, optical axis, width and height in pixels."""
    camera = view.camera
    axis = (camera.centre_x, camera.centre_y)
    return (camera.focal_x, camera.focal_y, *axis, camera.width, camera.height)


def write_data(scene: Scene, tests: tuple[View, ...], out: Path) -> None:
    """Write encoded photographs and all cameras, for a program that has none of our packages."""
    if not np.allclose([lens(view) for view in (*scene.train, *tests)], lens(tests[0])):
        raise SystemExit("only scenes whose views all have the same lens and size are compared")
    train, test = (
        np.stack([view.camera.camera_to_world for view in views]) for views in (scene.train, tests)
    )
    images = np.stack([pixels(view, scene.lights[0]) for view in scene.train])
    np.savez(out, images=images, train_poses=train, test_poses=test, intrinsics=np.array(lens(tests[0])))


def peer_curve(name: str, seed: int, scene: Scene, arguments: argparse.Namespace) -> list[Mark]:
    """Return the marks of one training of the peer."""
    tests = evenly_spaced(scene.test, arguments.views)
    folder = arguments.out / f"{scene.name}_{name}_{seed}"
    folder.mkdir(parents=True, exist_ok=True)
    write_data(scene, tests, folder / "data.npz")
    half = max(map(abs, (*scene.bounds_min, *scene.bounds_max)))
    settings = {key: getattr(arguments, key) for key in ("seconds", "clock", "marks", "threads")}
    paths = {"data": str(folder / "data.npz"), "folder": str(folder)}
    more = {"seed": seed, "half_extent": half, "primary": scene.primary, "antialias": ANTIALIAS}
    job = folder / "job.json"
    job.write_text(json.dumps({**METHODS[name], **settings, **paths, **more}), encoding="utf-8")
    truth = np.stack([over_white(pixels(view, scene.lights[0])) for view in tests])
    marks: list[Mark] = []
    command = [str(arguments.python), "-W", "ignore", str(TRAINER), str(job)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if not line.startswith("{"):
                continue
            error = float(np.square(np.load(folder / f"{len(marks) + 1}.npy") - truth).mean())
            marks.append(Mark(**json.loads(line), psnr=-10.0 * math.log10(error), normals=math.nan))
            show(marks[-1])
    if process.returncode:
        raise SystemExit(f"{name} ended with {process.returncode}; what it printed says why")
    return marks


def show(mark: Mark) -> None:
    """Print a mark and how busy the machine is."""
    busy = f"load average {os.getloadavg()[0]:.1f}"
    print(f"  {json.dumps({key: round(value, 2) for key, value in mark.items()})}, {busy}", flush=True)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scene", type=Path)
    parser.add_argument("--python", type=Path, help="the interpreter of the environment with nerfstudio")
    parser.add_argument("--methods", nargs="*", choices=METHODS, default=["nerfacto", "nerfacto-small"])
    parser.add_argument("--preset", default="fast", help="of our side")
    parser.add_argument("--without-ours", action="store_true")
    parser.add_argument("--seconds", type=float, default=200.0, help="of the peer's own steps, by --clock")
    parser.add_argument("--clock", choices=("wall", "processor"), default="processor")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--marks", type=int, default=4)
    parser.add_argument("--views", type=int, default=4, help="test views, evenly spaced")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="of the peer's torch")


def main(arguments: argparse.Namespace) -> dict[str, list[Mark]]:
    """Return the curves by method and seed; prints the table."""
    prepare()
    curves: dict[str, list[Mark]] = {}
    reason = missing(arguments.python)
    if reason:
        print(f"nerfstudio is not installed, so it is NOT compared: {reason}\n", flush=True)
    manifest = describe_scene(arguments.scene)
    size = preset(arguments.preset).max_side
    scene = load_scene(arguments.scene, manifest, max_side=size, lights=(manifest.lights[0],))
    for seed in arguments.seeds:
        if not arguments.without_ours:
            print(f"ours ({arguments.preset}), seed {seed}", flush=True)
            run = arguments.out / "runs" / f"{scene.name}_{arguments.preset}_{seed}"
            curves[f"ours ({arguments.preset}), seed {seed}"] = curve(run, seed, {}, arguments)
        for name in () if reason else arguments.methods:
            print(f"{name}, seed {seed}", flush=True)
            curves[f"{name}, seed {seed}"] = peer_curve(name, seed, scene, arguments)
    print("\n| training | steps | wall [s] | processor [s] | novel views [dB] |\n" + "| --- " * 5 + "|")
    for title, marks in curves.items():
        for mark in marks:
            figures = f"{mark['wall']:.0f} | {mark['processor']:.0f} | {mark['psnr']:.2f}"
            print(f"| {title} | {mark['step']} | {figures} |")
    if reason:
        print(f"| nerfstudio | not installed ({reason}) | | | |")
    return curves

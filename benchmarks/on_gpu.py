"""Measure on a GPU what is worth it, in pieces of a few minutes, and go on where the last call ended.

    python -m benchmarks on_gpu SUITE/cowcrate --large SCENE --environments SUITE/envmaps/high_res -o OUT

Pieces in order of worth: tests marked `gpu`; kernels against the time in which their bytes can be moved;
steps of the paper's two stages; its caches per million secondary rays; preset `standard` to the end, with
relighting, on the scene and on a `--large` one; preset `paper_tensoir`, as far as it gets. Each is a process
of its own and writes OUT/pieces/NAME.json; one that is there and finished is left out, and trainings go on
from their checkpoints. A call ends after about `--seconds`. OUT/page.md is written anew after every piece.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

QUICK = (
    "{sample} --device cpu --preset tiny --paper tiny --paper-share 0.2 --share 512 "
    "--repeats 2 --views 1 --points 1 --tests tests/unit/flashcache/kernels/test_gpu_march.py"
)

ROOT = Path(__file__).parent.parent
GRACE_S = 90.0
"""Time that a piece may take beyond its own before it is ended."""
TAIL = 3000
"""Characters of the tests' output that are kept."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Something to measure."""

    name: str
    kind: str
    """What the page's section is called in `gpu_page.SECTIONS`."""
    least_s: float
    """Seconds below which it is left to the next call."""
    measure: Callable[[argparse.Namespace, float], dict[str, Any]]
    """Returns the result, given the options and the seconds it may take."""


def run_tests(arguments: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Return how the tests marked `gpu` ended."""
    command = ["-m", "pytest", "-m", "gpu", "-q", "-n0", "-p", "no:cacheprovider", *arguments.tests]
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, capture_output=True, text=True, timeout=seconds
    )
    output = done.stdout + done.stderr
    summary = re.findall(r"^.*\b(?:passed|failed|skipped|error)\b.*$", output, re.MULTILINE)
    return {
        "command": " ".join(["python", *command]),
        "code": done.returncode,
        "summary": summary[-1] if summary else "no tests",
        "tail": output[-TAIL:].strip(),
    }


def measure_kernels(arguments: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Return the kernels' times and limits."""
    import torch

    from benchmarks.gpu_limits import kernels

    return kernels(torch.device(arguments.device), arguments.repeats, arguments.share)


def measure_steps(arguments: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Return times of training steps."""
    import torch

    from benchmarks.gpu_steps import steps

    device, share = torch.device(arguments.device), arguments.share
    return steps(arguments.scene, arguments.paper, device, arguments.repeats, share)


def measure_rays(arguments: argparse.Namespace, seconds: float) -> dict[str, Any]:
    """Return times of secondary rays."""
    import torch

    from benchmarks.gpu_steps import rays

    device, share = torch.device(arguments.device), arguments.share
    return rays(arguments.scene, arguments.paper, device, arguments.repeats, share)


def train(
    arguments: argparse.Namespace, seconds: float, *, name: str, scene: Path, preset_name: str, share: float
) -> dict[str, Any]:
    """Return the state of a training after another sitting."""
    from benchmarks.gpu_training import training

    return training(
        scene,
        arguments.out / "runs" / name,
        preset_name=preset_name,
        share=share,
        environments=arguments.environments,
        device=arguments.device,
        views=arguments.views,
        points=arguments.points,
        seconds=seconds,
    )


def pieces_of(arguments: argparse.Namespace) -> list[Piece]:
    """Return what there is to measure, in order of worth."""
    found = [
        Piece("tests", "tests", 60.0, run_tests),
        Piece("kernels", "kernels", 60.0, measure_kernels),
        Piece("steps", "steps", 90.0, measure_steps),
        Piece("rays", "rays", 60.0, measure_rays),
    ]
    trainings = [(arguments.preset, arguments.scene, 1.0), (arguments.preset, arguments.large, 1.0)]
    trainings.append((arguments.paper, arguments.scene, arguments.paper_share))
    for place, (preset_name, scene, share) in enumerate(trainings):
        if scene is not None:
            name = f"{place + 1}_{preset_name.replace(':', '_')}_{scene.name}"
            measure = partial(train, name=name, scene=scene, preset_name=preset_name, share=share)
            found.append(Piece(name, "training", 60.0, measure))
    return [piece for piece in found if not arguments.pieces or piece.name in arguments.pieces]


def record_of(out: Path, name: str) -> dict[str, Any]:
    """Return the record of a piece, or an empty one."""
    path = out / "pieces" / f"{name}.json"
    return json.loads(path.read_text()) if path.is_file() else {}


def is_done(record: dict[str, Any]) -> bool:
    """Return whether nothing is left of a piece."""
    return bool(record) and record["result"].get("finished", True)


def measure_one(piece: Piece, arguments: argparse.Namespace) -> None:
    """Measure a piece in this process and write its record."""
    import torch

    from benchmarks.gpu_timing import machine

    device = torch.device(arguments.device)
    if device.type == "cuda" and not torch.cuda.is_available():
        raise SystemExit(f"--device {device}: torch finds no GPU")
    began = time.perf_counter()
    result = piece.measure(arguments, arguments.seconds)
    seconds = time.perf_counter() - began + record_of(arguments.out, piece.name).get("seconds", 0.0)
    record = {"kind": piece.kind, "machine": machine(device), "seconds": seconds, "result": result}
    folder = arguments.out / "pieces"
    folder.mkdir(parents=True, exist_ok=True)
    partial_file = folder / f"{piece.name}.tmp"
    partial_file.write_text(json.dumps(record, indent=1) + "\n")
    partial_file.replace(folder / f"{piece.name}.json")


def write_page(pieces: list[Piece], out: Path) -> None:
    """Write the page from the records that are there."""
    from benchmarks.gpu_page import page

    records = {piece.name: record_of(out, piece.name) for piece in pieces}
    known = {name: record for name, record in records.items() if record}
    missing = [name for name, record in records.items() if not is_done(record)]
    text = page(known, "python -m benchmarks on_gpu")
    if missing:
        text += f"\nNot measured, or not to the end: {', '.join(missing)}.\n"
    (out / "page.md").write_text(text)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scene", type=Path)
    parser.add_argument(
        "--large", type=Path, help="a capture with pictures of 400 pixels, to train on as well"
    )
    parser.add_argument("--environments", type=Path, help="maps to relight with")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--preset", default="standard", help="trained to the end")
    parser.add_argument("--paper", default="paper_tensoir", help="preset of the paper's sizes")
    parser.add_argument("--paper-share", type=float, default=1.0, help="shortens its schedule to this share")
    parser.add_argument(
        "--share", type=int, default=1, help="divisor of points and rays of single kernels and steps"
    )
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--views", type=int, default=4, help="test views, evenly spaced")
    parser.add_argument("--points", type=int, default=8, help="of a curve, in each stage")
    parser.add_argument("--tests", nargs="+", default=["tests"], help="files or folders of tests")
    parser.add_argument("--seconds", type=float, default=540.0, help="after which a call begins nothing new")
    parser.add_argument("--pieces", nargs="+", default=[], help="names; all by default")
    parser.add_argument("--only", help=argparse.SUPPRESS)


def main(arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure what is not there yet, as far as time is; return the names of what is left and what failed."""
    pieces = pieces_of(arguments)
    if arguments.only:
        (piece,) = [piece for piece in pieces if piece.name == arguments.only]
        measure_one(piece, arguments)
        return {}
    ends_at = time.monotonic() + arguments.seconds
    failed = []
    for piece in pieces:
        left = ends_at - time.monotonic()
        if is_done(record_of(arguments.out, piece.name)) or left < piece.least_s:
            continue
        print(f"{piece.name}: at most {left:.0f} s", flush=True)
        words = [*sys.argv[1:], "--only", piece.name, "--seconds", str(left), "-o", str(arguments.out)]
        try:
            code = subprocess.run(
                [sys.executable, "-m", "benchmarks", *words], cwd=ROOT, timeout=left + GRACE_S
            ).returncode
        except subprocess.TimeoutExpired:
            code = -1
        failed += [piece.name] if code else []
        write_page(pieces, arguments.out)
    rest = [piece.name for piece in pieces if not is_done(record_of(arguments.out, piece.name))]
    print(f"left: {', '.join(rest) or 'nothing'}; failed: {', '.join(failed) or 'nothing'}")
    print(f"page: {arguments.out / 'page.md'}")
    return {"left": rest, "failed": failed}

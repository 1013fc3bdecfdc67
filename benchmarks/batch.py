"""Measure the memory of a batch over many frames, and the frames per second of several processes.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python -m benchmarks batch BUNDLE --environments DIR

Runs `lambent batch` and observes it from outside: the resident memory of all of its processes
after every picture, and the time from the first picture to the last. Prints Markdown for
docs/benchmarks/batch.md.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

QUICK = (
    "{bundle} --environments {maps} --frames 6 --speed-frames 4 --speed-size 32"
    " --speed-spp 4 --lights 1 --size 32"
)

SECONDS_BETWEEN_LOOKS = 0.2


@dataclass(frozen=True)
class Course:
    """The measurements of one batch: (pictures done, resident MiB of all processes) and its speed."""

    memory: list[tuple[int, float]]
    frames_per_s: float


def resident_mib(process: psutil.Process) -> float:
    """Return the resident memory of a process and its children, MiB."""
    total = 0
    for each in (process, *process.children(recursive=True)):
        try:
            total += each.memory_info().rss
        except psutil.NoSuchProcess:
            continue
    return total / 2**20


def run(document: dict, folder: Path, jobs: int) -> Course:
    """Run a manifest in a process of its own."""
    manifest = folder / f"manifest-{jobs}.yaml"
    manifest.write_text(json.dumps(document))
    output = folder / f"out-{jobs}-{time.monotonic_ns()}"
    command = [
        sys.executable,
        "-m",
        "lambent",
        "batch",
        str(manifest),
        "-o",
        str(output),
        "--jobs",
        str(jobs),
    ]
    child = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    journal = output / "pictures.jsonl"
    seen: dict[int, float] = {}
    first = last = 0.0
    done = 0
    while child.poll() is None:
        text = journal.read_bytes() if journal.is_file() else b""
        if text.count(b"\n") > done:
            done, last = text.count(b"\n"), time.monotonic()
            first = first or last
            seen[done] = resident_mib(child)
        time.sleep(SECONDS_BETWEEN_LOOKS)
    if child.returncode:
        raise SystemExit(f"lambent batch ended with {child.returncode}")
    start = min(seen)
    return Course(sorted(seen.items()), (done - start) / max(last - first, 1e-9))


def at(memory: list[tuple[int, float]], frame: int) -> float:
    """Return the memory when `frame` pictures were done."""
    return next(mib for done, mib in memory if done >= frame)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--speed-frames", type=int, default=60)
    parser.add_argument("--speed-size", type=int, default=128)
    parser.add_argument("--speed-spp", type=int, default=32)
    parser.add_argument("--lights", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--quality", default="refined")
    parser.add_argument("--spp", type=int, default=4)


def main(arguments: argparse.Namespace) -> None:
    """Measure and print."""
    maps = sorted(path for path in arguments.environments.iterdir() if path.suffix in (".hdr", ".exr"))

    def document(num_frames: int, lights: list[Path], spp: int, size: int) -> dict:
        return {
            "schema": "lambent-batch/1",
            "assets": [str(arguments.bundle.resolve())],
            "environments": [str(path.resolve()) for path in lights],
            "cameras": [{"turntable": num_frames // len(lights), "size": size}],
            "settings": {"quality": arguments.quality, "spp": spp, "antialias": 1},
        }

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        marks = [max(1, round(arguments.frames * share)) for share in (0.02, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)]
        print("| lights | " + " | ".join(f"after {mark}" for mark in marks) + " |")
        print("| --- |" + " --- |" * len(marks))
        for lights in (maps[:count] for count in arguments.lights):
            course = run(document(arguments.frames, lights, arguments.spp, arguments.size), folder, 1)
            cells = [f"{at(course.memory, min(mark, course.memory[-1][0])):.0f}" for mark in marks]
            print(f"| {len(lights)} | " + " | ".join(cells) + " |", flush=True)
        print("\n| processes | frames/s | MiB |\n| --- | --- | --- |")
        speeds: dict[int, list[Course]] = {1: [], 2: []}
        for jobs in (1, 2, 2, 1):
            asked = document(arguments.speed_frames, maps[:1], arguments.speed_spp, arguments.speed_size)
            speeds[jobs].append(run(asked, folder, jobs))
        for jobs, courses in speeds.items():
            rate = sum(course.frames_per_s for course in courses) / len(courses)
            spread = max(c.frames_per_s for c in courses) - min(c.frames_per_s for c in courses)
            mib = max(mib for course in courses for _, mib in course.memory)
            print(f"| {jobs} | {rate:.2f} +- {spread / 2:.2f} | {mib:.0f} |")
    print(f"\n{os.cpu_count()} cores, {arguments.quality}")

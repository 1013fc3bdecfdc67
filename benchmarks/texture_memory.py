"""Peak memory of an export whose albedo texture takes its detail from many large photographs.

    python -m benchmarks texture_memory RUN [--photographs 8 16 40] [--atlas 4096] [--tier full]

RUN is a finished run on the sample, `tests/data/still_life`. Its model stays; its photographs are replaced by
square JPEG files of `--megapixels` (24) from the same cameras, whose focal length is longer by what lets the
object reach the border of the picture. They are the sample's pictures enlarged, times a field with the
spectrum of natural pictures (amplitude 1 / f, standard deviation `CONTRAST`), another one in each photograph.
Beyond as many cameras as the sample has, photographs are repeated under other names. Other sizes of the
export are those of the preset `fast`.

`lambent export` runs in a process of its own. *Peak* is the largest resident memory of that process (VmHWM);
*photographs* the largest that was sampled, every 50 ms, while it read the photographs for the texture. MB are
10^6 bytes.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from flashcache.config import ExportConfig
from PIL import Image

QUICK = "{run} --photographs 2 --megapixels 0.3 --atlas 512 --transport 128"
CONTRAST = 0.15
TILE = 2048
"""Pixels along a side of the repeated field of detail."""
QUALITY = 92
SAMPLED_S = 0.05


def natural(side: int, rng: np.random.Generator) -> np.ndarray:
    """Return a periodic field [side, side] with amplitudes 1 / f, mean 1 and deviation `CONTRAST`."""
    f = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None])
    f[0, 0] = np.inf
    phase = np.exp(2j * np.pi * rng.random(f.shape))
    field = np.fft.irfft2(phase / f, (side, side))
    return (1.0 + CONTRAST * field / field.std()).astype(np.float32)


def reach_of(pictures: list[Path]) -> float:
    """Return how far the object reaches from the middle of its pictures, as a share of half a side."""
    most = 0.0
    for path in pictures:
        with Image.open(path) as image:
            rows, columns = np.nonzero(np.asarray(image.getchannel("A")) > 0)
            places = np.stack([rows / (image.height - 1), columns / (image.width - 1)])
        most = max(most, float(np.abs(2.0 * places - 1.0).max()))
    return most


def enlarged(source: Path, share: float, side: int, field: np.ndarray) -> tuple[Image.Image, Image.Image]:
    """Return the middle `share` of a picture at `side` pixels, with detail, and its mask."""
    with Image.open(source) as image:
        rgba = image.convert("RGBA")
    low, high = rgba.width * (1.0 - share) / 2.0, rgba.width * (1.0 + share) / 2.0
    large = rgba.resize((side, side), Image.Resampling.BICUBIC, box=(low, low, high, high))
    pixels = np.asarray(large.convert("RGB"))
    repeats = -(-side // len(field))
    detail = np.tile(field, (repeats, repeats))[:side, :side, None]
    result = np.empty_like(pixels)
    for first in range(0, side, 256):
        rows = slice(first, first + 256)
        result[rows] = np.clip(pixels[rows] * detail[rows], 0.0, 255.0)
    return Image.fromarray(result), large.getchannel("A").point(lambda level: 255 if level > 127 else 0)


def write_run(run: Path, target: Path, count: int, megapixels: float, transport: int) -> int:
    """Copy the run at `run` to `target`, with `count` large photographs; return their pixels a side."""
    shutil.copytree(run, target, ignore=shutil.ignore_patterns("bundle*", "pictures"))
    record = json.loads((target / "run.json").read_text(encoding="utf-8"))
    capture, scene = Path(record["scene"]), target.parent / "scene"
    scene.mkdir(exist_ok=True)
    manifest = json.loads((target / "scene" / "manifest.json").read_text(encoding="utf-8"))
    frames = [frame for frame in manifest["frames"] if frame["split"] == "SPLIT_TRAIN"]
    light, side = manifest["lights"][0], round((1e6 * megapixels) ** 0.5)
    sources = [
        capture / next(image["path"] for image in frame["images"] if image["light"] == light)
        for frame in frames
    ]
    share, rng = min(1.0, 1.05 * reach_of(sources)), np.random.default_rng(0)
    field = natural(min(TILE, side), rng)
    manifest["frames"] = []
    for number in range(count):
        frame = json.loads(json.dumps(frames[number % len(frames)]))
        name = f"photograph_{number % len(frames):03d}"
        if not (scene / f"{name}.png").is_file():
            moved = np.roll(field, rng.integers(0, len(field), 2), axis=(0, 1))
            photograph, mask = enlarged(sources[number % len(frames)], share, side, moved)
            photograph.save(scene / f"{name}.jpg", quality=QUALITY)
            mask.save(scene / f"{name}.png", compress_level=1)
        camera = frame["camera"]
        scale = side / (share * camera["width"])
        middle = {"centre_x": "width", "centre_y": "height"}
        for centre, size in middle.items():
            camera[centre] = scale * (camera[centre] - 0.5 * camera[size]) + 0.5 * side
        camera |= {"width": side, "height": side}
        camera |= {key: scale * camera[key] for key in ("focal_x", "focal_y")}
        images = [{"light": light, "path": f"{name}.jpg", "encoding": "srgb"}]
        frame |= {"name": f"view_{number:03d}", "images": images, "truth": {}, "mask": f"{name}.png"}
        manifest["frames"].append(frame)
    (target / "scene" / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    sizes = ExportConfig(transport_size=transport, judge_samples=0)
    record |= {"scene": str(scene), "config": record["config"] | {"export": asdict(sizes)}}
    (target / "run.json").write_text(json.dumps(record), encoding="utf-8")
    return side


@dataclass(frozen=True, kw_only=True, slots=True)
class Watched:
    """What a process took that told what it was doing."""

    peak: int
    """Largest resident memory, bytes, as the system counted it until the last sample."""
    highest: dict[str, int]
    """Largest sampled resident memory, bytes, by what it was doing."""
    seconds: dict[str, float]
    """Wall-clock time by what it was doing."""
    processor_s: float


def watched(command: list[str]) -> Watched:
    """Run a command that prints events as JSON lines; ends the benchmark where that fails."""
    child = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    doing, ended, peak = "", threading.Event(), 0
    highest: dict[str, int] = {}
    seconds: dict[str, float] = {}

    def sample() -> None:
        # Not `ru_maxrss`, in which a child begins with the largest memory of its parent.
        nonlocal peak
        while not ended.wait(SAMPLED_S):
            # Before the memory is read: what is told meanwhile may come with memory that was given back.
            during = doing
            try:
                text = Path(f"/proc/{child.pid}/status").read_text(encoding="ascii")
            except OSError:
                return
            found = {line.split()[0]: line.split()[1] for line in text.splitlines() if line.startswith("Vm")}
            highest[during] = max(highest.get(during, 0), 1024 * int(found.get("VmRSS:", 0)))
            peak = max(peak, 1024 * int(found.get("VmHWM:", 0)))

    sampler = threading.Thread(target=sample, daemon=True)
    sampler.start()
    since = time.perf_counter()
    assert child.stdout is not None
    with child.stdout as events:
        for line in events:
            event = json.loads(line)
            now = time.perf_counter()
            seconds[doing] = seconds.get(doing, 0.0) + now - since
            since = now
            if event["event"] == "progress":
                doing = event["doing"]
    # The processor's time of this child alone.
    _, status, usage = os.wait4(child.pid, 0)
    ended.set()
    sampler.join()
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {child.returncode}")
    return Watched(
        peak=peak,
        highest=highest,
        seconds=seconds,
        processor_s=usage.ru_utime + usage.ru_stime,
    )


def export(run: Path, out: Path, options: list[str]) -> dict[str, Any]:
    """Return memory [bytes] and times [s] of an export, and the bytes of its files."""
    found = watched([sys.executable, "-m", "lambent", "export", str(run), "-o", str(out), "--json", *options])
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    if manifest["atlas"]["albedo_source"] != "photographs":
        raise SystemExit("the texture was not made from the photographs")
    roles: dict[str, int] = {}
    for file in manifest["files"]:
        kind = file["path"] if file["path"] == "mesh/asset.glb" else file["role"]
        roles[kind] = roles.get(kind, 0) + int(file["size_bytes"])
    return {
        "peak": found.peak,
        "photographs_peak": found.highest.get("photograph", 0),
        "photographs_s": found.seconds.get("photograph", 0.0),
        "whole_s": sum(found.seconds.values()),
        "processor_s": found.processor_s,
        "atlas": manifest["atlas"]["size"],
        "share": manifest["metrics"]["texture_photograph_share"],
        "files": roles,
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("run", type=Path, help="finished run on the sample")
    parser.add_argument("--photographs", type=int, nargs="+", default=[8, 16, 40])
    parser.add_argument("--megapixels", type=float, default=24.0)
    parser.add_argument("--atlas", default="4096", help="texels along a side, or auto")
    parser.add_argument("--tier", default="full")
    parser.add_argument("--transport", type=int, default=512, help="texels along a side of baked transport")


def main(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Print and return a row for each number of photographs."""
    rows = []
    print(
        "| photographs | pixels a side | atlas | peak [MB] | photographs [MB] | both passes [s] | all [s] "
        "| processor [s] | bundle [MB] | asset.glb [MB] |\n" + "| --- " * 10 + "|"
    )
    for count in arguments.photographs:
        folder = arguments.out / f"{count}_{arguments.tier}_{arguments.atlas}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        run = folder / "run"
        side = write_run(arguments.run, run, count, arguments.megapixels, arguments.transport)
        options = ["--atlas", arguments.atlas, "--tier", arguments.tier]
        found = export(run, folder / "bundle", options)
        bundle = sum(found["files"].values())
        print(
            f"| {count} | {side} | {found['atlas']} | {found['peak'] / 1e6:.0f} "
            f"| {found['photographs_peak'] / 1e6:.0f} | {found['photographs_s']:.0f} "
            f"| {found['whole_s']:.0f} | {found['processor_s']:.0f} | {bundle / 1e6:.1f} "
            f"| {found['files']['mesh/asset.glb'] / 1e6:.1f} |",
            flush=True,
        )
        rows.append({"photographs": count, "side": side, **found})
        shutil.rmtree(folder / "scene")
        shutil.rmtree(run)
    return rows

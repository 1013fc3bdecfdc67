"""Measure memory and time of loading many large photographs, cut to the object and reduced.

    python -m benchmarks loading [--count 200] [--width 6000] [--max-side 128] [--crop object]

All photographs are one file under many names: a JPEG of noise through a lens with distortion, with a mask.
"""

import argparse
import json
import math
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from PIL import Image

QUICK = "--count 3 --width 600"


def write_capture(folder: Path, count: int, width: int) -> None:
    """Write a capture in nerfstudio's layout of a ball that covers a fifth of every photograph."""
    height = 2 * width // 3
    noise = np.random.default_rng(0).integers(0, 256, (height // 8, width // 8, 3), dtype=np.uint8)
    rows, columns = np.mgrid[:height, :width]
    mask = (columns - width / 2) ** 2 + (rows - height / 2) ** 2 < (0.2 * width) ** 2
    Image.fromarray(noise).resize((width, height)).save(folder / "photograph.jpg", quality=92)
    Image.fromarray(mask.astype(np.uint8) * 255).save(folder / "mask.png")
    frames = []
    for name, kind in (("images", "photograph.jpg"), ("masks", "mask.png")):
        (folder / name).mkdir()
        for index in range(count):
            (folder / name / f"{index:04d}{Path(kind).suffix}").hardlink_to(folder / kind)
        (folder / kind).unlink()
    for index in range(count):
        angle = 2.0 * math.pi * index / count
        back = np.array([math.cos(angle), math.sin(angle), 0.4]) / math.hypot(1.0, 0.4)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3] = np.stack([right, np.cross(back, right), back, 4.0 * back], axis=1)
        names = {"file_path": f"images/{index:04d}.jpg", "mask_path": f"masks/{index:04d}.png"}
        frames.append({**names, "transform_matrix": pose.tolist()})
    lens = {"camera_model": "OPENCV", "w": width, "h": height, "cx": width / 2, "cy": height / 2}
    lens |= {"fl_x": 1.2 * width, "fl_y": 1.2 * width, "k1": -0.05, "k2": 0.01, "p1": 0.0, "p2": 0.0}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))


def peak_gib() -> float:
    """Return the largest amount of memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--width", type=int, default=6000, help="pixels; the height is two thirds of it")
    parser.add_argument("--max-side", type=int, default=128)
    parser.add_argument("--crop", choices=("object", "frame"), default="object")


def main(options: argparse.Namespace) -> dict[str, dict]:
    """Load a capture twice, the second time from the pictures that the first one kept."""
    record = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder, store = Path(scratch) / "capture", Path(scratch) / "kept"
        folder.mkdir()
        write_capture(folder, options.count, options.width)
        manifest = describe_scene(folder)
        print(f"described: peak {peak_gib():.2f} GiB", flush=True)
        for name in ("decoded", "kept"):
            began, used = time.monotonic(), time.process_time()
            scene = load_scene(folder, manifest, max_side=options.max_side, crop=options.crop, store=store)
            shape = next(iter(scene.train[0].images.values())).shape
            record[name] = {
                "photographs": len(scene.train) + len(scene.test),
                "size": [shape[1], shape[0]],
                "seconds": time.monotonic() - began,
                "processor_seconds": time.process_time() - used,
                "peak_gib": peak_gib(),
            }
            print(f"{name}: {record[name]}", flush=True)
    return record

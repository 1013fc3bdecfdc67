"""Compare the masks that `lambent masks` finds in photographs with references: IoU for each capture.

    python -m benchmarks photograph_masks CAPTURE... [--references DIR] [--photographs FOLDER] [-o DIR]

A capture is one of the tabletop suite (`truth/cameras.json` and `truth/masks`; its true cameras are used, and
points are triangulated), any layout with cameras, whose references are PNGs named like the frames in
`--references`, or with `--painted BACKGROUND` one with alpha, painted as `masks` does.
"""

import argparse
import json
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from lambent_capture.checks.picture_camera import PictureCamera
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.masks.final import FinalSettings, colours_of, final_mask
from lambent_capture.masks.find import FindSettings, agreement_of, find_object
from lambent_capture.masks.photograph import Photograph, SparsePoints, of_pictures, photographs_of
from lambent_capture.masks.sparse import sparse_points
from lambent_capture.pictures.pictures import read_picture
from numpy import ndarray

from benchmarks.masks import SAMPLE, backgrounds
from benchmarks.painted_scene import paint

QUICK = "{sample} --every 3 --painted table"


@dataclass(frozen=True, slots=True)
class Measured:
    """A capture with references."""

    photographs: list[Photograph]
    points: SparsePoints | None
    reference: Callable[[int], ndarray | None]
    """Returns the true coverage of a view, 0..255, at any size; None where there is none."""


def of_suite(folder: Path, pictures: str, every: int) -> Measured:
    """Return a capture of the tabletop suite with its true cameras."""
    record = json.loads((folder / "truth" / "cameras.json").read_text(encoding="utf-8"))
    names = sorted(path.name for path in (folder / pictures).glob("*.jpg"))[::every]
    photographs = []
    for name in names:
        taken = record["cameras"][name]
        lens = (taken["k1"], taken["k2"])
        camera = PictureCamera(
            width=taken["width"],
            height=taken["height"],
            focal=(taken["focal"], taken["focal"]),
            centre=tuple(taken["centre"]),
            camera_to_world=np.array(taken["camera_to_world"]),
            distortion=lens if any(lens) else (),
        )
        path = folder / pictures / name
        photographs.append(
            Photograph(Path(name).stem, camera, lambda side, path=path: read_picture(path, side=side).srgb())
        )
    masks = folder / "truth" / "masks"
    return Measured(photographs, None, lambda i: cv2.imread(str(masks / f"{photographs[i].name}.png"), 0))


def _read(path: Path, side: int) -> ndarray:
    return read_picture(path, side=side).srgb()


def of_layout(folder: Path, references: Path, every: int) -> Measured:
    """Return a capture in any layout, with references named like its frames."""
    manifest = describe_scene(folder)
    photographs = photographs_of(folder, manifest)[::every]

    def reference(number: int) -> ndarray | None:
        path = references / f"{photographs[number].name}.png"
        return cv2.imread(str(path), 0) if path.is_file() else None

    return Measured(photographs, sparse_points(folder, manifest), reference)


def of_painting(folder: Path, background: str, every: int) -> Measured:
    """Return a capture with alpha in front of a background, without points."""
    environment = SAMPLE / "envmaps" / "morning.hdr"
    painted = paint(folder, backgrounds(folder, environment)[background], every)
    coverages = [np.round(255.0 * each).astype(np.uint8) for each in painted.coverages]
    return Measured(of_pictures(painted.views), None, lambda i: coverages[i])


def measure(capture: Measured, sheet: Path) -> dict[str, object]:
    """Return the overlap with each reference; write a sheet with what is too much red, what is lost blue."""
    began, cpu = time.perf_counter(), time.process_time()
    work = find_object(capture.photographs, capture.points, FindSettings())
    if isinstance(work, str):
        return {"refused": work}
    colours = colours_of(work)
    rows, tiles = [], []
    for number, photograph in enumerate(capture.photographs):
        mask = final_mask(photograph, number, work, colours, FinalSettings())
        reference = capture.reference(number)
        if reference is None:
            continue
        size = reference.shape[::-1]
        mine = cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 127
        true = reference > 127
        both, either = (mine & true).sum(), max((mine | true).sum(), 1)
        extra, lost = (mine & ~true).sum() / max(mine.sum(), 1), (true & ~mine).sum() / max(true.sum(), 1)
        rows.append((both / either, extra, lost))
        tiles.append(_tile(work.pictures[number], mine, true))
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu
    _write_sheet(sheet, tiles)
    overlaps, extra, lost = np.array(rows).T
    return {
        "views": len(rows),
        "support": work.has_support,
        "iou": [round(float(each), 4) for each in overlaps],
        "not_object": float(extra.mean()),
        "lost": float(lost.mean()),
        "agreement": agreement_of(work, FindSettings().plain),
        "seconds": seconds,
        "processor_s": cpu,
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def _tile(picture: ndarray, mine: ndarray, true: ndarray) -> ndarray:
    size = (320, round(320 * picture.shape[0] / picture.shape[1]))
    shown = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    for wrong, colour in ((mine & ~true, (255, 0, 0)), (true & ~mine, (0, 0, 255))):
        shown[cv2.resize(wrong.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0] = colour
    return shown


def _write_sheet(path: Path, tiles: list[ndarray]) -> None:
    height = max(tile.shape[0] for tile in tiles)
    padded = [np.pad(tile, ((0, height - tile.shape[0]), (0, 0), (0, 0))) for tile in tiles]
    padded += [np.zeros_like(padded[0])] * (-len(padded) % 4)
    rows = [np.hstack(padded[start : start + 4]) for start in range(0, len(padded), 4)]
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1])


def row(name: str, found: dict) -> str:
    """Return a line of the table."""
    if "refused" in found:
        return f"| {name} | {found['refused']} | | | | | | | |"
    overlaps, support = np.array(found["iou"]), "yes" if found["support"] else "no"
    return (
        f"| {name} | {found['views']} | {support} | {overlaps.mean():.3f} | {overlaps.min():.3f} "
        f"| {found['not_object']:.3f} | {found['lost']:.3f} | {found['agreement']:.3f} "
        f"| {found['seconds']:.0f} / {found['processor_s']:.0f} |"
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--references", type=Path, help="folder of masks named like the frames")
    parser.add_argument("--photographs", default="photographs", help="of a suite capture: its folder")
    parser.add_argument("--painted", default="", help="background for captures with alpha")
    parser.add_argument("--every", type=int, default=1)


def main(options: argparse.Namespace) -> dict[str, dict]:
    """Measure, print the table, and write sheets of the errors."""
    print(
        "| capture | views | support | mean IoU | worst | not object | lost | agreement | s / processor s |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    record = {}
    for folder in options.captures:
        if (folder / "truth" / "cameras.json").is_file():
            capture = of_suite(folder, options.photographs, options.every)
        elif options.painted:
            capture = of_painting(folder, options.painted, options.every)
        else:
            capture = of_layout(folder, options.references, options.every)
        record[folder.name] = measure(capture, options.out / f"{folder.name}.jpg")
        print(row(folder.name, record[folder.name]), flush=True)
    return record

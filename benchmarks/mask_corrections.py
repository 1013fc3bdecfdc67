"""What a person's marks on a few photographs do for the masks of all of them.

    python -m benchmarks mask_corrections CAPTURE... [--run RUN] [--marked 2 4 8] [-o DIR]

A capture is one of the tabletop suite. Its masks are those that a run has estimated (`--run 'RUNS/{name}'`),
or are estimated here with its true cameras. On photographs evenly spread over the capture, all parts of at
least 30 pixels that are wrong are marked, as the true masks show them. Overlaps are at 640 pixels.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from lambent_capture.masks.corrections import Correction
from lambent_capture.masks.final import preview_masks
from lambent_capture.masks.find import FindSettings, find_object
from lambent_capture.masks.propagate import propagated
from lambent_capture.masks.workspace import Workspace
from lambent_capture.pictures.upright import turned_pixels, upright_turns
from lambent_run.run.folder import task_folder
from lambent_run.run.kept import WORKSPACE
from numpy import ndarray
from PIL import Image
from scipy import ndimage

from benchmarks.photograph_masks import of_suite

QUICK = "tests/data/tabletop/carpet --marked 2"
LEAST_PIXELS = 30


def estimated(folder: Path, run: Path | None) -> Workspace:
    """Return the estimate of a run, or one that is made here."""
    if run is not None:
        return Workspace.load(task_folder(run, "masks") / WORKSPACE)
    capture = of_suite(folder, "photographs", 1)
    work = find_object(capture.photographs, capture.points, FindSettings())
    if isinstance(work, str):
        raise SystemExit(f"{folder}: {work}")
    return work


def true_masks(work: Workspace, folder: Path) -> list[ndarray]:
    """Return the true masks of all photographs, upright, at the size of the estimate."""
    masks = []
    for number, name in enumerate(work.names):
        height, width = upright(work, number, work.pictures[number]).shape[:2]
        with Image.open(folder / "truth" / "masks" / f"{name}.png") as image:
            masks.append(np.asarray(image.resize((width, height), Image.Resampling.BOX)) > 127)
    return masks


def upright(work: Workspace, number: int, pixels: ndarray) -> ndarray:
    """Return pixels of a photograph as it is shown; captures with true cameras are upright already."""
    return turned_pixels(pixels, upright_turns(work.cameras[number].camera_to_world))


def marks_on(work: Workspace, number: int, found: ndarray, true: ndarray) -> list[Correction]:
    """Return strokes over everything that is wrong in an upright mask, every second row."""
    camera = work.cameras[number]
    scale = max(camera.width, camera.height) / max(found.shape)
    marks = []
    for is_object, wrong in ((True, true & ~found), (False, found & ~true)):
        labels, count = ndimage.label(ndimage.binary_erosion(wrong))
        for label in range(1, count + 1):
            part = labels == label
            if part.sum() < LEAST_PIXELS:
                continue
            for row in np.flatnonzero(part.any(axis=1))[::2]:
                ends = scale * (np.flatnonzero(part[row])[[0, -1]] + 0.5)
                points = tuple((float(x), float(scale * (row + 0.5))) for x in ends)
                marks.append(
                    Correction(
                        frame=work.names[number], is_object=is_object, points=points, radius=float(scale)
                    )
                )
    return marks


def overlaps(work: Workspace, found: Sequence[ndarray], true: Sequence[ndarray]) -> ndarray:
    """Return the IoU of each photograph's mask."""
    mine = [upright(work, number, mask) for number, mask in enumerate(found)]
    return np.array([(a & b).sum() / max((a | b).sum(), 1) for a, b in zip(mine, true, strict=True)])


def measure(work: Workspace, true: Sequence[ndarray], counts: Sequence[int]) -> list[dict]:
    """Return what each number of marked photographs leads to, beginning with none."""
    first = preview_masks(work)
    before = overlaps(work, first, true)
    rows = [{"marked": 0, "mean": before.mean(), "worst": before.min()}]
    for count in counts:
        chosen = np.linspace(0, len(work.names), count, endpoint=False).astype(int)
        marks = [mark for n in chosen for mark in marks_on(work, n, upright(work, n, first[n]), true[n])]
        began = time.perf_counter()
        after = overlaps(work, preview_masks(propagated(work, marks)), true)
        others = np.delete(after, chosen)
        rows.append(
            {
                "marked": count,
                "strokes": len(marks),
                "mean": after.mean(),
                "worst": after.min(),
                "others": others.mean(),
                "seconds": time.perf_counter() - began,
            }
        )
    return [{key: float(value) for key, value in row.items()} for row in rows]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument(
        "--run", default="", help='run folder with estimated masks, "{name}" for the capture\'s name'
    )
    parser.add_argument("--marked", type=int, nargs="+", default=[2, 4, 8], help="numbers of photographs")


def main(options: argparse.Namespace) -> dict[str, list[dict]]:
    """Measure and print a table for each capture."""
    record = {}
    print("| capture | marked | mean IoU | worst | mean of the others | seconds |")
    print("| --- | --- | --- | --- | --- | --- |")
    for folder in options.captures:
        run = Path(options.run.format(name=folder.name)) if options.run else None
        work = estimated(folder, run)
        record[folder.name] = measure(work, true_masks(work, folder), options.marked)
        for row in record[folder.name]:
            print(
                f"| {folder.name} | {row['marked']:.0f} | {row['mean']:.3f} | {row['worst']:.3f} "
                f"| {row.get('others', float('nan')):.3f} | {row.get('seconds', 0.0):.1f} |",
                flush=True,
            )
    return record

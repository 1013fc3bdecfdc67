"""Captures of every combination, drawn at random: `python -m tests.strangers.fuzz --count 5000 --seed 1`.

The light that training would see must be the reference's, or one error names file, cause and remedy; check,
masks, cameras, silhouettes and textures must see what training sees. Prints a table and, for each fault, what
makes it again.
"""

import argparse
import random
import shutil
import sys
import tempfile
import time
import warnings
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from strangers import reading
from strangers.captures import LAYOUTS, MASKED_LAYOUTS, Case, write_capture
from strangers.masks import MASKS
from strangers.pictures import Spec
from strangers.statements import STATEMENTS

DEPTHS = {
    "png": ("8", "8", "16"),
    "tiff": ("8", "16"),
    "heic": ("8", "10"),
    "avif": ("8", "10"),
    "exr": ("half", "float"),
}
ALPHAS = {
    "png": ("none", "straight", "palette", "key"),
    "webp": ("none", "straight"),
    "tiff": ("none", "straight", "premultiplied"),
    "avif": ("none", "straight"),
    "heic": ("none", "straight"),
    "exr": ("none", "premultiplied", "premultiplied"),
}
MOST_SMALLER = 40
"""Kinds of fault of which the plainest capture is looked for."""
FAULTS = (reading.SILENT, reading.TRACEBACK, reading.UNCLEAR)


def case_of(number: int, seed: int) -> Case:
    """Return the capture of a number; the same for the same seed."""
    choice = random.Random(f"{seed}/{number}")  # noqa: S311
    kind = choice.choice(tuple(STATEMENTS))
    colour = choice.choice(tuple(STATEMENTS[kind]))
    alpha = choice.choice(ALPHAS.get(kind, ("none",)))
    depth = choice.choice(DEPTHS.get(kind, ("8",)))
    grey = STATEMENTS[kind][colour].grey
    if alpha == "palette" and (depth != "8" or grey):
        alpha = "straight"
    layout = choice.choice(LAYOUTS)
    orientation = 1
    if kind not in ("exr", "hdr") and choice.random() < 0.4:
        # Mirrored photographs with cameras are refused whatever else is true of them.
        orientation = choice.choice((3, 6, 8, 3, 6, 8, 2, 4, 5, 7))
    if kind == "avif" and (orientation != 1 or STATEMENTS[kind][colour].icc):
        depth = "8"  # what writes ten bits writes neither a turn nor a profile
    mask, upright = "none", False
    if layout in MASKED_LAYOUTS and choice.random() < 0.45:
        mask = choice.choice(tuple(MASKS))
        upright = choice.random() < 0.5
    if orientation != 1:
        alpha = "none" if mask != "none" else alpha
        # Where readers differ in turning, only pictures that keep their size fit the size of a camera.
        if kind == "avif":
            mask = "none"
            if layout.startswith("colmap") or layout == "photographs":
                orientation = choice.choice((2, 3, 4))
    return Case(
        spec=Spec(format=kind, depth=depth, colour=colour, alpha=alpha, orientation=orientation),
        layout=layout,
        mask=mask,
        painted_upright=upright,
        seed=number,
        count=choice.choice((3, 3, 4)),
    )


def outcome_of(case: Case, folder: Path) -> reading.Outcome:
    """Return what became of a case written to a folder, which is emptied before."""
    for place in (folder, folder.with_name(folder.name + "-cameras")):
        shutil.rmtree(place, ignore_errors=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of libraries that write
        return reading.outcome_of(write_capture(folder, case))


def smaller(case: Case, kind: str, folder: Path) -> Case:
    """Return a case with as little that is unusual as has the same kind of fault."""
    simpler = [
        lambda c: replace(c, mask="none", painted_upright=False),
        lambda c: replace(c, spec=replace(c.spec, orientation=1), painted_upright=False),
        lambda c: replace(c, spec=replace(c.spec, alpha="none")),
        lambda c: replace(c, spec=replace(c.spec, colour="none")),
        lambda c: replace(c, spec=replace(c.spec, depth="half" if c.spec.format == "exr" else "8")),
        lambda c: replace(c, layout="nerfstudio"),
        lambda c: (
            replace(c, spec=replace(c.spec, format="png"))
            if c.spec.colour == "none" and c.spec.depth == "8" and c.spec.alpha in ("none", "straight")
            else c
        ),
        lambda c: replace(c, count=3),
    ]
    for change in simpler:
        tried = change(case)
        if tried != case and outcome_of(tried, folder).kind == kind:
            case = tried
    return case


def features(case: Case) -> str:
    """Return what makes a case special, to group faults by."""
    mask = f"mask {case.mask}{' upright' if case.painted_upright else ''}" if case.mask != "none" else ""
    turn = f"orientation {case.spec.orientation}" if case.spec.orientation != 1 else ""
    colour = case.spec.colour if case.spec.colour != "none" else ""
    alpha = f"alpha {case.spec.alpha}" if case.spec.alpha != "none" else ""
    parts = (f"{case.spec.format} {case.spec.depth}", colour, alpha, turn, mask, case.layout)
    return ", ".join(part for part in parts if part)


def main() -> int:
    """Read captures and print what became of them; 1 where there are faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first capture")
    parser.add_argument("--keep", type=Path, help="folder for the captures with faults")
    arguments = parser.parse_args()
    totals: Counter[str] = Counter()
    refusals: Counter[str] = Counter()
    first: dict[str, int] = {}
    faults: dict[str, list[str]] = defaultdict(list)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="strangers-") as work:
        for number in range(arguments.first, arguments.first + arguments.count):
            case = case_of(number, arguments.seed)
            found = outcome_of(case, Path(work) / "scene")
            totals[found.kind] += 1
            if sum(totals.values()) % 250 == 0:
                print(dict(totals), file=sys.stderr, flush=True)
            if found.kind == reading.REFUSED:
                code = found.why.split(": ")[0]
                meant = "as it must" if not case.spec.statement.means else "though readable"
                refusals[f"{code} {meant}"] += 1
                first.setdefault(f"{code} {meant}", number)
            if found.kind in FAULTS:
                least = case
                if len(faults) < MOST_SMALLER:
                    least = smaller(case, found.kind, Path(work) / "scene")
                key = f"{found.kind}: {features(least)}"
                if key not in faults:
                    found = outcome_of(least, Path(work) / "scene")
                    if arguments.keep is not None:
                        shutil.copytree(Path(work) / "scene", arguments.keep / str(number))
                    print(f"{key}\n    {found.why}\n    again: {least!r}", flush=True)
                faults[key].append(str(number))
    seconds = time.monotonic() - began
    print(f"\n{arguments.count} captures in {seconds:.0f} s, seed {arguments.seed}")
    for kind in (reading.RIGHT, reading.REFUSED, *FAULTS):
        print(f"{kind:>10} {totals[kind]:6d}")
    for name, count in refusals.most_common():
        print(f"  refused {count:6d} {name} (capture {first[name]})")
    for name, numbers in sorted(faults.items(), key=lambda item: -len(item[1])):
        print(f"  {len(numbers):6d} {name} (capture {numbers[0]})")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

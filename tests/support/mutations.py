"""Sound files changed at random: `python tests/support/mutations.py --count N --seed S`.

Every mutant is given to the reader that people would give it to: an archive is uploaded, committed and
checked as a capture, a capture is checked, an environment is uploaded and read, a bundle is opened. The last
line of the output is JSON; mutants with faults are written to `--keep`.
"""

import argparse
import json
import os
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import structlog

sys.path.insert(0, str(Path(__file__).parents[1]))

from support import hostile_client, hostile_readers
from support.archives import make_tar, make_zip, tar_member
from support.captures import write_blender, write_tensoir
from support.hostile_pictures import HDR, exr
from support.hostile_runs import Verdict
from support.layouts import (
    ColmapBinaryFolder,
    ColmapTextFolder,
    GlossyFolder,
    NerfstudioFolder,
    OpenIlluminationFolder,
)
from support.photographs import heif, view
from support.raw_files import write_dng

_NUMBERS = (
    b"-1",
    b"0",
    b"1e999",
    b"NaN",
    b"1e-320",
    b"9" * 400,
    b'""',
    b"null",
    b"[]",
    b"{}",
    b"[[[[[[",
    b"true",
)
_WORDS = (
    0,
    1,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    2**40,
    2**63 - 1,
    2**64 - 1,
)
SHARES = {"archive": 0.3, "capture": 0.35, "environment": 0.15, "bundle": 0.2}
"""Parts of the mutants of each family."""


def mutate(data: bytes, choice: random.Random) -> bytes:
    """Return the bytes with one to five changes."""
    changed = bytearray(data)
    for _ in range(choice.choice((1, 1, 1, 2, 3, 5))):
        if not changed:
            break
        place = choice.randrange(len(changed))
        # Headers decide more than what follows them.
        if choice.random() < 0.4:
            place = choice.randrange(min(len(changed), 256))
        what = choice.random()
        if what < 0.25:
            changed[place] ^= 1 << choice.randrange(8)
        elif what < 0.4:
            changed[place] = choice.randrange(256)
        elif what < 0.6:
            size = choice.choice((2, 4, 4, 8))
            value = (choice.choice(_WORDS) & (256**size - 1)).to_bytes(size, choice.choice(("little", "big")))
            changed[place : place + size] = value
        elif what < 0.7:
            del changed[place : place + choice.randint(1, 60)]
        elif what < 0.78:
            del changed[place:]
        elif what < 0.88:
            changed[place:place] = changed[max(place - 40, 0) : place] * choice.choice((1, 1, 50))
        else:
            numbers = list(re.finditer(rb"-?\d+\.?\d*(e-?\d+)?", bytes(changed[:100_000])))
            if numbers:
                found = choice.choice(numbers)
                changed[found.start() : found.end()] = choice.choice(_NUMBERS)
    return bytes(changed)


@dataclass(frozen=True, slots=True)
class Base:
    """A sound file, or a folder of which one file is changed at a time."""

    family: str
    name: str
    read: Callable[[str, Path], Verdict]
    place: Path
    relist: bool = False
    """Whether the manifest is made to fit again, so that the reader gets further."""


def _photographs(folder: Path) -> None:
    folder.mkdir(parents=True)
    heif()
    for index, suffix in enumerate((".jpg", ".png", ".webp", ".heic", ".jpg")):
        view(index).save(folder / f"{index}{suffix}")
    pixels = np.random.default_rng(1).random((120, 160, 3)) * 0.8
    (folder / "5.exr").write_bytes(exr(pixels))
    (folder / "6.hdr").write_bytes(HDR + b"-Y 120 +X 160\n" + np.random.default_rng(2).bytes(120 * 160 * 4))
    write_dng(folder / "7.dng", pixels)


def bases(folder: Path) -> list[Base]:
    """Return the sound files, written to `folder`."""
    found = []
    layouts = {
        "blender": lambda place: write_blender(place, num_train=3, num_test=1),
        "tensoir": lambda place: write_tensoir(place, num_train=3, num_test=1),
        "nerfstudio": NerfstudioFolder,
        "colmap binary": ColmapBinaryFolder,
        "colmap text": ColmapTextFolder,
        "openillumination": OpenIlluminationFolder,
        "glossy": GlossyFolder,
        "photographs": _photographs,
    }
    for name, write in layouts.items():
        write(folder / "captures" / name)
        found.append(Base("capture", name, hostile_readers.read_capture, folder / "captures" / name))
    whole = {
        path.relative_to(folder / "captures" / "blender").as_posix(): path.read_bytes()
        for path in sorted((folder / "captures" / "blender").rglob("*"))
        if path.is_file()
    }
    tar = make_tar(*(tar_member(name, data) for name, data in whole.items()))
    archives = {"zip": make_zip(whole), "tar": tar, "tar.gz": _gzip(tar)}
    skies = {
        "exr": exr(np.random.default_rng(3).random((16, 32, 3))),
        "hdr": HDR + b"-Y 16 +X 32\n" + np.random.default_rng(4).bytes(16 * 32 * 4),
    }
    for family, files, read in (
        ("archive", archives, lambda name, path: hostile_readers.read_archive(name, path.read_bytes())),
        ("environment", skies, lambda name, path: hostile_readers.read_environment(name, path.read_bytes())),
    ):
        for name, data in files.items():
            place = folder / family / name / f"file.{name}"
            place.parent.mkdir(parents=True)
            place.write_bytes(data)
            found.append(Base(family, name, read, place))
    bundle = hostile_client.unpack(folder / "bundle")
    shutil.rmtree(bundle / "uncertainty")
    path = bundle / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["files"] = [each for each in manifest["files"] if not each["path"].startswith("uncertainty")]
    manifest.pop("uncertainty", None)
    path.write_text(json.dumps(manifest))
    packed = folder / "packed" / "file.zip"
    packed.parent.mkdir()
    packed.write_bytes(hostile_client.packed(bundle))

    def read_bundle(name: str, place: Path) -> Verdict:
        return hostile_readers.read_bundle(name, place, deep=False)

    found.append(Base("bundle", "folder", read_bundle, bundle, relist=True))
    found.append(Base("bundle", "zip", read_bundle, packed))
    return found


def _gzip(data: bytes) -> bytes:
    import gzip

    return gzip.compress(data, mtime=0)


def run_one(base: Base, seed: int, work: Path) -> tuple[Verdict, Path]:
    """Return what became of a mutant of `base`, and where it is."""
    choice = random.Random(f"{base.family}/{base.name}/{seed}")  # noqa: S311
    place = work / base.place.name
    with suppress(FileNotFoundError):
        shutil.rmtree(place) if place.is_dir() else place.unlink()
    if base.place.is_file():
        place.write_bytes(mutate(base.place.read_bytes(), choice))
        return base.read(f"{base.name} {seed}", place), place
    # Links instead of copies: only what is changed is written anew.
    shutil.copytree(base.place, place, copy_function=os.link)
    files = sorted(path for path in place.rglob("*") if path.is_file())
    # Files that say how others are read, rather than one of many pictures.
    leading = [path for path in files if path.suffix in (".json", ".txt", ".bin", ".pkl", ".onnx", ".glb")]
    target = choice.choice(leading if leading and choice.random() < 0.5 else files)
    data = mutate(target.read_bytes(), choice)
    target.unlink()
    target.write_bytes(data)
    if base.relist and target.name != "manifest.json":
        manifest = place / "manifest.json"
        text = manifest.read_bytes()
        manifest.unlink()
        manifest.write_bytes(text)
        hostile_client.relist(place)
    return base.read(f"{base.name}: {target.relative_to(place)} {seed}", place), place


def main() -> int:
    """Run the mutants and print what became of them; the exit code is 1 if there were faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant, to continue with")
    parser.add_argument("--keep", type=Path, help="folder for mutants with faults")
    given = parser.parse_args()
    structlog.configure(processors=[_drop])
    hostile_readers.warm_up()
    began, cpu_s, grown = time.monotonic(), 0.0, 0
    outcomes: Counter[str] = Counter()
    codes: Counter[str] = Counter()
    spent: Counter[str] = Counter()
    faults: list[str] = []
    slowest = (0.0, "")
    with tempfile.TemporaryDirectory(prefix="mutations-") as name:
        found = bases(Path(name) / "bases")
        work = Path(name) / "work"
        work.mkdir()
        choice = random.Random(given.seed)  # noqa: S311
        for number in range(given.first + given.count):
            family = choice.choices(list(SHARES), list(SHARES.values()))[0]
            base = choice.choice([each for each in found if each.family == family])
            if number < given.first:
                continue
            verdict, place = run_one(base, given.seed * 10_000_019 + number, work)
            cpu_s += verdict.cpu_s
            grown = max(grown, verdict.grown_kib)
            slowest = max(slowest, (round(verdict.cpu_s, 2), verdict.name))
            spent[f"{family} {base.name}"] += verdict.cpu_s
            outcomes[f"{family} {'refused' if verdict.refused else 'usable'}"] += 1
            codes.update(set(verdict.codes))
            for fault in hostile_readers.faults_of(verdict):
                faults.append(f"{number} {verdict.name}: {fault}")
                print(faults[-1], flush=True)
                _keep(given.keep, number, place)
    print(
        json.dumps(
            {
                "mutants": given.count,
                "seed": given.seed,
                "first": given.first,
                "outcomes": dict(sorted(outcomes.items())),
                "faults": len(faults),
                "stopped": codes["stopped"],
                "codes": len(codes),
                "largest_growth_mib": grown // 1024,
                "slowest": slowest,
                "cpu_s": round(cpu_s + time.process_time(), 1),
                "spent_s": {name: round(value, 1) for name, value in spent.most_common()},
                "wall_s": round(time.monotonic() - began, 1),
            }
        )
    )
    return bool(faults)


def _keep(folder: Path | None, number: int, place: Path) -> None:
    if folder is None:
        return
    target = folder / str(number)
    target.mkdir(parents=True, exist_ok=True)
    if place.is_dir():
        shutil.copytree(place, target / place.name, dirs_exist_ok=True)
    else:
        shutil.copy(place, target)


def _drop(*_: object) -> None:
    raise structlog.DropEvent


if __name__ == "__main__":
    # What libraries say to the screen about damaged files is not what is looked for.
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    sys.exit(main())

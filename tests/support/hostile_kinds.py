"""Gives every hostile file of the catalogue to its reader: `python tests/support/hostile_kinds.py`.

Each line of the output is JSON: the kind, what became of it, and what should not have happened.
"""

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import structlog

sys.path.insert(0, str(Path(__file__).parents[1]))

from support import hostile_archives, hostile_client, hostile_pictures, hostile_poses, hostile_readers
from support.hostile_runs import Verdict

USABLE = ""
"""Among the expected codes: the file may be accepted as well."""


def kinds(work: Path) -> Iterator[tuple[str, Callable[[], Verdict], set[str]]]:
    """Yield the name of each kind, what reads it, and the codes of which one is expected."""
    read = hostile_readers
    for name, (make, codes) in hostile_archives.ARCHIVES.items():
        yield f"archive: {name}", lambda n=name, m=make: read.read_archive(n, m()), codes or {USABLE}
    for area, found in (("picture", hostile_pictures.CAPTURES), ("cameras", hostile_poses.CAPTURES)):
        for name, (write, codes) in found.items():
            yield f"{area}: {name}", lambda n=name, w=write: _capture(n, w, work / "capture"), codes
    golden = hostile_client.unpack(work / "golden")
    for name, (change, codes) in hostile_client.BUNDLES.items():
        yield f"bundle: {name}", lambda n=name, c=change: _bundle(n, c, golden, work / "bundle"), codes
    for name, (make, codes) in hostile_client.ARCHIVES.items():
        yield f"packed bundle: {name}", lambda n=name, m=make: _packed(n, m(), work / "x.relight.zip"), codes
    for name, (suffix, make, codes) in hostile_client.LIGHTS.items():
        yield f"light: {name}", lambda n=name, s=suffix, m=make: _light(n, m(), work / f"sky.{s}"), codes
        data = make
        yield f"environment: {name}", lambda n=name, m=data: read.read_environment(n, m()), codes
    for name, (text, codes) in hostile_client.CAMERAS.items():
        yield f"list of cameras: {name}", lambda n=name, t=text: read.read_cameras(n, t), codes


def _capture(name: str, write: Callable[[Path], object], folder: Path) -> Verdict:
    with suppress(FileNotFoundError):
        shutil.rmtree(folder)
    write(folder)
    return hostile_readers.read_capture(name, folder)


def _bundle(name: str, change: Callable[[Path], object], golden: Path, folder: Path) -> Verdict:
    with suppress(FileNotFoundError):
        shutil.rmtree(folder)
    shutil.copytree(golden, folder)
    change(folder)
    return hostile_readers.read_bundle(name, folder)


def _packed(name: str, data: bytes, path: Path) -> Verdict:
    path.write_bytes(data)
    return hostile_readers.read_bundle(name, path)


def _light(name: str, data: bytes, path: Path) -> Verdict:
    path.write_bytes(data)
    return hostile_readers.read_light(name, path)


def faults(name: str, verdict: Verdict, codes: set[str]) -> list[str]:
    """Return what should not have happened to a kind of which one of `codes` is expected."""
    found = list(hostile_readers.faults_of(verdict))
    named = codes - {USABLE}
    # The client's own readers are asked for an error of theirs, whichever.
    if name.startswith(("light", "list of cameras", "bundle: ")) and not named and not verdict.refused:
        found.append("accepted")
    if USABLE not in codes and not named & set(verdict.codes):
        found.append(f"expected one of {sorted(named)}, found {verdict.codes[:5]}")
    files = ("hostile", "r_1")
    if (
        name.startswith("picture")
        and named == codes
        and not any(verdict.names(file, named) for file in files)
    ):
        found.append("no finding names the file")
    return found


def main() -> None:
    """Print a line for each kind."""
    structlog.configure(processors=[_drop])
    hostile_readers.warm_up()
    with tempfile.TemporaryDirectory(prefix="kinds-") as name:
        for kind, read, codes in kinds(Path(name)):
            verdict = read()
            wrong = faults(kind, verdict, codes)
            told = {"refused": verdict.refused, "codes": verdict.codes[:8], "faults": wrong}
            print(
                json.dumps({"kind": kind, **told, "cpu_s": verdict.cpu_s, "mib": verdict.grown_kib // 1024})
            )
            sys.stdout.flush()


def _drop(*_: object) -> None:
    raise structlog.DropEvent


if __name__ == "__main__":
    with suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    main()

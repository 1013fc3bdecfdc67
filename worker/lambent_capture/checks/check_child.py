"""The child process of `check`: reads an order on standard input, writes lines to standard output.

Lines are `reading "path"` before each file is decoded; `left_out ["path", ...]`; where the capture can be
used `figures {CaptureFigures as ProtoJSON}`, `thumbnail {"name", "jpeg"}` for each frame and
`portrait "jpeg"`; and at the end `report {SceneReport}`. Instead of all of them, `refused "why"` where layers
are missing that have to be there, `broken "why"` where a library cannot be loaded, and `failed "why"` where a
reader raises what it should have made a finding of.
"""

import importlib
import json
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from google.protobuf.json_format import MessageToDict
from lambent_proto.v1 import capture_pb2, scene_pb2
from lambent_sandbox.sandbox import EXIT_BROKEN, EXIT_REFUSED, Limits, SandboxError, enter

MAX_OPEN_FILES = 256
READERS = ("lambent_capture.checks.photograph_check", "lambent_capture.checks.review")
"""Modules that import everything that looks at files."""
MAX_REASON_CHARACTERS = 300


def main() -> None:
    """Check the folder that the order on standard input names."""
    order: dict[str, Any] = json.load(sys.stdin)
    folder, layout = Path(order["folder"]), order["layout"]
    masks, cameras = (None if order[name] is None else Path(order[name]) for name in ("masks", "cameras"))
    limits = Limits(memory_bytes=order["memory_bytes"], cpu_s=order["cpu_s"], open_files=MAX_OPEN_FILES)
    readable = [each for each in (folder, masks, cameras) if each is not None]
    # Before anything that reads pictures is even loaded.
    try:
        enter(limits, order["sandbox"], readable=readable)
    except SandboxError as error:
        tell("refused", str(error))
        sys.exit(EXIT_REFUSED)
    try:
        for name in READERS:
            importlib.import_module(name)
    except MemoryError:
        raise
    except Exception as error:  # Whatever a library raises that does not find itself.
        tell("broken", f"{type(error).__name__}: {error}"[:MAX_REASON_CHARACTERS])
        sys.exit(EXIT_BROKEN)
    try:
        check(folder, layout, masks, cameras, order["killers"])
    except MemoryError:
        raise
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(place.filename).name}:{place.lineno}"
        tell("failed", f"{type(error).__name__}: {error} ({where})"[:MAX_REASON_CHARACTERS])
        raise


def check(
    folder: Path, layout: str | None, masks: Path | None, cameras: Path | None, killers: Mapping[str, str]
) -> None:
    """Look at a capture and tell what was found."""
    from lambent_core.layouts import PHOTOGRAPHS

    from lambent_capture.checks.photograph_check import check_photographs
    from lambent_capture.layouts.detect import detect_layout
    from lambent_capture.loading.inspect import inspect_files

    if cameras is None and (layout or detect_layout(folder)) == PHOTOGRAPHS:
        looked = check_photographs(folder, masks, killers, announce)
        tell("left_out", looked.left_out)
        if looked.figures is not None:
            tell_measured(looked.figures, looked.thumbnails, looked.portrait)
        tell("report", MessageToDict(looked.report))
        return
    inspection = inspect_files(folder, layout, killers, announce, masks, cameras)
    report, manifest = inspection.report, inspection.manifest
    tell("left_out", inspection.left_out)
    if manifest is not None and report.usable:
        measure(folder, manifest, report)
    tell("report", MessageToDict(report))


def tell(kind: str, value: object) -> None:
    """Write one line of the answer."""
    print(kind, json.dumps(value), flush=True)


def announce(path: str) -> None:
    """Announce the file that is read next; empty if none is."""
    tell("reading", path)


def measure(folder: Path, manifest: scene_pb2.SceneManifest, report: scene_pb2.SceneReport) -> None:
    """Measure a capture that can be used, tell its figures, and add to `report` what they mean."""
    from lambent_capture.checks.limits import CaptureLimits
    from lambent_capture.checks.review import review

    examination = review(folder, manifest, report, CaptureLimits(), announce)
    tell_measured(examination.figures, examination.thumbnails, examination.portrait)


def tell_measured(figures: capture_pb2.CaptureFigures, thumbnails: Mapping[str, str], portrait: str) -> None:
    """Write the figures and the small pictures of a capture that can be used."""
    tell("figures", MessageToDict(figures))
    for name, jpeg in thumbnails.items():
        tell("thumbnail", {"name": name, "jpeg": jpeg})
    tell("portrait", portrait)


if __name__ == "__main__":
    main()

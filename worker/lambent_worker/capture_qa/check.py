"""Checks a capture before training, in a child process with restricted rights.

The child may use 2 GiB of address space, ten minutes of processor time, and cannot write files. A picture
that crashes it is left out, and the rest is checked without it: where others make up for it, the capture can
be used, and `CaptureCheck.left_out` tells what to leave out in training too.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from google.protobuf import json_format
from lambent_proto.v1 import capture_pb2, scene_pb2

from lambent_worker.capture_qa.check_result import CaptureCheck
from lambent_worker.scenes.detect import require_layout
from lambent_worker.scenes.problems import Problems

MAX_MEMORY_BYTES = 2 * 2**30
MAX_CPU_S = 600
MAX_WALL_S = 900
MAX_DEATHS = 5
"""Maximum number of files that may crash the child before the check gives up."""
MAX_THUMBNAIL_CHARACTERS = 64 * 1024
MAX_PORTRAIT_CHARACTERS = 256 * 1024
_BASE64 = re.compile(r"[A-Za-z0-9+/]+={0,2}")


def check_capture(
    folder: Path, layout: str | None = None, masks: Path | None = None, cameras: Path | None = None
) -> CaptureCheck:
    """Return the report on the capture in `folder` (at most 100 findings), with measurements if it is usable.

    `layout` forces a layout instead of detecting it, `masks` is a folder of masks named like the pictures,
    `cameras` one of cameras that were found for photographs; without, these are looked at one by one. An
    unknown layout is a `UsageError`. Nothing a capture holds makes this function raise.
    """
    require_layout(layout)
    killers: list[str] = []
    for _ in range(MAX_DEATHS):
        check, reading = _run_child(folder, layout, masks, cameras, killers)
        if check is not None:
            return check
        if not reading or reading in killers:
            break
        killers.append(reading)
    problems = Problems()
    problems.error(
        "scene.check_failed",
        "the check needed more memory or time than it may use"
        + (f" while reading {', '.join(killers)}" if killers else "")
        + "; reduce the number or the size of the files",
    )
    report = scene_pb2.SceneReport(usable=False, layout=layout or "", findings=problems.findings())
    return CaptureCheck(report=report)


def _run_child(
    folder: Path, layout: str | None, masks: Path | None, cameras: Path | None, killers: list[str]
) -> tuple[CaptureCheck | None, str | None]:
    """Return the child's result, or None and the file it was reading when it crashed."""
    order = {
        "folder": str(folder.resolve()),
        "layout": layout,
        "masks": None if masks is None else str(masks.resolve()),
        "cameras": None if cameras is None else str(cameras.resolve()),
        "killers": killers,
        "memory_bytes": MAX_MEMORY_BYTES,
        "cpu_s": MAX_CPU_S,
    }
    try:
        child = subprocess.run(
            [sys.executable, "-I", "-B", "-m", "lambent_worker.capture_qa.check_child"],
            input=json.dumps(order),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=MAX_WALL_S,
            check=False,
            env={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PATH": os.environ.get("PATH", "")},
        )
        output = child.stdout
    except subprocess.TimeoutExpired as expired:
        output = (expired.stdout or b"").decode(errors="replace")
    reading, figures = None, None
    thumbnails: dict[str, str] = {}
    portrait = ""
    left_out: tuple[str, ...] = ()
    for line in output.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "report":
            report = json_format.Parse(rest, scene_pb2.SceneReport())
            check = CaptureCheck(
                report=report, figures=figures, thumbnails=thumbnails, portrait=portrait, left_out=left_out
            )
            return check, None
        if kind == "left_out":
            left_out = tuple(str(path) for path in json.loads(rest))
        if kind == "figures":
            figures = json_format.Parse(rest, capture_pb2.CaptureFigures())
        if kind == "thumbnail":
            thumbnails |= _thumbnail(json.loads(rest))
        if kind == "portrait":
            portrait = _jpeg(json.loads(rest), MAX_PORTRAIT_CHARACTERS) or ""
        if kind == "reading":
            reading = json.loads(rest)
    return None, reading


def _thumbnail(value: dict[str, Any]) -> dict[str, str]:
    """Return a thumbnail by its frame, if it is valid: the child has read untrusted files."""
    name, data = value.get("name"), _jpeg(value.get("jpeg"), MAX_THUMBNAIL_CHARACTERS)
    return {name: data} if isinstance(name, str) and data is not None else {}


def _jpeg(data: object, max_characters: int) -> str | None:
    """Return a small picture in base64, if that is what the child has sent."""
    if not isinstance(data, str) or len(data) > max_characters:
        return None
    # "/9j/" begins every JPEG.
    return data if data.startswith("/9j/") and _BASE64.fullmatch(data) else None

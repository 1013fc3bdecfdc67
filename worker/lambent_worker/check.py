"""Looks at a capture before any training, in a child process that cannot harm anyone.

The child may use 2 GiB of address space, ten minutes of processor time, and cannot write files. A picture
that makes it die is named, left out, and the rest is checked without it.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

from google.protobuf import json_format
from lambent_proto.v1 import scene_pb2

from lambent_worker.errors import UsageError
from lambent_worker.scenes.detect import LAYOUTS
from lambent_worker.scenes.problems import Problems

MAX_MEMORY_BYTES = 2 * 2**30
MAX_CPU_S = 600
MAX_WALL_S = 900
MAX_DEATHS = 5
"""Files that may kill the child before the check gives up."""


def check_scene(folder: Path, layout: str | None = None) -> scene_pb2.SceneReport:
    """Return what is wrong with the capture in `folder`: every problem, at most 100.

    `layout` forces a layout instead of detecting it; an unknown name is a `UsageError`. Nothing a capture
    holds makes this function raise.
    """
    if layout is not None and layout not in LAYOUTS:
        raise UsageError(
            "scene.layout_unknown",
            f'--layout "{layout}" is none of {", ".join(LAYOUTS)}; choose one of these',
        )
    killers: list[str] = []
    for _ in range(MAX_DEATHS):
        report, reading = _run_child(folder, layout, killers)
        if report is not None:
            return report
        if reading is None or reading in killers:
            break
        killers.append(reading)
    problems = Problems()
    problems.error(
        "scene.check_failed",
        "the check needed more memory or time than it may use"
        + (f" while reading {', '.join(killers)}" if killers else "")
        + "; reduce the number or the size of the files",
    )
    return scene_pb2.SceneReport(usable=False, layout=layout or "", findings=problems.findings())


def _run_child(
    folder: Path, layout: str | None, killers: list[str]
) -> tuple[scene_pb2.SceneReport | None, str | None]:
    """Return the child's report, or None and the file it was reading when it died."""
    task = {
        "folder": str(folder.resolve()),
        "layout": layout,
        "killers": killers,
        "memory_bytes": MAX_MEMORY_BYTES,
        "cpu_s": MAX_CPU_S,
    }
    try:
        child = subprocess.run(
            [sys.executable, "-I", "-B", "-m", "lambent_worker.check_child"],
            input=json.dumps(task),
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
    reading = None
    for line in output.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "report":
            return json_format.Parse(rest, scene_pb2.SceneReport()), None
        if kind == "reading":
            reading = json.loads(rest)
    return None, reading

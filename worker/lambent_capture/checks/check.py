"""Checks a capture before training, in a child process with restricted rights.

The child may use 2 GiB of address space and ten minutes of processor time. It reads files of the capture and
of the program and no others, cannot write files, and has neither network nor other programs; LAMBENT_SANDBOX
says what happens where the system cannot ensure all of that (`lambent_sandbox.sandbox`). A picture that
crashes it is left out, and the rest is checked without it: where others make up for it, the capture can
be used, and `CaptureCheck.left_out` tells what to leave out in training too.
"""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from google.protobuf import json_format
from lambent_compute.group_signals import GROUP_SIGNALS, held_back
from lambent_core.errors import UsageError, WorkerError
from lambent_proto.v1 import capture_pb2, scene_pb2
from lambent_sandbox.sandbox import (
    AVAILABLE,
    EXIT_BROKEN,
    EXIT_REFUSED,
    LIMITS,
    REQUIRED,
    STRICTNESS,
    SandboxError,
    require_apart,
)

from lambent_capture.checks.check_child import MAX_REASON_CHARACTERS
from lambent_capture.checks.check_result import CaptureCheck
from lambent_capture.layouts.detect import require_layout
from lambent_capture.pictures.picture_error import SKIPPED, STOPPED, TOO_LARGE
from lambent_capture.problems import MAX_FINDINGS, Problems

MAX_MEMORY_BYTES = 2 * 2**30
MAX_CPU_S = 600
MAX_WALL_S = 900
MAX_DEATHS = 5
"""Maximum number of files that may crash the child before the check gives up."""
MAX_OUTPUT_BYTES = 64 * 2**20
MAX_PATH_CHARACTERS = 4096
MAX_THUMBNAIL_CHARACTERS = 64 * 1024
MAX_PORTRAIT_CHARACTERS = 256 * 1024
COMMAND = (sys.executable, "-P", "-s", "-B", "-m", "lambent_capture.checks.check_child")
_BASE64 = re.compile(r"[A-Za-z0-9+/]+={0,2}")


def check_capture(
    folder: Path, layout: str | None = None, masks: Path | None = None, cameras: Path | None = None
) -> CaptureCheck:
    """Return the report on the capture in `folder` (at most 100 findings), with measurements if it is usable.

    `layout` forces a layout instead of detecting it, `masks` is a folder of masks named like the pictures,
    `cameras` one of cameras that were found for photographs; without, these are looked at one by one. An
    unknown layout is a `UsageError`; a folder among the files of the program, and a library that cannot be
    loaded, are a `WorkerError`. Nothing that a capture holds makes this function raise.
    """
    require_layout(layout)
    _require_apart(folder, masks, cameras)
    killers: dict[str, str] = {}
    why = "needed more memory or time than it may use"
    for _ in range(MAX_DEATHS):
        check, reading, code, failure = _run_child(folder, layout, masks, cameras, killers)
        if check is not None:
            return check
        if failure:
            why = f"failed with {failure}"
        if not reading or reading in killers:
            killers.setdefault(reading or "a file", code)
            break
        killers[reading] = code
    problems = Problems()
    for path, code in killers.items():
        if code == STOPPED:
            problems.error(STOPPED, f"{path} {SKIPPED[STOPPED]}", path)
    problems.error(
        "scene.check_failed",
        f"the check {why}"
        + (f" while reading {', '.join(killers)}" if killers else "")
        + (
            "; this is a fault of Lambent's reader: report it with this line"
            if why.startswith("failed")
            else "; reduce the number or the size of the files"
        ),
    )
    report = scene_pb2.SceneReport(usable=False, layout=layout or "", findings=problems.findings())
    return CaptureCheck(report=report)


def strictness() -> str:
    """Return what LAMBENT_SANDBOX says; a value that does not exist is a `UsageError`."""
    given = os.environ.get("LAMBENT_SANDBOX", AVAILABLE)
    if given not in STRICTNESS:
        raise UsageError("config.sandbox_unknown", f"LAMBENT_SANDBOX={given}: use {', '.join(STRICTNESS)}")
    return given


def _require_apart(*folders: Path | None) -> None:
    """Raise `run.sandbox_missing` for folders that cannot be told from the program."""
    if strictness() == LIMITS or not sys.platform.startswith("linux"):
        return
    try:
        require_apart(each for each in folders if each is not None)
    except SandboxError as error:
        raise WorkerError("run.sandbox_missing", str(error)) from error


def _run_child(
    folder: Path, layout: str | None, masks: Path | None, cameras: Path | None, killers: dict[str, str]
) -> tuple[CaptureCheck | None, str | None, str, str]:
    """Return the child's result, or None, the file it was reading when it ended, the code and the error."""
    order = {
        "folder": str(folder.resolve()),
        "layout": layout,
        "masks": None if masks is None else str(masks.resolve()),
        "cameras": None if cameras is None else str(cameras.resolve()),
        "killers": killers,
        "memory_bytes": MAX_MEMORY_BYTES,
        "cpu_s": MAX_CPU_S,
        "sandbox": strictness(),
    }
    output, code = _ask(json.dumps(order))
    try:
        check, reading = _understand(output, folder, code)
        failure = _failure(output)
    except (json_format.ParseError, ValueError, TypeError, AttributeError, RecursionError, OSError):
        # No check writes this: foreign code runs in the child.
        return None, _last_announced(output), STOPPED, ""
    return check, reading, STOPPED if code == -signal.SIGSYS else TOO_LARGE, failure


def _ask(order: str) -> tuple[str, int]:
    """Return what the child writes, at most `MAX_OUTPUT_BYTES`, and its exit code."""
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PATH": os.environ.get("PATH", "")}
    # Modules are found where this process finds them.
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    # A child that Ctrl-C ended would look as if a file of the capture had ended it.
    with held_back(*GROUP_SIGNALS):
        started = subprocess.Popen(
            COMMAND,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
    with started as child:
        assert child.stdin is not None
        assert child.stdout is not None
        timer = threading.Timer(MAX_WALL_S, child.kill)
        timer.daemon = True
        timer.start()
        try:
            child.stdin.write(order.encode())
            child.stdin.close()
            output = child.stdout.read(MAX_OUTPUT_BYTES)
        except BrokenPipeError:
            output = b""
        except BaseException:
            child.kill()
            raise
        finally:
            timer.cancel()
            if child.poll() is None:
                # It has closed its output, or writes too much.
                _end(child)
    return output.decode(errors="replace"), child.returncode


def _end(child: "subprocess.Popen[bytes]") -> None:
    """Wait a moment for a child that has said all, then end it."""
    try:
        child.wait(5.0)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def _understand(output: str, folder: Path, code: int) -> tuple[CaptureCheck | None, str | None]:
    """Return the result that the child's lines tell, or None and the file that it was reading last.

    Raises one of several errors, ValueError among them, for what no check would say.
    """
    reading, figures = None, None
    thumbnails: dict[str, str] = {}
    portrait = ""
    left_out: tuple[str, ...] = ()
    for line in output.splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "refused":
            if code != EXIT_REFUSED or strictness() != REQUIRED:
                raise ValueError("a refusal that nobody asked for")
            raise WorkerError("run.sandbox_missing", f"LAMBENT_SANDBOX=required: {json.loads(rest)}")
        if kind == "broken":
            if code != EXIT_BROKEN or reading is not None:
                raise ValueError("an installation that breaks in the middle")
            raise WorkerError(
                "run.check_broken",
                f"captures cannot be checked here, because a library cannot be loaded: {json.loads(rest)}",
            )
        if kind == "report":
            report = json_format.ParseDict(_object(rest), scene_pb2.SceneReport())
            if len(report.findings) > MAX_FINDINGS:
                raise ValueError(f"{len(report.findings)} findings")
            check = CaptureCheck(
                report=report, figures=figures, thumbnails=thumbnails, portrait=portrait, left_out=left_out
            )
            return check, None
        if kind == "left_out":
            left_out = tuple(_file_in(folder, name) for name in json.loads(rest))
        if kind == "figures":
            figures = json_format.ParseDict(_object(rest), capture_pb2.CaptureFigures())
        if kind == "thumbnail":
            thumbnails |= _thumbnail(_object(rest))
        if kind == "portrait":
            portrait = _jpeg(json.loads(rest), MAX_PORTRAIT_CHARACTERS) or ""
        if kind == "reading":
            reading = _path(json.loads(rest))
    return None, reading


def _path(value: object) -> str:
    """Return a path, if it has the length of one; ValueError for anything else."""
    if not isinstance(value, str) or len(value) > MAX_PATH_CHARACTERS:
        raise ValueError("no path")
    return value


def _file_in(folder: Path, value: object) -> str:
    """Return the name of a regular file that lies in `folder`; ValueError or OSError for anything else.

    Whoever gets the name opens the file outside of any sandbox. Links may lead to other files of the folder.
    """
    name = _path(value)
    root = folder.resolve()
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise ValueError(f"{name} is outside of the folder")
    path = (root / name).resolve(strict=True)
    if not path.is_relative_to(root) or not path.is_file():
        raise ValueError(f"{name} is not a file of the folder")
    return name


def _object(text: str) -> dict[str, Any]:
    """Return a JSON object; ValueError for anything else."""
    value = json.loads(text)
    if not isinstance(value, dict):
        raise ValueError(f"no object: {text[:40]}")
    return value


def _last_announced(output: str) -> str | None:
    """Return the last file that was announced in proper form."""
    for line in reversed(output.splitlines()):
        if line.startswith('reading "') and line.endswith('"'):
            try:
                return _path(json.loads(line.partition(" ")[2]))
            except ValueError:
                continue
    return None


def _failure(output: str) -> str:
    """Return the exception that ended a reader, as the child's last line says; empty if there is none."""
    kind, _, rest = output.rpartition("\n")[0].rpartition("\n")[2].partition(" ")
    if kind != "failed":
        return ""
    text = json.loads(rest)
    return "".join(letter for letter in str(text) if letter.isprintable())[:MAX_REASON_CHARACTERS]


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

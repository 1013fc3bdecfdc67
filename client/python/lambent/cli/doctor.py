"""doctor: what this machine has, and what to do about what it lacks."""

import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from ctypes.util import find_library
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Annotated, Any

import typer
from lambent_compute.threads import available_threads
from lambent_core.errors import pip_install

from lambent import ffmpeg
from lambent.cli.output import JsonOption, Output, UrlOption, format_size
from lambent.client import Client
from lambent.errors import LambentError, UnreachableError
from lambent.settings import data_folder

GIB = 1 << 30
EXTRAS = {
    "client": "for pictures from bundles",
    "capture": "for check, poses and masks",
    "server": "where the server runs",
    "worker": "where training runs",
}
"""Extras that are looked for, and what for."""


@dataclass(frozen=True, slots=True)
class Check:
    """One line of the report: `verdict` is "ok", "warn" or "fail"; `advice` says what to do."""

    name: str
    verdict: str
    shows: str
    advice: str = ""


def doctor(
    url: UrlOption = "",
    data: Annotated[Path | None, typer.Option(help="Data folder of the server on this machine.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Check this machine and the server; exit code 1 when something must be fixed."""
    output = Output(as_json)
    failed = False
    for check in examine(url, data or data_folder()):
        failed |= check.verdict == "fail"
        advice = f"\n{'':17}-> {check.advice}" if check.advice else ""
        output.result(f"{check.verdict:<5}{check.name:<12}{check.shows}{advice}", _for_machines(check))
    raise typer.Exit(1 if failed else 0)


def _for_machines(check: Check) -> dict[str, str]:
    return {"name": check.name, "verdict": check.verdict, "found": check.shows, "advice": check.advice}


def examine(url: str, data: Path) -> Iterator[Check]:
    """Yield every check, quick ones first."""
    yield check_python(sys.version_info[:3])
    for extra in EXTRAS:
        yield check_packages(extra)
    yield check_cores(available_threads())
    yield check_memory(_available_memory())
    yield check_disk(data)
    yield check_gpu()
    yield check_ffmpeg(ffmpeg.encoder())
    yield check_gl(find_library)
    yield check_server(url, data)


def check_python(python: tuple[int, ...]) -> Check:
    """Return whether this Python is one we run on."""
    text = f"{'.'.join(map(str, python))} ({platform.system()} {platform.machine()})"
    if python < (3, 11):
        return Check("python", "fail", text, "install Python 3.11 or newer")
    return Check("python", "ok", text)


def check_packages(extra: str) -> Check:
    """Return whether the packages of an extra are installed; nothing but talking to a server needs none."""
    missing = missing_packages(extra)
    name = f"[{extra}]"
    if not missing:
        return Check(name, "ok", "installed")
    advice = f"{pip_install(extra)} (needed only {EXTRAS[extra]})"
    return Check(name, "warn", f"missing: {', '.join(missing)}", advice)


def missing_packages(extra: str) -> list[str]:
    """Return the distributions that an extra asks for and that are not installed."""
    from packaging.requirements import Requirement

    missing = []
    for line in requires("lambent") or []:
        requirement = Requirement(line)
        if requirement.name == "lambent" or not requirement.marker:
            continue
        if not requirement.marker.evaluate({"extra": extra}) or requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            installed = version(requirement.name)
        except PackageNotFoundError:
            missing.append(requirement.name)
            continue
        if not requirement.specifier.contains(installed, prereleases=True):
            missing.append(f"{requirement.name}{requirement.specifier} (found {installed})")
    return missing


def check_cores(count: int) -> Check:
    """Return whether there are enough processor cores for training."""
    if count < 2:
        advice = "training works, but takes about twice the time the presets promise"
        return Check("cores", "warn", str(count), advice)
    return Check("cores", "ok", str(count))


def check_memory(available_bytes: int | None) -> Check:
    """Return whether a `fast` job fits into memory (4 GiB)."""
    if available_bytes is None:
        return Check("memory", "warn", "unknown on this system", "4 GiB are needed")
    text = f"{format_size(available_bytes)} available"
    if available_bytes < 4 * GIB:
        advice = "close other programs, or train with preset tiny; `fast` takes up to 4 GiB"
        return Check("memory", "warn", text, advice)
    return Check("memory", "ok", text)


def _available_memory() -> int | None:
    meminfo = Path("/proc/meminfo")
    if not meminfo.is_file():
        return None
    rows = dict(line.split(":", 1) for line in meminfo.read_text().splitlines() if ":" in line)
    available = int(rows["MemAvailable"].split()[0]) * 1024
    limit = Path("/sys/fs/cgroup/memory.max")
    used = Path("/sys/fs/cgroup/memory.current")
    if limit.is_file() and used.is_file() and limit.read_text().strip() != "max":
        available = min(available, int(limit.read_text()) - int(used.read_text()))
    return available


def check_disk(data: Path) -> Check:
    """Return whether the disk of the data folder has room for some jobs."""
    existing = next(folder for folder in (data, *data.absolute().parents) if folder.exists())
    free = shutil.disk_usage(existing).free
    text = f"{format_size(free)} free for {data}"
    if free < GIB:
        advice = "free some space: below 1 GiB the server refuses uploads and jobs"
        return Check("disk", "fail", text, advice)
    if free < 5 * GIB:
        return Check("disk", "warn", text, "about 0.3 GiB per job are used")
    return Check("disk", "ok", text)


_GPU_PROBE = """
import torch
if torch.cuda.is_available():
    index = torch.cuda.current_device()
    total = torch.cuda.get_device_properties(index).total_memory
    print("cuda", torch.version.cuda, torch.cuda.get_device_name(index), total, sep="|")
else:
    print("cpu", torch.__version__, sep="|")
"""


def check_gpu(probe: str = _GPU_PROBE) -> Check:
    """Return what torch finds; asked in a child process, because a broken driver can end one."""
    try:
        torch_version = version("torch")
    except PackageNotFoundError:
        return Check("gpu", "ok", "not looked for: torch is not installed (not needed here)")
    try:
        answer = subprocess.run(
            [sys.executable, "-P", "-c", probe], capture_output=True, text=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        advice = "the driver hangs: look at `nvidia-smi`, restart the machine; training on the CPU works"
        return Check("gpu", "warn", "no answer within 60 s", advice)
    kind, *rest = answer.stdout.strip().split("|")
    if answer.returncode or not kind:
        last = (answer.stderr.strip().splitlines() or ["no message"])[-1]
        return Check(
            "gpu",
            "fail",
            f"torch {torch_version} does not start: {last[:160]}",
            "install torch again for this machine (README.md)",
        )
    if kind == "cuda":
        cuda, name, total = rest
        return Check("gpu", "ok", f"{name}, {format_size(float(total))}, CUDA {cuda}")
    return Check("gpu", "ok", f"none; training runs on the CPU (torch {torch_version})")


def check_ffmpeg(path: str | None) -> Check:
    """Return whether films can be written as MP4 and WebM."""
    if path is None:
        advice = f"{pip_install('film')} for .mp4 and .webm; webp and gif work without"
        return Check("ffmpeg", "warn", "not found", advice)
    return Check("ffmpeg", "ok", path)


def check_gl(find: Callable[[str], str | None]) -> Check:
    """Return whether an OpenGL library is there, for the desktop viewer."""
    libraries = [name for name in ("GL", "EGL", "OSMesa") if find(name)]
    if platform.system() == "Linux" and not libraries:
        advice = "install libgl1 (or libegl1) for the desktop viewer; everything else works without"
        return Check("opengl", "warn", "no library", advice)
    return Check("opengl", "ok", ", ".join(libraries) or platform.system())


def check_server(url: str, data: Path) -> Check:
    """Return whether the server answers, accepts the key, and has our version."""
    from lambent import __version__

    try:
        with Client(url, data=data) as client:
            answer: Any = client.version()
            list(client.jobs(limit=1))
            address = client.address.url
    except UnreachableError as error:
        return Check("server", "warn", error.message, error.advice)
    except LambentError as error:
        return Check("server", "fail", f"{error.code}: {error.message}", error.advice)
    theirs = str(answer.get("version", "unknown"))
    if theirs != __version__:
        advice = "install the same version on both sides"
        text = f"{address} has version {theirs}, this client {__version__}"
        return Check("server", "warn", text, advice)
    return Check("server", "ok", f"{address}, version {theirs}")

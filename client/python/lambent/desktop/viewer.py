"""`lambent view --desktop`: opens bundle, maps and photographs for a window or a screenshot."""

import subprocess
import sys
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from lambent_relight import Bundle, Renderer
from lambent_relight.environment.input import EnvironmentInput
from PIL import Image

from lambent.desktop import opengl
from lambent.desktop.channels import channel_names
from lambent.desktop.lights import Lights
from lambent.desktop.model import ViewerModel
from lambent.desktop.orbit import orbit_around
from lambent.desktop.painter import Painter
from lambent.desktop.photographs import find_photographs, photograph_index
from lambent.desktop.render_loop import RenderLoop
from lambent.desktop.state import ViewerState
from lambent.errors import UsageProblemError

if TYPE_CHECKING:
    from lambent.desktop.window import Window

_DIALOG = """
import tkinter.filedialog
root = tkinter.Tk()
root.withdraw()
types = [("environment maps", "*.exr *.hdr"), ("all files", "*")]
print(tkinter.filedialog.askopenfilename(title="Environment map", filetypes=types), end="")
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class DesktopOptions:
    """Options of `lambent view --desktop`; angles in degrees, sizes in pixels."""

    environments: tuple[Path, ...] = ()
    light: EnvironmentInput = field(default_factory=EnvironmentInput)
    photographs: Path | None = None
    photograph: str = ""
    """Name of the photograph to compare with at the beginning."""
    compare: bool = False
    """Whether to begin with the first two environments side by side."""
    split: float = 0.5
    size: tuple[int, int] = (960, 720)
    turn_deg: float = 0.0
    """How much further around the object the camera begins."""
    rotate_deg: float = 0.0
    object_rotate_deg: float = 0.0
    exposure_ev: float = 0.0
    tone_mapping: str = "linear"
    channel: str = "final"
    backdrop: str = "grey"
    save_to: Path = Path()
    """Folder of the pictures that the key s saves."""
    screenshot: Path | None = None
    """Write this picture of the window instead of showing one."""
    overlays: bool = False
    """Whether the screenshot has text and sliders."""
    help: bool = False
    """Whether the help is open at the beginning."""


def open_model(bundle: Bundle, options: DesktopOptions) -> ViewerModel:
    """Return the viewer's model at its beginning.

    Raises UsageProblemError for a channel, photograph or comparison that there is not, and RelightError for a
    first environment that cannot be used.
    """
    lights = Lights(bundle, options.light)
    for path in options.environments:
        lights.add_file(path)
    lights.add_recovered()
    if len(lights) == 0:
        raise UsageProblemError("view.no_light", "there is no environment", "give one with --env MAP")
    lights.environment(0)
    channels = channel_names(bundle)
    if options.channel not in channels:
        raise UsageProblemError(
            "cli.bad_choice", f"--channel {options.channel!r}", f"use one of {', '.join(channels)}"
        )
    photographs = find_photographs(bundle, options.photographs) if options.photographs else []
    state = ViewerState(
        orbit=orbit_around(bundle).turned(options.turn_deg, 0.0),
        width=16,
        height=16,
        rotate_deg=options.rotate_deg,
        object_rotate_deg=options.object_rotate_deg,
        tone_mapping=options.tone_mapping,
        channel=options.channel,
        backdrop=options.backdrop,
    )
    state = state.resized(*options.size).with_number("exposure_ev", options.exposure_ev)
    state = state.with_number("split", options.split)
    model = ViewerModel(state, lights, photographs, channels, choose_file=choose_file)
    model.message = "press h for help"
    model.show_help = options.help
    if options.compare:
        if len(lights) < 2:
            raise UsageProblemError(
                "view.one_light", "there is nothing to compare with", "give two maps with --env"
            )
        model.state = state.comparing_environments(len(lights))
    if options.photograph:
        if not photographs:
            raise UsageProblemError(
                "view.no_photographs", "photographs are not known", "add --photographs FOLDER"
            )
        model.compare_photograph(photograph_index(photographs, options.photograph))
    return model


def show(renderer: Renderer, options: DesktopOptions) -> list[Path]:
    """Show the viewer until it is closed, or write its screenshot; returns the files that were written.

    Raises UsageProblemError without pyvista or without a display, LambentError `view.no_opengl` where
    OpenGL does not work, and UnsupportedQuality for a bundle without baked transport.
    """
    opengl.require_pyvista()
    if options.screenshot is None:
        opengl.require_display()
    opengl.draw_without_display()
    trial = opengl.Trial()
    try:
        model = open_model(renderer.bundle, options)
        painter = Painter(renderer, model.lights, model.photographs)
        if options.screenshot is not None:
            return [_write_screenshot(model, painter, trial, options)]
        trial.require_success()
        return run(model, painter, save_to=options.save_to)
    finally:
        trial.stop()


def _write_screenshot(
    model: ViewerModel, painter: Painter, trial: opengl.Trial, options: DesktopOptions
) -> Path:
    assert options.screenshot is not None
    painted = painter.paint(model.state)
    trial.require_success()
    from lambent.desktop.window import Window

    window = Window(model, off_screen=True, overlays=options.overlays)
    try:
        window.show_picture(painted)
        window.show_model(model.status(legend=painted.legend))
        pixels = window.screenshot()
    finally:
        window.close()
    options.screenshot.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(pixels)).save(options.screenshot)
    return options.screenshot


def run(model: ViewerModel, painter: Painter, *, save_to: Path, off_screen: bool = False) -> list[Path]:
    """Show a window until it is closed; returns the files that the user saved into `save_to`."""
    from lambent.desktop.window import Window

    session = Session(model, painter, save_to)
    window = Window(
        model, off_screen=off_screen, on_change=session.changed, on_tick=lambda: session.tick(window)
    )
    try:
        session.changed()
        window.run()
    finally:
        window.close()
        session.close()
    return session.saved


class Session:
    """Between a window and the painter's thread: asks for pictures, hands them over, saves them."""

    def __init__(self, model: ViewerModel, painter: Painter, save_to: Path) -> None:
        self.model, self._painter, self._save_to = model, painter, save_to
        self.loop = RenderLoop(painter)
        self.saved: list[Path] = []
        self._taken: set[Path] = set()
        self._asked: ViewerState | None = None
        self._status: tuple[str, bool] = ("", True)
        self._dirty = True

    def changed(self) -> None:
        """Ask for the picture of the model's state, if it is another one, and save it if that is wanted."""
        self._dirty = True
        if self.model.state != self._asked:
            self._asked = self.model.state
            self.loop.ask(self._asked)
        if self.model.wants_save:
            self.model.wants_save = False
            state = self.model.state
            stem = self._free_stem()
            self.model.message = f"saving {stem.name}.png and .exr"
            self.loop.run_with_painter(lambda: self._save(state, stem))

    def tick(self, window: "Window") -> None:
        """Hand what was painted to `window`; called often, on the window's thread."""
        frame = self.loop.take()
        if frame is not None:
            self._dirty = True
            if frame.painted is None:
                self.model.message = frame.problem
            elif (frame.state.width, frame.state.height) == (self.model.state.width, self.model.state.height):
                window.show_picture(frame.painted)
                self._status = (frame.painted.legend, frame.painted.full)
        if self._dirty:
            self._dirty = False
            window.show_model(self.model.status(legend=self._status[0], full=self._status[1]))
            window.render()

    def close(self) -> None:
        """Wait for files that are being written, and end the thread."""
        self.loop.close()

    def _free_stem(self) -> Path:
        name = self._painter.renderer.bundle.manifest.name or "lambent"
        safe = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in name)
        stems = (self._save_to / f"{safe}_{number:03d}" for number in count(1))
        stem = next(
            stem
            for stem in stems
            if stem not in self._taken
            and not any(stem.with_suffix(suffix).exists() for suffix in (".png", ".exr"))
        )
        self._taken.add(stem)
        return stem

    def _save(self, state: ViewerState, stem: Path) -> None:
        try:
            files = self._painter.save(state, stem)
        except OSError as error:
            self.model.message = f"cannot save: {error}"
        else:
            self.saved += files
            self.model.message = f"saved {', '.join(file.name for file in files)}"
        self._dirty = True


def choose_file() -> Path | None:
    """Return the environment map that the user picks in a dialog, or None where none was picked.

    The dialog is another process: two programs' event loops do not share one. Raises UsageProblemError
    `view.no_dialog` where there is no tkinter to make it.
    """
    done = subprocess.run([sys.executable, "-P", "-c", _DIALOG], capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageProblemError(
            "view.no_dialog", "no file dialog can be opened here (tkinter)", "start with --env MAP"
        )
    return Path(done.stdout) if done.stdout else None

"""The window: VTK shows the painter's pixels one to one, takes input and draws text and sliders over them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pyvista
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk
from vtkmodules.vtkCommonDataModel import vtkImageData
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkImageMapper

from lambent.desktop.model import SLIDERS, ViewerModel, help_columns
from lambent.desktop.painter import Painted
from lambent.desktop.state import LIMITS, Limits

_TICK_MS = 15
_DEGREES = Limits(low=-180.0, high=180.0, step=1.0)
_BUTTONS = {"Left": "left", "Middle": "middle", "Right": "right"}


class Window:
    """A window on a viewer's model, or an off-screen picture of one.

    `on_change` is called after input changed the model, `on_tick` every few milliseconds.
    """

    def __init__(
        self,
        model: ViewerModel,
        *,
        off_screen: bool,
        overlays: bool = True,
        on_change: Callable[[], None] = lambda: None,
        on_tick: Callable[[], None] = lambda: None,
    ) -> None:
        self.model, self._on_change, self._on_tick = model, on_change, on_tick
        self._overlays = overlays
        self.plotter: Any = pyvista.Plotter(
            off_screen=off_screen,
            window_size=[model.state.width, model.state.height],
            title="Lambent",
            lighting="none",
        )
        self._image = vtkImageData()
        self._add_picture()
        self._sliders = self._add_sliders() if overlays else {}
        self._texts: dict[str, Any] = {}
        self._listen()
        self.show_model("")

    def show_picture(self, painted: Painted) -> None:
        """Show the pixels of a painter; they cover the window from its upper left corner."""
        self._pixels(painted.image)

    def show_model(self, status: str) -> None:
        """Bring text and sliders up to date with the model."""
        if not self._overlays:
            return
        model = self.model
        # Help is read through nothing else.
        shown = status if model.show_panel and not model.show_help else ""
        self._text("status", shown, (0.01, 0.99), min(max(model.state.width // 40, 7), 16))
        columns = help_columns() if model.show_help else ("", "")
        size = self._size_that_fits(columns)
        self._text("help_left", columns[0], (0.01, 0.99), size)
        self._text("help_right", columns[1], (0.5, 0.99), size)
        values = _slider_values(model)
        for name, widget in self._sliders.items():
            widget.GetRepresentation().SetValue(values[name])
            widget.SetEnabled(model.show_panel and not model.show_help)

    def render(self) -> None:
        """Draw."""
        self.plotter.render()

    def screenshot(self) -> NDArray[np.uint8]:
        """Return the window's pixels [height, width, 3]."""
        self.plotter.show(auto_close=False, interactive=False)
        return np.asarray(self.plotter.screenshot(None, return_img=True))[..., :3]

    def run(self) -> None:
        """Show the window until it is closed or the model wants to quit."""
        # An interactive `show` would bring back a style that has keys of its own, e for exit among them.
        self.plotter.show(auto_close=False, interactive=False)
        interactor = self.plotter.iren.interactor
        interactor.Initialize()
        interactor.CreateRepeatingTimer(_TICK_MS)
        interactor.Start()

    def close(self) -> None:
        """Close the window."""
        self.plotter.close()

    def _add_picture(self) -> None:
        self.plotter.set_background("black")
        mapper = vtkImageMapper()
        mapper.SetInputData(self._image)
        # Bytes are shown as they are.
        mapper.SetColorWindow(255.0)
        mapper.SetColorLevel(127.5)
        actor = vtkActor2D()
        actor.SetMapper(mapper)
        actor.GetProperty().SetDisplayLocationToBackground()
        self._mapper = mapper
        self._pixels(np.zeros((self.model.state.height, self.model.state.width, 3), np.uint8))
        self.plotter.renderer.AddViewProp(actor)

    def _pixels(self, pixels: NDArray[np.uint8]) -> None:
        height, width = pixels.shape[:2]
        # VTK's rows begin at the bottom.
        rows = np.ascontiguousarray(pixels[::-1]).reshape(-1, 3)
        self._image.SetDimensions(width, height, 1)
        self._image.GetPointData().SetScalars(numpy_to_vtk(rows, deep=True))  # type: ignore[no-untyped-call]
        self._image.Modified()

    def _text(self, name: str, text: str, upper_left: tuple[float, float], size_px: int) -> None:
        """Write `text` with its upper left corner at a share of the window's width and height."""
        wanted = (text, size_px)
        if self._texts.get(name) == wanted:
            return
        self._texts[name] = wanted
        actor = self.plotter.add_text(
            text, position=upper_left, color="white", font="courier", name=name, viewport=True, render=False
        )
        style = actor.GetTextProperty()
        style.SetFontSize(size_px)
        style.SetVerticalJustificationToTop()
        style.SetBackgroundColor(0.0, 0.0, 0.0)
        style.SetBackgroundOpacity(0.6 if text else 0.0)

    def _size_that_fits(self, columns: tuple[str, str]) -> int:
        """Return the height of letters, pixels, with which two columns fill no more than the window."""
        lines = [line for column in columns for line in column.split("\n")]
        width = 0.48 * self.model.state.width / max(max(map(len, lines)), 1)
        height = 0.96 * self.model.state.height / max(column.count("\n") + 1 for column in columns)
        # Courier's letters are 0.6 as wide as high, and lines 1.2 letters apart.
        return int(min(max(min(width / 0.6, height / 1.2), 7.0), 18.0))

    def _add_sliders(self) -> dict[str, Any]:
        model = self.model
        kinds = (
            ("light", "light, degrees", _DEGREES),
            ("object", "object, degrees", _DEGREES),
            ("exposure", "exposure, EV", LIMITS["exposure_ev"]),
            ("albedo", "albedo x", LIMITS["albedo_gain"]),
            ("roughness", "roughness x", LIMITS["roughness_scale"]),
        )
        values, sliders = _slider_values(model), {}
        for number, (name, title, limits) in enumerate(kinds):
            left = (number + 0.1) / len(kinds)
            sliders[name] = self.plotter.add_slider_widget(
                lambda value, name=name: self._slid(name, value),
                [limits.low, limits.high],
                value=values[name],
                title=title,
                pointa=(left, 0.06),
                pointb=(left + 0.8 / len(kinds), 0.06),
                title_height=0.018,
                slider_width=0.03,
                tube_width=0.005,
                color="white",
                interaction_event="always",
                fmt="%.2f",
            )
        return sliders

    def _slid(self, name: str, value: float) -> None:
        before = self.model.state
        self.model.set_slider(name, float(value))
        if self.model.state != before:
            self._on_change()

    def _listen(self) -> None:
        """Connect input. Without a style VTK does nothing by itself; sliders come before us."""
        self.plotter.iren.clear_key_event_callbacks()
        interactor = self.plotter.iren.interactor
        interactor.SetInteractorStyle(None)
        for name, button in _BUTTONS.items():
            interactor.AddObserver(f"{name}ButtonPressEvent", lambda *_, b=button: self._pressed(b))
            interactor.AddObserver(f"{name}ButtonReleaseEvent", lambda *_: self.model.release_mouse())
        interactor.AddObserver("MouseMoveEvent", lambda *_: self._moved())
        interactor.AddObserver("MouseWheelForwardEvent", lambda *_: self._wheel(1))
        interactor.AddObserver("MouseWheelBackwardEvent", lambda *_: self._wheel(-1))
        interactor.AddObserver("KeyPressEvent", lambda *_: self._key())
        interactor.AddObserver("TimerEvent", lambda *_: self._tick())

    def _place(self) -> tuple[int, int]:
        x, y = self.plotter.iren.interactor.GetEventPosition()
        return x, self.model.state.height - 1 - y

    def _pressed(self, button: str) -> None:
        keys = self.plotter.iren.interactor
        shift, control = bool(keys.GetShiftKey()), bool(keys.GetControlKey())
        self.model.press_mouse(*self._place(), button=button, shift=shift, control=control)

    def _moved(self) -> None:
        if self.model.move_mouse(*self._place()):
            self._on_change()

    def _wheel(self, steps: int) -> None:
        self.model.turn_wheel(steps)
        self._on_change()

    def _key(self) -> None:
        if self.model.press_key(self.plotter.iren.interactor.GetKeySym()):
            self._on_change()
        if self.model.wants_quit:
            self.plotter.iren.interactor.TerminateApp()

    def _tick(self) -> None:
        if self.model.resize(*self.plotter.render_window.GetSize()):
            self._on_change()
        self._on_tick()


def _slider_values(model: ViewerModel) -> dict[str, float]:
    state = model.state
    angles = {"light": state.rotate_deg, "object": state.object_rotate_deg}
    return angles | {name: getattr(state, field) for name, field in SLIDERS.items()}

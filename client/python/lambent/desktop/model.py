"""Keys, the mouse and sliders of a viewer, and how they change it. Knows no window."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from lambent_relight import RelightError
from lambent_relight.tone_mapping import NAMES as TONE_MAPPINGS

from lambent.desktop.lights import Lights
from lambent.desktop.photographs import Photograph
from lambent.desktop.state import BACKDROPS, LIGHT_STEP_DEG, ViewerState, wrapped
from lambent.errors import LambentError

ORBIT_STEP_DEG = 5.0
ZOOM_STEP = 1.1
_DEGREES_PER_WIDTH = 180.0
SLIDERS = {"exposure": "exposure_ev", "albedo": "albedo_gain", "roughness": "roughness_scale"}
"""The fields that sliders set within limits; two more sliders turn the light and the object."""
_GRIP_PX = 8
"""How near the mouse must be to a comparison's border to grab it."""


class ViewerModel:
    """A state, what can be chosen, and how input changes it."""

    def __init__(
        self,
        state: ViewerState,
        lights: Lights,
        photographs: list[Photograph],
        channels: tuple[str, ...],
        *,
        choose_file: Callable[[], Path | None] = lambda: None,
    ) -> None:
        """Begin with `state`; `choose_file` asks for an environment map (LambentError where it cannot)."""
        self.state, self.lights, self.photographs, self.channels = state, lights, photographs, channels
        self.choose_file = choose_file
        self.show_help = False
        self.show_panel = True
        self.wants_save = False
        """Set when the picture is to be saved, and cleared by whoever saves it."""
        self.wants_quit = False
        self.message = ""
        """The latest message for the user."""
        self._first = state
        self._drag: tuple[str, int, int] | None = None

    def press_key(self, symbol: str) -> bool:
        """Handle a key by its X11 name; returns whether it is bound to anything."""
        binding = _BY_SYMBOL.get(symbol)
        if binding is None:
            return False
        self.message = ""
        binding.act(self)
        return True

    def press_mouse(self, x: int, y: int, *, button: str, shift: bool = False, control: bool = False) -> None:
        """Begin to drag; x and y count pixels from the upper left corner, `button` is left or another."""
        border = round(self.state.split * self.state.width)
        if self.state.comparison and button == "left" and abs(x - border) <= _GRIP_PX:
            what = "split"
        elif button != "left":
            what = "move"
        else:
            what = "light" if shift else "object" if control else "orbit"
        self._drag = (what, x, y)

    def move_mouse(self, x: int, y: int) -> bool:
        """Continue dragging; returns whether anything changed."""
        if self._drag is None:
            return False
        what, last_x, last_y = self._drag
        self._drag = (what, x, y)
        right, down, state = x - last_x, y - last_y, self.state
        if (right, down) == (0, 0):
            return False
        degrees = _DEGREES_PER_WIDTH / min(state.width, state.height)
        if what == "split":
            self.state = state.with_number("split", x / state.width)
        elif what == "light":
            self.state = state.light_turned(right * degrees)
        elif what == "object":
            self.state = state.object_turned(right * degrees)
        elif what == "move":
            self.state = state.moved(state.orbit.moved(right, down, state.width, state.height))
        else:
            self.state = state.moved(state.orbit.turned(-right * degrees, down * degrees))
        return True

    def release_mouse(self) -> None:
        """End a drag."""
        self._drag = None

    def turn_wheel(self, steps: int) -> None:
        """Come nearer by a number of steps of the wheel, or go away."""
        self.state = self.state.moved(self.state.orbit.nearer(ZOOM_STEP**steps))

    def set_slider(self, name: str, value: float) -> None:
        """Follow a slider: light, object [degrees], exposure [EV], albedo or roughness [factors]."""
        if name == "light":
            self.state = replace(self.state, rotate_deg=wrapped(value))
        elif name == "object":
            self.state = self.state.object_turned(value - self.state.object_rotate_deg)
        else:
            self.state = self.state.with_number(SLIDERS[name], value)

    def resize(self, width: int, height: int) -> bool:
        """Follow the window's size in pixels; returns whether it changed."""
        before = (self.state.width, self.state.height)
        self.state = self.state.resized(width, height)
        return before != (self.state.width, self.state.height)

    def open_environment(self, path: Path) -> None:
        """Show the object in the light of a file; one that cannot be used is named in `message`."""
        count = len(self.lights)
        number = self.lights.add_file(path)
        try:
            self.lights.environment(number)
        except RelightError as error:
            if number == count:
                self.lights.remove(number)
            self.message = str(error)
            return
        self.message = "; ".join(self.lights.notes(number)) or f"opened {path.name}"
        ended = self.state.comparison == "photograph"
        comparison = "" if ended else self.state.comparison
        self.state = replace(self.state, light=number, comparison=comparison)

    def compare_photograph(self, number: int) -> None:
        """Compare with a photograph in the recovered light it was taken in."""
        light = self.lights.recovered(self.photographs[number].light)
        if light is None:
            self.message = f"the bundle has no light {self.photographs[number].light!r}"
            return
        self.state = self.state.comparing_photograph(number, light)

    def reset(self) -> None:
        """Go back to the beginning, in a window of the present size."""
        self.state = self._first.resized(self.state.width, self.state.height)

    def status(self, *, legend: str = "", full: bool = True) -> str:
        """Return the lines that describe the picture."""
        state = self.state
        light = self.lights.name(state.light)
        if state.comparison == "environment":
            light = f"left {light}, right {self.lights.name(state.other_light)}"
        elif state.comparison == "photograph":
            light = f"{light}; right: photograph {self.photographs[state.photograph].name}"
        turned = f"light {state.rotate_deg:+.0f} deg, object {state.object_rotate_deg:+.0f} deg"
        shown = f"{state.channel}{f' ({legend})' if legend else ''}, {state.exposure_ev:+.2f} EV, "
        shown += state.tone_mapping + ("" if state.indirect else ", direct light only")
        edit = f"albedo x {state.albedo_gain:.2f}, roughness x {state.roughness_scale:.2f}"
        lines = [light, turned, shown]
        lines += [edit] if (state.albedo_gain, state.roughness_scale) != (1.0, 1.0) else []
        lines += [] if full else ["moving: rough outline; full quality follows"]
        return "\n".join([*lines, *([self.message] if self.message else [])])


@dataclass(frozen=True, kw_only=True, slots=True)
class Binding:
    """Keys with one effect: their X11 symbols, how they are written, and the effect."""

    symbols: tuple[str, ...]
    written: str
    does: str
    act: Callable[[ViewerModel], None]


def _change(new_state: Callable[[ViewerModel], ViewerState]) -> Callable[[ViewerModel], None]:
    def act(model: ViewerModel) -> None:
        model.state = new_state(model)

    return act


def _orbit(azimuth_deg: float, elevation_deg: float) -> Callable[[ViewerModel], None]:
    return _change(lambda m: m.state.moved(m.state.orbit.turned(azimuth_deg, elevation_deg)))


def _turned_light(degrees: float) -> Callable[[ViewerModel], None]:
    return _change(lambda m: m.state.light_turned(degrees))


def _turned_object(degrees: float) -> Callable[[ViewerModel], None]:
    return _change(lambda m: m.state.object_turned(degrees))


def _photograph(model: ViewerModel, step: int) -> None:
    if not model.photographs:
        model.message = "no photographs are known; start with --photographs FOLDER"
    elif model.state.comparison == "photograph" and step == 0:
        model.state = replace(model.state, comparison="")
    else:
        model.compare_photograph((model.state.photograph + step) % len(model.photographs))


def _compare_environments(model: ViewerModel) -> None:
    if len(model.lights) < 2:
        model.message = "there is one environment only; open another with o, or start with more --env"
        return
    model.state = model.state.comparing_environments(len(model.lights))


def _open(model: ViewerModel) -> None:
    try:
        path = model.choose_file()
    except LambentError as error:
        model.message = str(error)
        return
    if path is not None:
        model.open_environment(path)


def _flag(name: str) -> Callable[[ViewerModel], None]:
    def act(model: ViewerModel) -> None:
        setattr(model, name, not getattr(model, name))

    return act


def _step(name: str, steps: int) -> Callable[[ViewerModel], None]:
    return _change(lambda m: m.state.stepped(name, steps))


def _binding(
    written: str, does: str, act: Callable[[ViewerModel], None], symbols: str | None = None
) -> Binding:
    """Return the binding of the keys `symbols` (X11 names), by default of the one named like `written`."""
    return Binding(symbols=tuple((symbols or written).split()), written=written, does=does, act=act)


BINDINGS = (
    _binding("Left", "camera to the left", _orbit(-ORBIT_STEP_DEG, 0.0)),
    _binding("Right", "camera to the right", _orbit(ORBIT_STEP_DEG, 0.0)),
    _binding("Up", "camera up", _orbit(0.0, ORBIT_STEP_DEG)),
    _binding("Down", "camera down", _orbit(0.0, -ORBIT_STEP_DEG)),
    _binding("+", "nearer", lambda m: m.turn_wheel(1), "plus equal KP_Add"),
    _binding("-", "farther", lambda m: m.turn_wheel(-1), "minus KP_Subtract"),
    _binding("[", "light clockwise", _turned_light(-LIGHT_STEP_DEG), "bracketleft"),
    _binding("]", "light counter-clockwise", _turned_light(LIGHT_STEP_DEG), "bracketright"),
    _binding("{", "object clockwise", _turned_object(-LIGHT_STEP_DEG), "braceleft"),
    _binding("}", "object counter-clockwise", _turned_object(LIGHT_STEP_DEG), "braceright"),
    _binding("e", "next environment", _change(lambda m: m.state.with_next_light(len(m.lights)))),
    _binding("E", "environment before", _change(lambda m: m.state.with_next_light(len(m.lights), -1))),
    _binding("o", "open an environment file", _open),
    _binding(",", "darker", _step("exposure_ev", -1), "comma"),
    _binding(".", "brighter", _step("exposure_ev", 1), "period"),
    _binding("t", "next tone curve", _change(lambda m: m.state.with_next("tone_mapping", TONE_MAPPINGS))),
    _binding("c", "next channel", _change(lambda m: m.state.with_next("channel", m.channels))),
    _binding("C", "channel before", _change(lambda m: m.state.with_next("channel", m.channels, -1))),
    _binding("f", "back to the final picture", _change(lambda m: replace(m.state, channel="final"))),
    _binding(
        "i", "indirect light on, off", _change(lambda m: replace(m.state, indirect=not m.state.indirect))
    ),
    _binding("b", "next backdrop", _change(lambda m: m.state.with_next("backdrop", tuple(BACKDROPS)))),
    _binding("g", "darker albedo", _step("albedo_gain", -1)),
    _binding("G", "brighter albedo", _step("albedo_gain", 1)),
    _binding("r", "smoother", _step("roughness_scale", -1)),
    _binding("R", "rougher", _step("roughness_scale", 1)),
    _binding("a", "compare with another environment", _compare_environments),
    _binding(
        "n", "next environment on the right", _change(lambda m: m.state.with_next_other_light(len(m.lights)))
    ),
    _binding("p", "compare with a photograph", lambda m: _photograph(m, 0)),
    _binding("Page Down", "next photograph", lambda m: _photograph(m, 1), "Next"),
    _binding("Page Up", "photograph before", lambda m: _photograph(m, -1), "Prior"),
    _binding(";", "border to the left", _step("split", -1), "semicolon"),
    _binding("'", "border to the right", _step("split", 1), "apostrophe quoteright"),
    _binding("s", "save PNG and EXR", _flag("wants_save")),
    _binding("k", "sliders and text on, off", _flag("show_panel")),
    _binding("h", "this help on, off", _flag("show_help"), "h question F1"),
    _binding("Home", "back to the beginning", ViewerModel.reset),
    _binding("q", "quit", _flag("wants_quit"), "q Escape"),
)
MOUSE_HELP = (
    ("drag", "camera around the object"),
    ("Shift-drag", "turn the light"),
    ("Ctrl-drag", "turn the object"),
    ("right-drag", "move the picture"),
    ("wheel", "nearer, farther"),
    ("drag the line", "border of a comparison"),
)
_BY_SYMBOL = {symbol: binding for binding in BINDINGS for symbol in binding.symbols}


def help_columns() -> tuple[str, str]:
    """Return two columns that list every key and what the mouse does."""
    rows = [(binding.written, binding.does) for binding in BINDINGS] + list(MOUSE_HELP)
    half = (len(rows) + 1) // 2
    width = max(len(keys) for keys, _ in rows)
    columns = (rows[:half], rows[half:])
    first, second = ("\n".join(f"{keys:>{width}}  {does}" for keys, does in rows) for rows in columns)
    return first, second

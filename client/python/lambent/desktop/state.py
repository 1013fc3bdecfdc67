"""The complete state of a viewer and the ways to change it. No windows, no files."""

from dataclasses import dataclass, replace
from typing import Any, Literal

from lambent_relight import MaterialEdit

from lambent.desktop.orbit import Orbit

Comparison = Literal["", "environment", "photograph"]
BACKDROPS: dict[str, tuple[float, float, float] | None] = {
    "grey": (0.05, 0.05, 0.05),
    "white": (1.0, 1.0, 1.0),
    "black": (0.0, 0.0, 0.0),
    "environment": None,
}
"""Linear colours as they appear on the screen, whatever exposure and tone curve; None is the light itself."""
MIN_SIDE, MAX_SIDE = 16, 8192


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """How far a number can be turned, and by how much a key turns it."""

    low: float
    high: float
    step: float


LIMITS = {
    "exposure_ev": Limits(low=-8.0, high=8.0, step=0.25),
    "roughness_scale": Limits(low=0.0, high=3.0, step=0.1),
    "albedo_gain": Limits(low=0.1, high=3.0, step=0.1),
    "split": Limits(low=0.0, high=1.0, step=0.02),
}
LIGHT_STEP_DEG = 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewerState:
    """The view, its light, and how it is displayed."""

    orbit: Orbit
    width: int
    height: int
    light: int = 0
    """Number of the environment, on the left side of a comparison."""
    other_light: int = 0
    """Number of the environment on the right side."""
    rotate_deg: float = 0.0
    object_rotate_deg: float = 0.0
    exposure_ev: float = 0.0
    tone_mapping: str = "linear"
    channel: str = "final"
    backdrop: str = "grey"
    indirect: bool = True
    albedo_gain: float = 1.0
    roughness_scale: float = 1.0
    comparison: Comparison = ""
    photograph: int = 0
    split: float = 0.5
    """Where the right side begins, share of the width."""

    @property
    def edit(self) -> MaterialEdit:
        """The change of the material."""
        return MaterialEdit(albedo_gain=(self.albedo_gain,) * 3, roughness_scale=self.roughness_scale)

    def light_turned(self, degrees: float) -> "ViewerState":
        """Return the light turned by a further +`degrees`."""
        return replace(self, rotate_deg=wrapped(self.rotate_deg + degrees))

    def object_turned(self, degrees: float) -> "ViewerState":
        """Return the object turned by a further +`degrees`; a photograph shows it as it was."""
        return self._without_photograph(object_rotate_deg=wrapped(self.object_rotate_deg + degrees))

    def moved(self, orbit: Orbit) -> "ViewerState":
        """Return another camera; a photograph has its own, so comparing with one ends."""
        return self._without_photograph(orbit=orbit)

    def resized(self, width: int, height: int) -> "ViewerState":
        """Return a picture of another size, within limits."""
        width, height = (min(max(side, MIN_SIDE), MAX_SIDE) for side in (width, height))
        return replace(self, width=width, height=height)

    def with_number(self, name: str, value: float) -> "ViewerState":
        """Return the state with another value of a number in `LIMITS`, kept within them."""
        kept: dict[str, Any] = {name: min(max(value, LIMITS[name].low), LIMITS[name].high)}
        return replace(self, **kept)

    def stepped(self, name: str, steps: int) -> "ViewerState":
        """Return the state with a number in `LIMITS` changed by this many key steps."""
        return self.with_number(name, getattr(self, name) + steps * LIMITS[name].step)

    def with_next(self, field: str, names: tuple[str, ...], step: int = 1) -> "ViewerState":
        """Return the state with the next of `names` in a field, or the one before."""
        chosen: dict[str, Any] = {field: names[(names.index(getattr(self, field)) + step) % len(names)]}
        return replace(self, **chosen)

    def with_next_light(self, count: int, step: int = 1) -> "ViewerState":
        """Return the next of `count` environments, or the one before."""
        return self._without_photograph(light=(self.light + step) % count)

    def with_next_other_light(self, count: int) -> "ViewerState":
        """Return the next environment on the right side."""
        return replace(self, other_light=(self.other_light + 1) % count)

    def comparing_environments(self, count: int) -> "ViewerState":
        """Return a comparison with another environment, or its end where there is one."""
        if self.comparison == "environment":
            return replace(self, comparison="")
        other = self.other_light if self.other_light != self.light else (self.light + 1) % count
        return replace(self, comparison="environment", other_light=other)

    def comparing_photograph(self, photograph: int, light: int) -> "ViewerState":
        """Return a comparison with a photograph, in the light it was taken in and as it was taken."""
        return replace(
            self,
            comparison="photograph",
            photograph=photograph,
            light=light,
            rotate_deg=0.0,
            object_rotate_deg=0.0,
            channel="final",
        )

    def _without_photograph(self, **changes: Any) -> "ViewerState":
        """Return the state with changes that end a comparison with a photograph."""
        comparison = "" if self.comparison == "photograph" else self.comparison
        return replace(self, comparison=comparison, **changes)


def wrapped(degrees: float) -> float:
    """Return an angle in [-180, 180)."""
    return (degrees + 180.0) % 360.0 - 180.0

"""An environment file as given by a user: the file, its axes, and which values to replace or clamp."""

from dataclasses import dataclass
from pathlib import Path

from lambent_core.pictures import EnvironmentInput

from lambent_relight.environment.axes import from_axes
from lambent_relight.environment.layouts import LATLONG, LAYOUTS
from lambent_relight.environment.maps import Environment, load_environment
from lambent_relight.environment.sun_clamp import ClampReport, clamp_sun

__all__ = ["EnvironmentInput", "OpenedEnvironment", "open_environment"]


@dataclass(frozen=True)
class OpenedEnvironment:
    """A map in our convention, and what was done to it."""

    environment: Environment
    clamp: ClampReport | None
    """Set if a limit was requested."""

    def notes(self, name: str) -> list[str]:
        """Return one sentence for everything that a user should know about the map `name`."""
        sentences = []
        read = self.environment
        if read.read_as != LATLONG:
            height, width = read.radiance.shape[:2]
            sentences.append(
                f"{name}: read as {LAYOUTS[read.read_as]}, converted to {width} x {height} pixels"
            )
        if read.cleaning:
            sentences.append(f"{name}: replaced {read.cleaning}")
        if read.reduced_from is not None:
            (rows, columns), (height, width) = read.reduced_from, read.radiance.shape[:2]
            sentences.append(f"{name}: reduced from {columns} x {rows} to {width} x {height} pixels")
        if self.clamp is not None:
            sentences.append(f"{name}: sun clamp: {self.clamp}")
        return sentences


def open_environment(path: Path | str, given: EnvironmentInput | None = None) -> OpenedEnvironment:
    """Return the light of a file, in our convention, with values replaced and clamped as `given` specifies.

    Raises EnvironmentFileError for a file or a convention that cannot be used.
    """
    given = given or EnvironmentInput()
    environment = from_axes(load_environment(path, mend=given.mend, layout=given.layout), given.axes)
    if given.sun_clamp == 0.0:
        return OpenedEnvironment(environment, None)
    return OpenedEnvironment(*clamp_sun(environment, given.sun_clamp))

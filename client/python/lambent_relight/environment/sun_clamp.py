"""Limits the brightest texels of a map and reports the lost energy."""

import math
from dataclasses import dataclass, replace

import numpy as np
from lambent_core.directions import pixel_solid_angles
from lambent_core.errors import SettingError

from lambent_relight.environment.dominant_lights import energy
from lambent_relight.environment.maps import Environment


@dataclass(frozen=True)
class ClampReport:
    """Light removed from a map by a limit."""

    max_radiance: float
    num_texels: int
    """Texels with a channel above the limit."""
    solid_angle_sr: float
    """Of those texels; the sun has 6.8e-5."""
    brightest: float
    """Largest value before."""
    energy_before: tuple[float, ...]
    """Integral of radiance over the sphere, red, green, blue."""
    energy_after: tuple[float, ...]

    @property
    def share_lost(self) -> float:
        """Removed share of the energy of all channels together, 0 to 1."""
        before = sum(self.energy_before)
        return 1.0 - sum(self.energy_after) / before if before > 0.0 else 0.0

    def __str__(self) -> str:
        """Return one line for a terminal."""
        if not self.num_texels:
            return f"nothing is above {self.max_radiance:g} (brightest {self.brightest:g})"
        return (
            f"{self.num_texels} texels ({self.solid_angle_sr:.2g} sr) limited to {self.max_radiance:g}, "
            f"from {self.brightest:g} at most; {100.0 * self.share_lost:.1f} % of the light is gone"
        )


def clamp_sun(environment: Environment, max_radiance: float) -> tuple[Environment, ClampReport]:
    """Return the environment with no channel above `max_radiance`, and a report of the removed light.

    Texels above it are scaled as a whole, so that their hue stays. Raises SettingError for a limit that is
    not a positive number.
    """
    if not (math.isfinite(max_radiance) and max_radiance > 0.0):
        raise SettingError("relight.sun_clamp", f"limit {max_radiance}", "give a positive radiance, like 50")
    image = environment.radiance
    peaks = image.max(axis=-1)
    above = peaks > max_radiance
    factor = np.where(above, max_radiance / np.maximum(peaks, 1e-30), 1.0).astype(np.float32)
    clamped = replace(environment, radiance=np.minimum(image * factor[..., None], np.float32(max_radiance)))
    clamped = clamped if above.any() else environment
    report = ClampReport(
        max_radiance=float(max_radiance),
        num_texels=int(above.sum()),
        solid_angle_sr=float(pixel_solid_angles(*above.shape) @ above.sum(axis=1)),
        brightest=float(peaks.max()),
        energy_before=tuple(energy(image).tolist()),
        energy_after=tuple(energy(clamped.radiance).tolist()),
    )
    return clamped, report

"""Changing an object's material while relighting it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight.arguments import colour, number, refusal

Gain = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class MaterialEdit:
    """Changes to the bundle's material, everywhere on the object; colours may be arrays.

    Raises SettingError for values that no material has.
    """

    albedo_gain: Gain = (1.0, 1.0, 1.0)
    """Factor on the albedo, per channel; the result is clipped to [0, 1]."""
    roughness_scale: float = 1.0
    """Factor on perceptual roughness; the result is clipped to [0, 1]."""
    albedo: Gain | None = None
    """Linear albedo instead of the bundle's, before the gain; None keeps it."""

    def __post_init__(self) -> None:
        refuse = refusal("relight.albedo_ratio")
        gain = colour(self.albedo_gain, "albedo_gain", refuse=refuse)
        if min(gain) <= 0.0:
            raise refuse(f"albedo ratio {self.albedo_gain}", "give one or three positive numbers")
        object.__setattr__(self, "albedo_gain", gain)
        refuse = refusal("relight.roughness_scale")
        scale = number(self.roughness_scale, "roughness_scale", refuse=refuse)
        if scale < 0.0:
            raise refuse(f"roughness scale {self.roughness_scale}", "give a number from 0")
        object.__setattr__(self, "roughness_scale", scale)
        if self.albedo is not None:
            refuse = refusal("relight.albedo")
            own = colour(self.albedo, "albedo", refuse=refuse)
            if min(own) < 0.0 or max(own) > 1.0:
                raise refuse(f"albedo {self.albedo}", "give three linear values from 0 to 1")
            object.__setattr__(self, "albedo", own)

    def apply(
        self, albedo: NDArray[np.floating], perceptual_roughness: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return albedo [n, 3] and perceptual roughness [n, 1] as changed."""
        base = (
            albedo
            if self.albedo is None
            else np.broadcast_to(np.asarray(self.albedo, np.float32), albedo.shape)
        )
        changed = np.clip(base * np.asarray(self.albedo_gain, np.float32), 0.0, 1.0)
        roughness = np.clip(perceptual_roughness * np.float32(self.roughness_scale), 0.0, 1.0)
        return changed.astype(np.float32), roughness.astype(np.float32)

    def bounce_gain(self, mean_albedo: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the factor on indirect light, [3].

        Baked indirect light contains the albedo it was baked with; a change of albedo is applied as a mean
        factor. `mean_albedo` [3] is the object's.
        """
        if self.albedo is None:
            return np.asarray(self.albedo_gain, np.float32)
        changed = np.clip(np.asarray(self.albedo, np.float64) * self.albedo_gain, 0.0, 1.0)
        return (changed / np.maximum(mean_albedo, 1e-3)).astype(np.float32)

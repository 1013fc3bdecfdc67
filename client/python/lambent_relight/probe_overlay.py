"""A chrome and a grey ball in a picture's lower left corner that show its light."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import Environment
from lambent_relight.environment.prefilter import irradiance
from lambent_relight.environment.probes import Ball, chrome_ball, lit_ball
from lambent_relight.picture import RelitPicture

_SHARE = 7
"""Width of a ball as a share of the picture's shorter side."""
_GAP_SHARE = 8
"""Space next to a ball as a share of its width."""


class LightProbes:
    """Balls in one environment; rotating it does not filter it again."""

    def __init__(self, environment: Environment) -> None:
        """Filter the map for the grey ball."""
        self._environment = environment
        self._irradiance = Environment(irradiance(environment), environment.rotate_deg)

    def pair(
        self, side: int, *, rotate_deg: float = 0.0, from_deg: float = 0.0, elevation_deg: float = 0.0
    ) -> Ball:
        """Return the chrome ball and, right of it, the grey one, each `side` pixels wide."""
        place = {"from_deg": from_deg, "elevation_deg": elevation_deg}
        chrome = chrome_ball(self._environment.rotated(rotate_deg), side, **place)
        grey = lit_ball(self._irradiance.rotated(rotate_deg), side, **place)
        gap = max(side // _GAP_SHARE, 1)

        def beside(left: NDArray[np.float32], right: NDArray[np.float32]) -> NDArray[np.float32]:
            between = np.zeros((side, gap, left.shape[2]), np.float32)
            return np.concatenate([left, between, right], axis=1)

        return Ball(beside(chrome.rgb, grey.rgb), beside(chrome.opacity, grey.opacity))

    def over(self, picture: RelitPicture, camera: Camera, *, rotate_deg: float = 0.0) -> RelitPicture:
        """Return `picture` with both balls in front, as `camera` would see them in the light turned so far.

        Colour and opacity alone change, not the passes. A picture with less than 28 pixels along its shorter
        side has no room for them and stays as it is.
        """
        side = min(camera.width, camera.height) // _SHARE
        if side < 4:
            return picture
        x, y, z = camera.camera_to_world[:3, 2]
        pair = self.pair(
            side,
            rotate_deg=rotate_deg,
            from_deg=float(np.degrees(np.arctan2(y, x))),
            elevation_deg=float(np.degrees(np.arcsin(np.clip(z, -1.0, 1.0)))),
        )
        gap = max(side // _GAP_SHARE, 1)
        rows = slice(camera.height - gap - side, camera.height - gap)
        columns = slice(gap, gap + pair.rgb.shape[1])
        rgb, opacity = picture.rgb.copy(), picture.opacity.copy()
        behind = opacity[rows, columns] * (1.0 - pair.opacity)
        total = pair.opacity + behind
        mixed = pair.rgb * pair.opacity + rgb[rows, columns] * behind
        rgb[rows, columns] = mixed / np.maximum(total, np.float32(1e-6))
        opacity[rows, columns] = total
        return replace(picture, rgb=rgb, opacity=opacity)

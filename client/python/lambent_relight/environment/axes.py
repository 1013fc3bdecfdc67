"""Layouts of latitude-longitude maps in other programs, and their conversion to ours.

Each convention says which direction of its own world a map position (u to the right, v downwards, both in
[0, 1)) stands for. Worlds with y up are those of glTF: their (x, y, z) is our (x, -z, y), as in `asset.glb`.
Under these rules all four differ by turns about the vertical only:

    blender    z up   azimuth = pi - 2 pi u           ours: +x in the middle
    threejs    y up   atan2(z, x) = 2 pi u - pi       ours as well
    mitsuba    y up   atan2(x, -z) = 2 pi u           ours after -90 degrees: our +y at the left edge
    skylibs    y up   atan2(x, -z) = 2 pi u - pi      ours after +90 degrees: our +y in the middle

`mitsuba` is the emitter `envmap` without a transform.
Source: docs/reference/conventions.md (environment maps).
"""

from dataclasses import replace

import numpy as np
from lambent_core.errors import EnvironmentFileError

from lambent_relight.environment.maps import Environment

QUARTER_TURNS = {"blender": 0, "threejs": 0, "mitsuba": -1, "skylibs": 1}
"""Quarter turns about +z that make a map of each convention ours."""
OURS = "blender"


def from_axes(environment: Environment, axes: str) -> Environment:
    """Return the light of a map that was laid out in the convention `axes`, in ours.

    Exact: columns are rolled where four divides the width, else the light is turned. Raises
    EnvironmentFileError for an unknown name.
    """
    if axes not in QUARTER_TURNS:
        raise EnvironmentFileError(
            "environment.unknown_axes", f"axes {axes!r}", f"use one of {', '.join(QUARTER_TURNS)}"
        )
    quarter_turns, width = QUARTER_TURNS[axes], environment.radiance.shape[1]
    if quarter_turns == 0:
        return environment
    if width % 4:
        return environment.rotated(90.0 * quarter_turns)
    # The azimuth falls to the right, so light turned anticlockwise moves to the left.
    rolled = np.roll(environment.radiance, -quarter_turns * width // 4, axis=1)
    return replace(environment, radiance=rolled)

"""The direction that is up, judging by how the cameras were held and what EXIF says of that."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from lambent_capture.arrays import Vector64
from lambent_capture.scenes.world import common_up

AGREE = np.sin(np.radians(20.0))
"""Sine of the angle by which a camera may be held askew."""
MIN_SHARE = 0.6
"""Of the cameras that must agree on what is up."""
MIN_SPREAD = 0.05
"""Least variance of the cameras' horizontal axes along the second direction; less and any tilt would do."""


def up_direction(
    camera_to_world: Float64[ndarray, "cameras 4 4"], up_turns: Sequence[int]
) -> Vector64 | None:
    """Return the unit direction that is up, or None where the cameras do not agree on one.

    Camera axes are x right, y down, z forward in the stored picture; `up_turns` are the quarter turns
    clockwise from its upper side to where up was. Telephones that look down mistake their own pose, so some
    turns may be wrong; where most are, the cameras are taken as held level or upright, like those of others.
    """
    turned = turned_upright(camera_to_world, up_turns)
    kept = np.ones(len(turned), bool)
    for _ in range(5):
        up = _square_to(turned[kept, :3, 0], -turned[kept, :3, 1])
        if up is None:
            break
        level = (np.abs(turned[:, :3, 0] @ up) < AGREE) & (-turned[:, :3, 1] @ up > 0.0)
        if level.mean() < MIN_SHARE:
            break
        if np.array_equal(level, kept):
            return up
        kept = level
    return common_up(camera_to_world * np.array([1.0, -1.0, -1.0, 1.0]))


def turned_upright(
    camera_to_world: Float64[ndarray, "cameras 4 4"], up_turns: Sequence[int]
) -> Float64[ndarray, "cameras 4 4"]:
    """Return the poses of cameras turned about their axis so that up is at the upper side of the picture."""
    turned = camera_to_world.copy()
    for pose, turns in zip(turned, up_turns, strict=True):
        for _ in range(turns % 4):
            # What was at the right becomes the upper side, so the lower side becomes the right one.
            right, down = pose[:3, 0].copy(), pose[:3, 1].copy()
            pose[:3, 0], pose[:3, 1] = down, -right
    return turned


def _square_to(
    across: Float64[ndarray, "cameras 3"], upward: Float64[ndarray, "cameras 3"]
) -> Vector64 | None:
    """Return the direction square to all of `across` and nearest to `upward`, or None where it is not one."""
    if len(across) < 2:
        return None
    values, vectors = np.linalg.eigh(across.T @ across / len(across))
    side = upward.mean(axis=0) @ vectors[:, 0]
    if values[1] < MIN_SPREAD or abs(side) < 1e-3:
        return None
    return vectors[:, 0] * np.sign(side)

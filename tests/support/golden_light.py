"""The light of the pictures in `tests/golden/bundles`."""

import numpy as np
from lambent_relight import Environment, environment_from_array

SPP = 256
"""Directions per pixel of refined ones, in tests."""


def golden_light() -> Environment:
    """Return a map that is red in the east and blue above."""
    row, column = np.mgrid[0:8, 0:16]
    east = np.cos(2.0 * np.pi * (column - 7.5) / 16.0)
    return environment_from_array(np.stack([0.6 + 0.5 * east, 0.5 + 0.0 * east, 1.0 - row / 8.0], axis=-1))

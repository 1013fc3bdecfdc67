"""Measured figures in words, for findings, reports, pages and the command line.

A figure that is not finite, or larger than anything that is measured here, is never printed, but called not
usable.
"""

import math

NOT_USABLE = "not usable"
"""Printed in place of a figure that is none."""
LARGEST = 1e7
"""No measured figure is larger: pixels, degrees, decibels, stops, percent, seconds of a run."""


def is_usable(value: float) -> bool:
    """Return whether a figure can have been measured: finite, and no larger than `LARGEST` either way."""
    return math.isfinite(value) and abs(value) <= LARGEST


def measured(value: float, decimals: int = 0, *, signed: bool = False) -> str:
    """Return a figure with so many decimals, and with its sign if `signed`, or "not usable"."""
    if not is_usable(value):
        return NOT_USABLE
    return f"{value:{'+' if signed else ''}.{decimals}f}"


def significant(value: float, digits: int) -> str:
    """Return a figure with so many significant digits, or "not usable"."""
    return f"{value:.{digits}g}" if is_usable(value) else NOT_USABLE

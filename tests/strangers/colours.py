"""Colour formulas of the standards in numpy alone: the reference that the readers are compared with.

Colours are linear and Rec. 709 unless a name says otherwise; levels are shares of full scale, 0..1.
"""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
D65 = (0.3127, 0.3290)
D50 = (0.3457, 0.3585)
ACES_WHITE = (0.32168, 0.33767)
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""Cone responses of Bradford's chromatic adaptation. Source: ICC.1:2022, annex E."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True, slots=True)
class Space:
    """A colour space of files: primaries and white as CIE 1931 x and y, and the curve of its levels."""

    name: str
    primaries: tuple[float, ...] = REC709
    white: tuple[float, float] = D65
    curve: str | float = "srgb"
    """A name, or the exponent from levels to light."""


SPACES = {
    space.name: space
    for space in (
        Space("srgb"),
        Space("linear", curve=1.0),
        Space("p3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060)),
        Space("p3-linear", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060), curve=1.0),
        Space("adobe", (0.64, 0.33, 0.21, 0.71, 0.15, 0.06), curve=563 / 256),
        Space("rec2020", (0.708, 0.292, 0.170, 0.797, 0.131, 0.046), curve="rec709"),
        Space("rec2020-linear", (0.708, 0.292, 0.170, 0.797, 0.131, 0.046), curve=1.0),
        Space("rec709", curve="rec709"),
        Space("prophoto", (0.7347, 0.2653, 0.1596, 0.8404, 0.0366, 0.0001), D50, 1.8),
        Space("gamma22", curve=2.2),
        Space("gamma18", curve=1.8),
        Space("ap0", (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077), ACES_WHITE, 1.0),
        Space("ap1", (0.713, 0.293, 0.165, 0.830, 0.128, 0.044), ACES_WHITE, 1.0),
    )
}


def decoded(curve: str | float, levels: ndarray) -> ndarray:
    """Return light of levels; below 0 and above 1 the curves continue.

    Sources: IEC 61966-2-1 (sRGB), ITU-R BT.709-6 item 1.2 inverted.
    """
    if curve == "srgb":
        above = ((np.maximum(levels, 0.0) + 0.055) / 1.055) ** 2.4
        return np.where(levels <= 0.04045, levels / 12.92, above)
    if curve == "rec709":
        above = ((np.maximum(levels, 0.0) + 0.099) / 1.099) ** (1.0 / 0.45)
        return np.where(levels < 0.081, levels / 4.5, above)
    return np.sign(levels) * np.abs(levels) ** float(curve)


def encoded(curve: str | float, light: ndarray) -> ndarray:
    """Return the levels of light; the inverse of `decoded`."""
    light = np.maximum(light, 0.0)
    if curve == "srgb":
        return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    if curve == "rec709":
        return np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)
    return light ** (1.0 / float(curve))


def xyz_from(primaries: tuple[float, ...], white: tuple[float, float]) -> ndarray:
    """Return the matrix from linear red, green, blue to CIE XYZ. Source: SMPTE RP 177-1993."""
    corners = np.array([_xyz(x, y) for x, y in zip(primaries[::2], primaries[1::2], strict=True)]).T
    # Primaries are scaled by x + y + z = 1: AP0's blue has a negative y.
    return corners * np.linalg.solve(corners, _xyz(*white) / white[1])


def _xyz(x: float, y: float) -> ndarray:
    return np.array([x, y, 1.0 - x - y])


def adapted(white: ndarray, wanted: ndarray) -> ndarray:
    """Return Bradford's adaptation from one white to another, both as XYZ with Y = 1."""
    return np.linalg.inv(BRADFORD) @ np.diag((BRADFORD @ wanted) / (BRADFORD @ white)) @ BRADFORD


def to_rec709(space: Space) -> ndarray:
    """Return the matrix from linear colours of a space to linear Rec. 709, white to white."""
    given, wanted = xyz_from(space.primaries, space.white), xyz_from(REC709, D65)
    return np.linalg.inv(wanted) @ adapted(given.sum(axis=1), wanted.sum(axis=1)) @ given


def levels_of(light: ndarray, space: Space) -> ndarray:
    """Return the levels by which a space shows linear Rec. 709 colours, not clipped."""
    return encoded(space.curve, light @ np.linalg.inv(to_rec709(space)).T)


def light_of(levels: ndarray, space: Space) -> ndarray:
    """Return the linear Rec. 709 colours of levels; colours outside Rec. 709 have negative channels."""
    return decoded(space.curve, levels) @ to_rec709(space).T


def uncertainty(levels: ndarray, space: Space, step: float) -> ndarray:
    """Return how much light may differ where levels differ by `step` (a share of full scale)."""
    span = decoded(space.curve, np.minimum(levels + step, 1.0 + step)) - decoded(
        space.curve, np.maximum(levels - step, 0.0)
    )
    return 0.5 * span @ np.abs(to_rec709(space)).T

"""Tone curves that map linear radiance to the range of a screen.

Input and output are linear Rec. 709; results are in [0, 1] and are sRGB-encoded afterwards. They are those of
three.js with the same names, so that our viewers show the same picture. Exposure is applied first.

    linear    clipped at one: the default of `relight`
    neutral   Khronos PBR Neutral: true colours below 0.76, highlights compressed towards white
    aces      Hill's fit of the ACES reference and output transforms, on radiance / 0.6
    agx       Wrensch's fit of AgX's base look, in Rec. 2020
"""

from typing import get_args

import numpy as np
from lambent_core.errors import SettingError
from lambent_core.pictures import ToneMapping
from numpy.typing import NDArray

NAMES = get_args(ToneMapping)
_START_COMPRESSION, _DESATURATION = 0.8 - 0.04, 0.15
_ACES_IN = np.array(
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]], np.float32
)
_ACES_OUT = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]], np.float32
)
_TO_REC2020 = np.array(
    [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0113], [0.0164, 0.0880, 0.8956]], np.float32
)
_FROM_REC2020 = np.array(
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)
_AGX_INSET = np.array(
    [
        [0.856627153315983, 0.0951212405381588, 0.0482516061458583],
        [0.137318972929847, 0.761241990602591, 0.101439036467562],
        [0.11189821299995, 0.0767994186031903, 0.811302368396859],
    ],
    np.float32,
)
_AGX_OUTSET = np.array(
    [
        [1.1271005818144368, -0.11060664309660323, -0.016493938717834573],
        [-0.1413297634984383, 1.157823702216272, -0.016493938717834257],
        [-0.14132976349843826, -0.11060664309660294, 1.2519364065950405],
    ],
    np.float32,
)
_AGX_MIN_EV, _AGX_MAX_EV = -12.47393, 4.026069
_AGX_CONTRAST = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)


def tone_mapped(radiance: NDArray[np.floating], name: str) -> NDArray[np.float32]:
    """Return linear display values in [0, 1] for linear `radiance` [..., 3], through the curve `name`.

    Raises SettingError for a name that is not in `NAMES`.
    """
    if name not in NAMES:
        raise SettingError("relight.tone_mapping", f"tone mapping {name!r}", f"use one of {', '.join(NAMES)}")
    colour = np.maximum(np.asarray(radiance, np.float32), np.float32(0.0))
    if name == "neutral":
        colour = _neutral(colour)
    elif name == "aces":
        colour = _aces(colour)
    elif name == "agx":
        colour = _agx(colour)
    return np.clip(colour, 0.0, 1.0).astype(np.float32, copy=False)


def _neutral(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    darkest = colour.min(axis=-1, keepdims=True)
    colour = colour - np.where(darkest < 0.08, darkest - 6.25 * darkest * darkest, 0.04)
    peak = colour.max(axis=-1, keepdims=True)
    room = 1.0 - _START_COMPRESSION
    # Where the peak is low nothing is compressed; the maximum keeps the formula finite there.
    high = np.maximum(peak, _START_COMPRESSION)
    new_peak = 1.0 - room * room / (high + room - _START_COMPRESSION)
    share = 1.0 / (_DESATURATION * (high - new_peak) + 1.0)
    compressed = colour * (new_peak / high) * share + new_peak * (1.0 - share)
    return np.where(peak < _START_COMPRESSION, colour, compressed)


def _aces(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    v = (colour / np.float32(0.6)) @ _ACES_IN.T
    fitted = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)
    return (fitted @ _ACES_OUT.T).astype(np.float32, copy=False)


def _agx(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    inset = np.maximum(colour @ (_AGX_INSET @ _TO_REC2020).T, np.float32(1e-10))
    stops = np.clip((np.log2(inset) - _AGX_MIN_EV) / (_AGX_MAX_EV - _AGX_MIN_EV), 0.0, 1.0)
    contrast = np.polyval(_AGX_CONTRAST, stops).astype(np.float32)
    return np.maximum(contrast @ _AGX_OUTSET.T, 0.0) ** np.float32(2.2) @ _FROM_REC2020.T

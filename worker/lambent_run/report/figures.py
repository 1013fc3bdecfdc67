"""Turns arrays into small sRGB pictures for a page: photographs, maps, errors."""

import base64
import io

import numpy as np
from flashcache.evaluation import metrics
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image

MAX_SIDE = 256
ERROR_SCALE = 0.25
"""Difference in encoded values that is drawn in the brightest colour."""
NOISE_SCALE = 0.05
"""Standard error in encoded values that is drawn in the brightest colour."""
RELATIVE_SCALE = 0.6
"""Relative standard deviation of albedo that is drawn in the brightest colour."""
MATERIAL_SCALE = 0.3
"""Standard deviation of metalness and roughness that is drawn in the brightest colour."""

# Dark violet over red to pale yellow: equal steps look equally large, also in grey.
_HEAT = np.array(
    [
        [0.0, 0.0, 0.02],
        [0.27, 0.05, 0.4],
        [0.62, 0.16, 0.4],
        [0.9, 0.36, 0.26],
        [0.99, 0.68, 0.25],
        [0.99, 1.0, 0.75],
    ]
)


def picture(rgba: Float[ndarray, "height width 4"]) -> Float[ndarray, "height width 3"]:
    """Return an encoded straight-alpha picture over white, 0..1."""
    return np.clip(metrics.over_white(rgba), 0.0, 1.0)


def albedo_map(albedo: Float[ndarray, "height width 3"]) -> Float[ndarray, "height width 3"]:
    """Return linear albedo on the scale on which it is compared."""
    return metrics.with_albedo_gamma(np.clip(albedo, 0.0, 1.0))


def normal_map(
    normal: Float[ndarray, "height width 3"], alpha: Float[ndarray, "height width 1"]
) -> Float[ndarray, "height width 3"]:
    """Return unit normals as colours, world xyz from -1..1 to 0..1, white where nothing is."""
    return (normal * 0.5 + 0.5) * alpha + (1.0 - alpha)


def grey_map(
    values: Float[ndarray, "height width 1"], alpha: Float[ndarray, "height width 1"]
) -> Float[ndarray, "height width 3"]:
    """Return a map of 0..1 as grey, white where nothing is."""
    return np.repeat(np.clip(values, 0.0, 1.0) * alpha + (1.0 - alpha), 3, axis=-1)


def error_map(
    first: Float[ndarray, "height width 3"], second: Float[ndarray, "height width 3"]
) -> Float[ndarray, "height width 3"]:
    """Return the mean absolute difference over channels as heat, full scale at `ERROR_SCALE`."""
    return heat(np.abs(first - second).mean(axis=-1) / ERROR_SCALE)


def heat(values: Float[ndarray, "height width"]) -> Float[ndarray, "height width 3"]:
    """Return values in 0..1 as colours from dark to bright."""
    at = np.clip(values, 0.0, 1.0) * (len(_HEAT) - 1)
    low = np.minimum(at.astype(np.int64), len(_HEAT) - 2)
    share = (at - low)[..., None]
    return _HEAT[low] * (1.0 - share) + _HEAT[low + 1] * share


def to_bytes(values: Float[ndarray, "height width 3"]) -> UInt8[ndarray, "height width 3"]:
    """Return values in 0..1 as bytes."""
    return np.round(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


def png(values: Float[ndarray, "height width 3"], max_side: int = MAX_SIDE) -> bytes:
    """Return a picture as PNG, reduced to `max_side` pixels."""
    image = Image.fromarray(to_bytes(values))
    if max(image.size) > max_side:
        image.thumbnail((max_side, max_side), Image.Resampling.BOX)
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def data_uri(values: Float[ndarray, "height width 3"]) -> str:
    """Return a picture as a data URI, which needs no separate file."""
    return "data:image/png;base64," + base64.b64encode(png(values)).decode()


def contact_sheet(rows: list[list[Float[ndarray, "height width 3"]]]) -> Float[ndarray, "rows columns 3"]:
    """Return pictures side by side and below each other on white, in cells of the largest one's size."""
    gap = 4
    height, width = (max(values.shape[axis] for row in rows for values in row) for axis in (0, 1))
    columns = max(len(row) for row in rows)
    sheet = np.ones((len(rows) * (height + gap) - gap, columns * (width + gap) - gap, 3))
    for r, row in enumerate(rows):
        for c, values in enumerate(row):
            top, left = r * (height + gap), c * (width + gap)
            sheet[top : top + values.shape[0], left : left + values.shape[1]] = values
    return sheet

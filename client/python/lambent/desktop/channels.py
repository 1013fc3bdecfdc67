"""Channels of a relit picture as colours for the screen.

Radiance goes through exposure, tone curve and sRGB encoding, and albedo through sRGB encoding. Everything
else shows numbers: black is 0 and white is 1, normals are 0.5 n + 0.5.
"""

from collections.abc import Callable, Sequence

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_core.directions import rotate_about_z
from lambent_relight import Bundle, RelitPicture
from lambent_relight.bundle.uncertainty import UncertaintyGrid
from lambent_relight.tone_mapping import tone_mapped
from numpy.typing import NDArray

Image = NDArray[np.float32]
RADIANCE = ("final", "direct", "indirect", "diffuse", "specular")
SURFACE = ("visibility", "albedo", "roughness", "metalness", "normal", "depth")
UNCERTAIN = "uncertainty: "
"""Prefix of the channels of the bundle's uncertainty grid."""
_HEAT = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]) / 255.0
_FIELDS = {"visibility": "visibility", "roughness": "perceptual_roughness", "metalness": "metalness"}


def graded(radiance: NDArray[np.floating], exposure_ev: float = 0.0, tone_mapping: str = "linear") -> Image:
    """Return sRGB-encoded colours of linear radiance [..., 3]."""
    exposed = np.asarray(radiance, np.float32) * np.float32(2.0**exposure_ev)
    return srgb_from_linear(tone_mapped(exposed, tone_mapping)).astype(np.float32)


def channel_names(bundle: Bundle) -> tuple[str, ...]:
    """Return the names of all channels of a bundle; those of its uncertainty only if it has a grid."""
    grid = bundle.uncertainty()
    doubts = () if grid is None else grid.channels
    return (*RADIANCE, *SURFACE, *(f"{UNCERTAIN}{name.replace('_', ' ')}" for name in doubts))


def shown_channel(
    picture: RelitPicture,
    name: str,
    positions: Callable[[], NDArray[np.floating]],
    grid: UncertaintyGrid | None,
) -> tuple[Image, str]:
    """Return a channel of `picture` that is not radiance, as colours, and its legend.

    Colours [height, width, 3] are sRGB-encoded, and meaningless outside the object. The legend says what
    dark and light stand for, where that depends on the view.

    `positions` gives the surface points in the object's own frame, [height, width, 3], and is only called for
    the bundle's uncertainty, which is in `grid`.
    """
    covered = picture.coverage[..., 0] > 0.0
    if name == "albedo":
        return srgb_from_linear(picture.albedo).astype(np.float32), ""
    if name == "normal":
        return 0.5 * picture.normal + np.float32(0.5), "x, y, z as red, green, blue"
    if name == "depth":
        return _depth(picture.distance[..., 0], covered)
    if name.startswith(UNCERTAIN):
        return _doubt(name.removeprefix(UNCERTAIN).replace(" ", "_"), positions(), covered, grid)
    values = np.clip(getattr(picture, _FIELDS[name]), 0.0, 1.0)
    return np.repeat(values, 3, axis=-1), "0 black, 1 white"


def _depth(distance: Image, covered: NDArray[np.bool_]) -> tuple[Image, str]:
    """Near is white."""
    low, high = _range(distance[covered])
    near = np.clip((high - distance) / max(high - low, 1e-6), 0.0, 1.0)
    return np.repeat(near[..., None], 3, axis=-1), f"{low:.3g} white, {high:.3g} black"


def _doubt(
    name: str, positions: NDArray[np.floating], covered: NDArray[np.bool_], grid: UncertaintyGrid | None
) -> tuple[Image, str]:
    assert grid is not None, "the channel is offered only where the bundle has a grid"
    values = np.zeros(covered.shape, np.float32)
    values[covered] = grid.channel(name, positions[covered])
    # Counts have no natural end; standard deviations are shown up to one, which is to know nothing.
    top = max(float(grid.values[..., grid.channels.index(name)].max()), 1.0) if name == "views" else 1.0
    stops = np.linspace(0.0, top, len(_HEAT))
    image = np.stack([np.interp(values, stops, _HEAT[:, channel]) for channel in range(3)], axis=-1)
    return image.astype(np.float32), f"0 violet, {top:.3g} yellow"


def _range(values: Image) -> tuple[float, float]:
    return (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)


def object_positions(
    directions: NDArray[np.floating],
    eye: Sequence[float] | NDArray[np.floating],
    distance: Image,
    object_rotate_deg: float,
) -> NDArray[np.floating]:
    """Return the points that camera rays [pixel, 3] from `eye` see, in the frame of the object as bundled.

    `distance` [height, width, 1] is along the rays; the object was turned by `object_rotate_deg` about +z.
    """
    points = np.asarray(eye) + distance.reshape(-1, 1) * directions
    return rotate_about_z(points, -object_rotate_deg).reshape(*distance.shape[:2], 3)

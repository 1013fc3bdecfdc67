"""The still life: our own shapes on a plate, with their ground-truth materials."""

from typing import Any

import mitsuba as mi
import numpy as np

from sample_scenes.shapes import Surface, lathe, mesh, ring, rotation

TABLE_TOP = -0.50


def plate_picture(side: int = 512) -> np.ndarray:
    """Return the plate's glaze: cream with a ring of teal and white squares and a thin brown line."""
    y, x = np.meshgrid(np.linspace(-1.25, 1.25, side), np.linspace(-1.25, 1.25, side), indexing="ij")
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    picture = np.broadcast_to(np.array([0.72, 0.66, 0.54]), (side, side, 3)).copy()
    squares = (np.floor(angle / (2 * np.pi) * 28) + np.floor((radius - 0.70) / 0.13)) % 2 == 0
    band = (radius > 0.70) & (radius < 0.96)
    picture[band & squares] = (0.04, 0.30, 0.30)
    picture[band & ~squares] = (0.80, 0.80, 0.78)
    picture[np.abs(radius - 1.04) < 0.025] = (0.25, 0.10, 0.04)
    return picture


def ring_picture(side: int = 256) -> np.ndarray:
    """Return the torus' paint: yellow and green squares with a slow change of brightness."""
    v, u = np.meshgrid(np.arange(side) / side, np.arange(side) / side, indexing="ij")
    squares = (np.floor(u * 12) + np.floor(v * 4)) % 2 == 0
    picture = np.where(squares[..., None], np.array([0.75, 0.55, 0.08]), np.array([0.08, 0.34, 0.10]))
    return picture * (0.8 + 0.2 * np.cos(2 * np.pi * u))[..., None]


# (radius, z) from the axis below, around the outside, to the axis above.
# fmt: off
PLATE_PROFILE = np.array([
    (1e-4, -0.60), (0.50, -0.60), (0.92, -0.60), (0.98, -0.59), (1.08, -0.53), (1.14, -0.475),
    (1.155, -0.455), (1.15, -0.435), (1.13, -0.43), (1.06, -0.47), (1.00, -0.493),
    (0.94, -0.50), (0.50, -0.50), (1e-4, -0.50),
])
VASE_PROFILE = np.array([
    (1e-4, -0.500), (0.12, -0.500), (0.155, -0.495), (0.17, -0.475), (0.21, -0.40), (0.25, -0.30),
    (0.268, -0.20), (0.262, -0.10), (0.23, 0.00), (0.18, 0.09), (0.13, 0.18), (0.105, 0.27), (0.105, 0.34),
    (0.125, 0.41), (0.16, 0.46), (0.168, 0.475), (0.155, 0.48), (0.12, 0.44), (0.08, 0.36), (0.07, 0.30),
    (0.03, 0.285), (1e-4, 0.28),
])
# fmt: on

SURFACES = {
    "plate": Surface(base_colour=plate_picture(), perceptual_roughness=0.45),
    "gold": Surface(base_colour=(0.95, 0.66, 0.30), perceptual_roughness=0.28, metallic=1.0),
    "red": Surface(base_colour=(0.62, 0.05, 0.04), perceptual_roughness=0.85),
    "white": Surface(base_colour=(0.80, 0.79, 0.76), perceptual_roughness=0.65),
    "blue": Surface(base_colour=(0.05, 0.16, 0.55), perceptual_roughness=0.20),
    "ring": Surface(base_colour=ring_picture(), perceptual_roughness=0.40),
}


def objects() -> dict[str, Any]:
    """Return the still life as Mitsuba shapes."""
    place = mi.ScalarTransform4f
    red = place().translate([-0.52, -0.18, TABLE_TOP + 0.25]).rotate([0, 0, 1], 24).scale([0.22, 0.22, 0.25])
    vase = lathe(VASE_PROFILE).placed((-0.22, 0.34, 0.0))
    torus = ring(0.21, 0.075).placed((-0.06, -0.60, TABLE_TOP + 0.18), rotation(0, 34.0))
    return {
        "plate": mesh("plate", SURFACES["plate"], lathe(PLATE_PROFILE)),
        "white": mesh("white", SURFACES["white"], vase),
        "ring": mesh("ring", SURFACES["ring"], torus),
        "gold": _primitive("gold", type="sphere", center=[0.46, -0.30, TABLE_TOP + 0.34], radius=0.34),
        "blue": _primitive("blue", type="sphere", center=[0.42, 0.47, TABLE_TOP + 0.26], radius=0.26),
        "red": _primitive("red", type="cube", to_world=red),
    }


def _primitive(name: str, **shape: Any) -> dict[str, Any]:
    return shape | {"bsdf": SURFACES[name].as_mitsuba()}

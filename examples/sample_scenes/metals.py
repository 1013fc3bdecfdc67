"""Three metals on a stone slab."""

from typing import Any

import numpy as np
from tabletop.distance import ball, blend, box, carve, chain, drum, hoop, rotated, turned
from tabletop.patterns import linear, mixed, noise

from sample_scenes.shapes import Paint, Surface, lathe, mesh, rotation, rounded, solid

TOP = -0.50

SURFACES = {
    "bronze": Surface(base_colour=(0.60, 0.38, 0.19), perceptual_roughness=0.48, metallic=1.0),
    "steel": Surface(base_colour=(0.56, 0.56, 0.55), perceptual_roughness=0.32, metallic=1.0),
    "copper": Surface(base_colour=(0.93, 0.58, 0.46), perceptual_roughness=0.17, metallic=1.0),
}


def _slab(p: np.ndarray) -> np.ndarray:
    chipped = 0.006 * noise(p, 9.0, 201, 3)
    return box(p, (0, 0, TOP - 0.08), (0.90, 0.64, 0.08), 0.025) + chipped * (np.abs(p[:, 2] - TOP) > 0.012)


def _stone(p: np.ndarray) -> Paint:
    """Return grey-green stone with pale veins and specks."""
    cloud, warp = noise(p, 1.6, 202, 5), noise(p, 2.3, 203, 4)
    colour = mixed(linear("56605a"), linear("8d9488"), 0.5 + 0.5 * cloud)
    vein = np.exp(-(((noise(p + 0.25 * warp[:, None], 1.5, 204, 3) - 0.1) / 0.045) ** 2))
    colour = mixed(colour, linear("d9d4c4"), 0.8 * vein)
    speck = noise(p, 26.0, 205, 1) > 0.62
    colour = np.where(speck[:, None], 0.45 * colour, colour)
    return Paint(base_colour=colour, perceptual_roughness=0.62 + 0.08 * cloud, metallic=np.zeros(len(p)))


def _column(p: np.ndarray) -> np.ndarray:
    """Return the distance to a chess piece: a foot, a twisted shaft with four sides, collars and a ball."""
    turn = 3.0 * p[:, 2]
    q = p.copy()
    q[:, 0] = np.cos(turn) * p[:, 0] + np.sin(turn) * p[:, 1]
    q[:, 1] = -np.sin(turn) * p[:, 0] + np.cos(turn) * p[:, 1]
    wide = 0.15 - 0.09 * np.clip(p[:, 2], 0.0, 1.0)
    shaft = 0.8 * np.maximum(
        np.linalg.norm(np.maximum(np.abs(q[:, :2]) - (wide - 0.03)[:, None], 0.0), axis=-1) - 0.03,
        np.abs(p[:, 2] - 0.36) - 0.34,
    )
    foot = blend(
        drum(p, (0, 0, 0.035), 0.27, 0.035, 2, 0.02), drum(p, (0, 0, 0.09), 0.2, 0.04, 2, 0.02), 0.02
    )
    collars = np.minimum(
        drum(p, (0, 0, 0.70), 0.17, 0.025, 2, 0.02), drum(p, (0, 0, 0.76), 0.10, 0.05, 2, 0.02)
    )
    return blend(blend(blend(shaft, foot, 0.05), collars, 0.02), ball(p, (0, 0, 0.89), 0.125), 0.02)


def _beaker(p: np.ndarray) -> np.ndarray:
    """Return the distance to an open, six-sided beaker with a rim."""
    angle, radius = np.arctan2(p[:, 1], p[:, 0]), np.hypot(p[:, 0], p[:, 1])
    sector = np.mod(angle, np.pi / 3.0) - np.pi / 6.0
    grow = 0.24 + 0.06 * p[:, 2]
    flat = 0.95 * (radius * np.cos(sector) - grow)
    outside = -blend(-flat, -(np.abs(p[:, 2] - 0.24) - 0.24), 0.03)
    inside = np.maximum(flat + 0.035, 0.06 - p[:, 2])
    return blend(carve(outside, inside, 0.015), hoop(p, (0, 0, 0.06), 0.245, 0.02, 2), 0.02)


KETTLE = np.array(
    [(0.0, 0.20), (0.02, 0.235), (0.08, 0.285), (0.16, 0.315), (0.24, 0.315), (0.32, 0.28), (0.38, 0.21),
     (0.42, 0.15)]
)  # fmt: skip


def _kettle(p: np.ndarray) -> np.ndarray:
    """Return the distance to a round pot with a lid, a spout and a handle."""
    spout = chain(p, [(0.22, 0, 0.14), (0.38, 0, 0.22), (0.44, 0, 0.34), (0.52, 0, 0.40)], 0.06, 0.03)
    handle = chain(
        p,
        [(-0.2, 0, 0.36), (-0.38, 0, 0.42), (-0.47, 0, 0.30), (-0.42, 0, 0.16), (-0.29, 0, 0.10)],
        0.024,
        0.024,
    )
    lid = blend(turned(p, np.array([(0.41, 0.15), (0.44, 0.12), (0.47, 0.05), (0.49, 0.03)])),
                ball(p, (0, 0, 0.51), 0.045), 0.02)  # fmt: skip
    body = blend(blend(turned(p, KETTLE) - 0.01, spout, 0.05), handle, 0.03)
    return blend(body, lid, 0.015)


DISH = rounded(
    [(0, 0), (0.13, 0), (0.135, 0.012), (0.20, 0.03), (0.245, 0.075), (0.25, 0.08), (0.242, 0.084),
     (0.19, 0.045), (0.12, 0.024), (0, 0.022)]
)  # fmt: skip


def _link(p: np.ndarray) -> np.ndarray:
    """Return the distance to a hexagonal nut lying on its side."""
    q = rotated(p, (0, 0, 0), 1, 78.0)
    angle = np.arctan2(q[:, 1], q[:, 0])
    sector = np.mod(angle, np.pi / 3.0) - np.pi / 6.0
    flat = np.hypot(q[:, 0], q[:, 1]) * np.cos(sector) - 0.155
    outside = -blend(-flat, -(np.abs(q[:, 2]) - 0.075), 0.025)
    return carve(outside, drum(q, (0, 0, 0), 0.085, 0.3, 2), 0.02)


def objects() -> dict[str, Any]:
    """Return the group as Mitsuba shapes."""
    slab = solid(_slab, (-0.95, -0.70, TOP - 0.19), (0.95, 0.70, TOP + 0.02), 420)
    column = solid(_column, (-0.29, -0.29, -0.02), (0.29, 0.29, 1.04), 200)
    beaker = solid(_beaker, (-0.34, -0.34, -0.02), (0.34, 0.34, 0.5), 160)
    kettle = solid(_kettle, (-0.52, -0.35, -0.02), (0.58, 0.35, 0.58), 220)
    nut = solid(_link, (-0.2, -0.2, -0.2), (0.2, 0.2, 0.2), 110)
    nut = nut.placed((0, 0, -float(nut.positions[:, 2].min())))
    return {
        "slab": mesh("slab", _stone(slab.positions), slab),
        "column": mesh("column", SURFACES["bronze"], column.placed((-0.42, 0.28, TOP))),
        "beaker": mesh("beaker", SURFACES["steel"], beaker.placed((0.46, 0.34, TOP), rotation(2, 10))),
        "kettle": mesh("kettle", SURFACES["copper"], kettle.placed((0.12, -0.26, TOP), rotation(2, -28))),
        "nut": mesh("nut", SURFACES["steel"], nut.placed((-0.66, -0.30, TOP), rotation(2, 60))),
        "dish": mesh("dish", SURFACES["bronze"], lathe(DISH).placed((0.70, -0.40, TOP))),
    }

"""Kitchen metal of four kinds among things that are none; choices about metals are made on this scene."""

from typing import Any

import numpy as np
from tabletop.distance import ball as round_ball
from tabletop.distance import blend, box, carve, chain, drum, hoop
from tabletop.patterns import linear, mixed, noise
from tabletop.supports import wood

from sample_scenes.shapes import Paint, Surface, ball, lathe, mesh, rotation, rounded, solid

TOP = -0.50

SURFACES = {
    "aluminium": Surface(base_colour=(0.88, 0.88, 0.87), perceptual_roughness=0.42, metallic=1.0),
    "brass": Surface(base_colour=(0.86, 0.69, 0.35), perceptual_roughness=0.25, metallic=1.0),
    "iron": Surface(base_colour=(0.34, 0.33, 0.32), perceptual_roughness=0.55, metallic=1.0),
    "copper": Surface(base_colour=(0.92, 0.55, 0.42), perceptual_roughness=0.30, metallic=1.0),
    "enamel": Surface(base_colour=(0.07, 0.17, 0.38), perceptual_roughness=0.22),
    "cream": Surface(base_colour=(0.78, 0.72, 0.58), perceptual_roughness=0.35),
    "clay": Surface(base_colour=(0.44, 0.17, 0.09), perceptual_roughness=0.75),
}

# (radius, z) from the axis below, around the outside, to the axis above.
CANDLESTICK = rounded(
    [(0, 0), (0.19, 0), (0.19, 0), (0.195, 0.02), (0.12, 0.06), (0.055, 0.11), (0.045, 0.18), (0.085, 0.23),
     (0.05, 0.28), (0.04, 0.42), (0.06, 0.50), (0.11, 0.53), (0.12, 0.55), (0.05, 0.56), (0, 0.56)]
)  # fmt: skip
BOWL = rounded(
    [(0, 0), (0.10, 0), (0.105, 0.012), (0.19, 0.06), (0.25, 0.15), (0.262, 0.19), (0.255, 0.195),
     (0.24, 0.15), (0.18, 0.075), (0.09, 0.035), (0, 0.03)]
)  # fmt: skip
CUP = rounded(
    [(0, 0), (0.11, 0), (0.11, 0), (0.13, 0.02), (0.15, 0.12), (0.155, 0.24), (0.148, 0.245), (0.135, 0.12),
     (0.11, 0.03), (0, 0.025)]
)  # fmt: skip


def _board(p: np.ndarray) -> np.ndarray:
    return box(p, (0, 0, TOP - 0.06), (0.92, 0.66, 0.06), 0.03)


def _planks(p: np.ndarray) -> Paint:
    picture = wood(700, 1100, 5, 91, "8a6a48", "cfae7c")
    column = np.clip((p[:, 0] + 1.0) / 2.0, 0.0, 1.0) * (picture.shape[1] - 1)
    row = np.clip((p[:, 1] + 0.7) / 1.4, 0.0, 1.0) * (picture.shape[0] - 1)
    colour = np.clip(picture[row.astype(int), column.astype(int)], 0.01, 0.9)
    stain = 0.5 + 0.5 * noise(p, 2.2, 303, 4)
    colour = mixed(colour, 0.7 * colour * linear("d8c4b0"), np.clip(stain, 0.0, 1.0))
    return Paint(
        base_colour=colour, perceptual_roughness=0.58 + 0.1 * (stain - 0.5), metallic=np.zeros(len(p))
    )


def _pot(p: np.ndarray) -> np.ndarray:
    """Return the distance to an eight-sided coffee pot with a waist, a lid, a beak and a handle."""
    angle, radius = np.arctan2(p[:, 1], p[:, 0]), np.hypot(p[:, 0], p[:, 1])
    sector = np.mod(angle, np.pi / 4.0) - np.pi / 8.0
    wide = 0.17 + 0.11 * np.abs(p[:, 2] - 0.26)
    flat = 0.93 * (radius * np.cos(sector) - wide)
    body = -blend(-flat, -(np.abs(p[:, 2] - 0.27) - 0.27), 0.02)
    belt = hoop(p, (0, 0, 0.26), 0.175, 0.02, 2)
    beak = chain(p, [(0.15, 0, 0.44), (0.24, 0, 0.50), (0.27, 0, 0.53)], 0.05, 0.025)
    handle = chain(p, [(-0.17, 0, 0.50), (-0.34, 0, 0.48), (-0.36, 0, 0.34), (-0.33, 0, 0.22)], 0.028, 0.028)
    knob = blend(drum(p, (0, 0, 0.56), 0.10, 0.03, 2, 0.02), round_ball(p, (0, 0, 0.62), 0.04), 0.02)
    return blend(blend(blend(body, belt, 0.01), np.minimum(beak, handle), 0.02), knob, 0.015)


def _weight(p: np.ndarray) -> np.ndarray:
    """Return the distance to a cast weight: a block that narrows, with a bar across a hollow."""
    narrow = p.copy()
    narrow[:, :2] *= (1.0 + 0.5 * p[:, 2])[:, None]
    block = 0.85 * box(narrow, (0, 0, 0.14), (0.2, 0.16, 0.14), 0.04)
    hollow = carve(block, round_ball(p, (0, 0, 0.31), 0.11), 0.02)
    bar = chain(p, [(-0.13, 0, 0.27), (0, 0, 0.285), (0.13, 0, 0.27)], 0.025, 0.025)
    return np.minimum(hollow, bar) + 0.002 * noise(p, 14.0, 302, 2)


def objects() -> dict[str, Any]:
    """Return the group as Mitsuba shapes."""
    board = solid(_board, (-0.97, -0.70, TOP - 0.15), (0.97, 0.70, TOP + 0.02), 360)
    pot = solid(_pot, (-0.42, -0.30, -0.02), (0.34, 0.30, 0.70), 200)
    weight = solid(_weight, (-0.30, -0.26, -0.02), (0.30, 0.26, 0.34), 150)
    bowl, cup = lathe(BOWL), lathe(CUP)
    return {
        "board": mesh("board", _planks(board.positions), board),
        "pot": mesh("pot", SURFACES["aluminium"], pot.placed((0.30, 0.26, TOP), rotation(2, 140))),
        "candlestick": mesh("candlestick", SURFACES["brass"], lathe(CANDLESTICK).placed((-0.34, 0.34, TOP))),
        "weight": mesh("weight", SURFACES["iron"], weight.placed((-0.55, -0.22, TOP), rotation(2, 20))),
        "bowl": mesh("bowl", SURFACES["copper"], bowl.placed((0.52, -0.34, TOP))),
        "cup": mesh("cup", SURFACES["enamel"], cup.placed((-0.02, -0.32, TOP))),
        "egg": {**ball((0.50, -0.34, TOP + 0.16), 0.12), "bsdf": SURFACES["cream"].as_mitsuba()},
        "clay": {**ball((-0.72, 0.22, TOP + 0.15), 0.15), "bsdf": SURFACES["clay"].as_mitsuba()},
    }

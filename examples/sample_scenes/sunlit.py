"""Everyday things on a wooden board: painted china, a printed box, wood, rubber, earthenware."""

from typing import Any

import numpy as np
from tabletop.distance import blend, box, carve, chain, drum, hoop
from tabletop.patterns import linear, mixed, noise, printed
from tabletop.supports import wood

from sample_scenes.shapes import (
    Paint,
    Surface,
    Triangles,
    ball,
    block,
    lathe,
    mesh,
    rotation,
    rounded,
    solid,
    wound,
)

TOP = -0.52


def _crockery() -> np.ndarray:
    """Return the mug's picture [H, W, 3]: blue branches and red berries on white, a blue rim."""
    high, wide = 320, 900
    y, x = np.meshgrid(np.linspace(1.0, 0.0, high), np.linspace(0.0, 3.0, wide), indexing="ij")
    picture = np.broadcast_to(linear("ece8dc"), (high, wide, 3)).copy()
    branch = np.abs(y - 0.45 - 0.16 * np.sin(2 * np.pi * x)) < 0.018
    rng = np.random.default_rng(31)
    for k in range(36):
        at = k / 12.0
        side = 1.0 if k % 2 else -1.0
        middle = 0.45 + 0.16 * np.sin(2 * np.pi * at) + 0.11 * side
        dx = np.mod(x - at + 1.5, 3.0) - 1.5
        lean = side * 0.8
        along, across = dx * lean + (y - middle), dx - lean * (y - middle)
        leaf = (along / 0.09) ** 2 + (across / 0.045) ** 2 < 1.0
        berry = dx**2 + (y - middle - 0.13 * side) ** 2 < rng.uniform(0.02, 0.032) ** 2
        picture[leaf] = linear("27508f")
        picture[berry] = linear("b3322a")
    picture[branch] = linear("1c335e")
    picture[(y > 0.92) | (y < 0.06)] = linear("27508f")
    return picture


def _patches() -> np.ndarray:
    """Return the ball's picture: stripes of three colours that narrow towards the poles, worn."""
    v, u = np.meshgrid(np.arange(256) / 256, np.arange(512) / 512, indexing="ij")
    inks = np.stack([linear(c) for c in ("b5402e", "dcc06a", "3a6a57", "dcc06a")])
    picture = inks[np.floor(u * 12).astype(int) % 4]
    picture[np.abs(v - 0.5) < 0.045] = linear("2b2a33")
    return picture


def _covered(side: int = 500) -> np.ndarray:
    page = printed(side, side, 43, paper="d9b15c", picture_share=6.0)
    page[:26], page[-26:] = linear("7d2e24"), linear("7d2e24")
    return page


MUG_RADIUS, MUG_HEIGHT = 0.20, 0.42


def _mug(p: np.ndarray) -> np.ndarray:
    outside = drum(p, (0, 0, MUG_HEIGHT / 2), MUG_RADIUS, MUG_HEIGHT / 2, 2, 0.03)
    handle = hoop(p, (MUG_RADIUS + 0.02, 0, 0.22), 0.115, 0.028, 1)
    handle = np.where(p[:, 0] < 0.175, np.maximum(handle, 0.175 - p[:, 0]), handle)
    inside = drum(p, (0, 0, 0.29), MUG_RADIUS - 0.025, 0.26, 2, 0.03)
    return carve(blend(outside, handle, 0.02), inside, 0.012)


def _china(p: np.ndarray) -> Paint:
    picture = _crockery()
    across = (np.arctan2(p[:, 1], p[:, 0]) / (2.0 * np.pi) % 1.0) * (picture.shape[1] - 1)
    down = np.clip(1.0 - p[:, 2] / MUG_HEIGHT, 0.0, 1.0) * (picture.shape[0] - 1)
    outer = np.abs(np.hypot(p[:, 0], p[:, 1]) - MUG_RADIUS) < 0.008
    glaze = mixed(linear("e9e5d8"), linear("ddd6c4"), 0.5 + 0.5 * noise(p, 12.0, 206, 2))
    colour = np.where(outer[:, None], picture[down.astype(int), across.astype(int)], glaze)
    return Paint(base_colour=colour, perceptual_roughness=np.full(len(p), 0.18), metallic=np.zeros(len(p)))


def _board(p: np.ndarray) -> np.ndarray:
    board = box(p, (0, 0, TOP - 0.05), (0.94, 0.66, 0.05), 0.03)
    board = blend(board, box(p, (0.98, 0, TOP - 0.05), (0.15, 0.14, 0.045), 0.03), 0.06)
    return carve(board, drum(p, (1.04, 0, TOP), 0.05, 0.3, 2), 0.01)


def _planks(p: np.ndarray) -> Paint:
    picture = wood(700, 1100, 5, 73, "6d4424", "b7814a")
    column = np.clip((p[:, 0] + 1.05) / 2.25, 0.0, 1.0) * (picture.shape[1] - 1)
    row = np.clip((p[:, 1] + 0.72) / 1.44, 0.0, 1.0) * (picture.shape[0] - 1)
    return Paint(
        base_colour=np.clip(picture[row.astype(int), column.astype(int)], 0.01, 0.9),
        perceptual_roughness=np.full(len(p), 0.5),
        metallic=np.zeros(len(p)),
    )


def _boot(p: np.ndarray) -> np.ndarray:
    """Return the distance to a child's rubber boot, hollow."""
    leg = drum(p, (0, 0, 0.36), 0.125, 0.26, 2, 0.02)
    foot = blend(
        box(p, (0.10, 0, 0.10), (0.22, 0.105, 0.085), 0.08),
        box(p, (0.2, 0, 0.12), (0.12, 0.1, 0.1), 0.09),
        0.05,
    )
    boot = blend(leg, foot, 0.09)
    boot = blend(boot, hoop(p, (0, 0, 0.60), 0.118, 0.018, 2), 0.015)
    sole = box(p, (0.10, 0, 0.025), (0.235, 0.118, 0.025), 0.02)
    return carve(np.minimum(boot, sole), drum(p, (0, 0, 0.42), 0.10, 0.3, 2, 0.03), 0.012)


def _rubber(p: np.ndarray) -> Paint:
    sole = p[:, 2] < 0.052
    band = np.abs(p[:, 2] - 0.52) < 0.03
    colour = np.where(sole[:, None], linear("d9d2bf"), linear("8f7a1e"))
    colour = np.where((band | (p[:, 2] > 0.592))[:, None], linear("24313f"), colour)
    return Paint(
        base_colour=colour, perceptual_roughness=np.where(sole, 0.85, 0.55), metallic=np.zeros(len(p))
    )


POT = rounded(
    [(0, 0), (0.11, 0), (0.115, 0.01), (0.165, 0.22), (0.165, 0.22), (0.195, 0.225), (0.20, 0.23),
     (0.205, 0.29), (0.20, 0.30), (0.178, 0.30), (0.172, 0.29), (0.16, 0.24), (0.10, 0.04), (0, 0.035)]
)  # fmt: skip

SURFACES = {
    "pot": Surface(base_colour=(0.46, 0.17, 0.085), perceptual_roughness=0.88),
    "tyre": Surface(base_colour=(0.035, 0.035, 0.038), perceptual_roughness=0.65),
    "box": Surface(base_colour=_covered(), perceptual_roughness=0.45),
    "ball": Surface(base_colour=_patches(), perceptual_roughness=0.72),
    "saucer": Surface(base_colour=(0.72, 0.74, 0.70), perceptual_roughness=0.25),
    "spoon": Surface(base_colour=(0.40, 0.22, 0.10), perceptual_roughness=0.6),
}
SAUCER = rounded(
    [(0, 0), (0.15, 0), (0.155, 0.012), (0.25, 0.035), (0.30, 0.062), (0.302, 0.068), (0.29, 0.07),
     (0.22, 0.045), (0.14, 0.026), (0, 0.024)]
)  # fmt: skip


def _spoon(p: np.ndarray) -> np.ndarray:
    handle = chain(p, [(-0.42, 0, 0.03), (0.05, 0, 0.032), (0.2, 0, 0.03)], 0.022, 0.026)

    def egg(height: float, radii: tuple[float, float, float]) -> np.ndarray:
        return np.linalg.norm((p - np.float32([0.30, 0, height])) / np.float32(radii), axis=-1)

    bowl = blend(handle, 0.5 * egg(0.042, (1.5, 1, 0.5)) - 0.045, 0.03)
    return carve(bowl, 0.7 * egg(0.088, (1.6, 1, 0.8)) - 0.05, 0.008)


def _tyre(p: np.ndarray) -> np.ndarray:
    turn = np.arctan2(p[:, 1], p[:, 0])
    tread = 0.008 * np.sign(np.sin(26.0 * turn + 14.0 * p[:, 2])) * (np.hypot(p[:, 0], p[:, 1]) > 0.19)
    return 0.7 * (hoop(p, (0, 0, 0.075), 0.15, 0.075, 2) - tread)


def _globe(radius: float) -> Triangles:
    angle = np.linspace(-0.5 * np.pi + 1e-3, 0.5 * np.pi - 1e-3, 60)
    return wound(radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def objects() -> dict[str, Any]:
    """Return the group as Mitsuba shapes."""
    mug = solid(_mug, (-0.22, -0.22, -0.02), (0.37, 0.22, 0.44), 260)
    board = solid(_board, (-1.0, -0.72, TOP - 0.12), (1.16, 0.72, TOP + 0.02), 420)
    boot = solid(_boot, (-0.16, -0.15, -0.02), (0.36, 0.15, 0.64), 180)
    tyre = solid(_tyre, (-0.25, -0.25, -0.02), (0.25, 0.25, 0.18), 160)
    spoon = solid(_spoon, (-0.46, -0.12, -0.02), (0.46, 0.12, 0.12), 200)
    tilt = rotation(0, 50) @ rotation(1, 25)
    return {
        "board": mesh("board", _planks(board.positions), board),
        "mug": mesh("mug", _china(mug.positions), mug.placed((0.34, 0.22, TOP + 0.024), rotation(2, 25))),
        "saucer": mesh("saucer", SURFACES["saucer"], lathe(SAUCER).placed((0.34, 0.22, TOP))),
        "boot": mesh("boot", _rubber(boot.positions), boot.placed((-0.58, 0.26, TOP), rotation(2, 12))),
        "pot": mesh("pot", SURFACES["pot"], lathe(POT).placed((-0.56, -0.34, TOP))),
        "box": block((0.60, -0.36, TOP + 0.16), (0.19, 0.13, 0.16), -24)
        | {"bsdf": SURFACES["box"].as_mitsuba()},
        "ball": mesh("ball", SURFACES["ball"], _globe(0.19).placed((-0.10, -0.28, TOP + 0.19), tilt)),
        "tyre": mesh("tyre", SURFACES["tyre"], tyre.placed((-0.10, 0.38, TOP))),
        "spoon": mesh("spoon", SURFACES["spoon"], spoon.placed((0.18, -0.58, TOP), rotation(2, 6))),
        "marble": ball((0.27, -0.36, TOP + 0.06), 0.06) | {"bsdf": SURFACES["saucer"].as_mitsuba()},
    }

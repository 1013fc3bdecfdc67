"""A bookcase that is open on two sides, with things in its niches: strong occlusion under small lamps."""

from typing import Any

import numpy as np
from tabletop.distance import blend, box, carve, chain, drum, hoop
from tabletop.patterns import linear, mixed, plane_noise
from tabletop.supports import wood

from sample_scenes.shapes import Surface, ball, block, lathe, mesh, ring, rotation, rounded, solid, wound

FLOOR, TOP = -0.66, 0.62
WIDE, DEEP, BOARD = 0.86, 0.36, 0.028
SHELF = 0.5 * (FLOOR + TOP) + 0.02
COLUMNS = (-0.575, 0.0, 0.575)
LOW, HIGH = FLOOR + 0.06 + BOARD, SHELF + BOARD
"""Where things stand: the tops of the two boards."""


def _spine(seed: int) -> np.ndarray:
    """Return a book's cover: cloth with bands and a label."""
    rng = np.random.default_rng(seed)
    inks = ["7a2a22", "24456b", "3e6b45", "c9a24a", "e2d9c2", "4b3560", "ad5a2c"]
    picture = np.broadcast_to(linear(inks[seed % len(inks)]), (96, 48, 3)).copy()
    ink = linear(inks[(seed * 3 + 2) % len(inks)])
    for row in rng.integers(6, 90, 3):
        picture[row : row + 4] = ink
    picture[30:52, 8:40] = linear(inks[(seed * 5 + 4) % len(inks)])
    return np.clip(picture * (1.0 + 0.06 * plane_noise(96, 48, 1.0, seed))[..., None], 0.01, 0.9)


def _stripes(count: int, first: str, second: str) -> np.ndarray:
    """Return rings around a turned thing."""
    level = np.floor(np.arange(256) / 256 * count) % 2
    return np.broadcast_to(mixed(linear(first), linear(second), level)[:, None], (256, 8, 3)).copy()


def _carpet() -> np.ndarray:
    side = 512
    y, x = np.meshgrid(np.linspace(-1.25, 1.25, side), np.linspace(-1.25, 1.25, side), indexing="ij")
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    picture = np.broadcast_to(linear("6d3b34"), (side, side, 3)).copy()
    picture[np.abs(radius - 0.89) < 0.07] = linear("d8c9a4")
    picture[(np.abs(radius - 0.89) < 0.05) & (np.cos(36 * turn) > 0.0)] = linear("2f4f63")
    picture[radius > 0.99] = linear("2a2f3a")
    return np.clip(picture * (1.0 + 0.07 * plane_noise(side, side, 1.5, 7))[..., None], 0.01, 0.9)


VASE = rounded(
    [(0, 0), (0.07, 0), (0.085, 0.01), (0.12, 0.09), (0.125, 0.15), (0.09, 0.25), (0.05, 0.31), (0.045, 0.35),
     (0.068, 0.39), (0.06, 0.395), (0.035, 0.35), (0.035, 0.31), (0, 0.30)]
)  # fmt: skip
BOWL = rounded(
    [(0, 0), (0.08, 0), (0.085, 0.02), (0.16, 0.08), (0.205, 0.17), (0.207, 0.18), (0.197, 0.182),
     (0.19, 0.17), (0.145, 0.09), (0.08, 0.045), (0, 0.035)]
)  # fmt: skip
MAT = np.array([(1e-4, -0.69), (1.03, -0.69), (1.045, -0.685), (1.045, -0.665), (1.03, FLOOR), (1e-4, FLOOR)])

SURFACES = {
    "mat": Surface(base_colour=_carpet(), perceptual_roughness=0.9),
    "case": Surface(base_colour=(0.66, 0.62, 0.54), perceptual_roughness=0.6),
    "back": Surface(base_colour=(0.62, 0.36, 0.10), perceptual_roughness=0.8),
    "crate": Surface(base_colour=wood(256, 384, 4, 71, "8a5a30", "c79a5e"), perceptual_roughness=0.55),
    "brass": Surface(base_colour=(0.86, 0.62, 0.28), perceptual_roughness=0.25, metallic=1.0),
    "cobalt": Surface(base_colour=(0.03, 0.09, 0.42), perceptual_roughness=0.15),
    "red": Surface(base_colour=(0.60, 0.04, 0.03), perceptual_roughness=0.22),
    "white": Surface(base_colour=(0.78, 0.78, 0.75), perceptual_roughness=0.45),
    "green": Surface(base_colour=(0.07, 0.30, 0.14), perceptual_roughness=0.75),
    "clay": Surface(base_colour=(0.48, 0.19, 0.10), perceptual_roughness=0.9),
    "striped": Surface(base_colour=_stripes(14, "e8dfc8", "2c6c86"), perceptual_roughness=0.3),
}


def _jug(p: np.ndarray) -> np.ndarray:
    body = blend(drum(p, (0, 0, 0.12), 0.13, 0.12, 2, 0.06), drum(p, (0, 0, 0.30), 0.07, 0.12, 2, 0.03), 0.10)
    body = blend(body, hoop(p, (0, 0, 0.41), 0.075, 0.016, 2), 0.02)
    body = carve(body, drum(p, (0, 0, 0.36), 0.052, 0.18, 2, 0.03), 0.015)
    handle = chain(p, [(0.07, 0, 0.36), (0.17, 0, 0.37), (0.20, 0, 0.28), (0.12, 0, 0.17)], 0.016, 0.02)
    return blend(body, handle, 0.02)


def _arch(p: np.ndarray) -> np.ndarray:
    """Return the distance to a block with an arched gate through it."""
    gate = np.minimum(drum(p, (0, 0, 0.16), 0.09, 0.3, 1), box(p, (0, 0, 0.05), (0.09, 0.3, 0.11)))
    return carve(box(p, (0, 0, 0.17), (0.17, 0.08, 0.17), 0.015), gate, 0.008)


def _case() -> dict[str, Any]:
    """Return boards, uprights and the back panel in the middle."""
    middle, half = 0.5 * (FLOOR + 0.06 + TOP), 0.5 * (TOP - FLOOR - 0.06)
    case = {"bsdf": SURFACES["case"].as_mitsuba()}
    parts = {
        f"board{k}": block((0, 0, z), (WIDE + BOARD, DEEP, BOARD)) | case
        for k, z in enumerate((FLOOR + 0.06, SHELF, TOP))
    }
    for k, x in enumerate((-WIDE, -0.285, 0.285, WIDE)):
        parts[f"upright{k}"] = block((x, 0, middle), (BOARD, DEEP - 0.004, half)) | case
    parts["foot"] = block((0, 0, FLOOR + 0.02), (WIDE - 0.03, DEEP - 0.05, 0.02)) | case
    back = {"bsdf": SURFACES["back"].as_mitsuba()}
    parts["back"] = block((0, 0, middle), (WIDE - 0.01, 0.014, half)) | back
    return parts


def _books(name: str, x: float, y: float, z: float, seed: int, count: int) -> dict[str, Any]:
    """Return a row of upright books."""
    rng = np.random.default_rng(seed)
    parts: dict[str, Any] = {}
    for k in range(count):
        wide, tall, deep = rng.uniform(0.028, 0.042), rng.uniform(0.15, 0.205), rng.uniform(0.10, 0.13)
        cover = Surface(base_colour=_spine(seed + k), perceptual_roughness=float(rng.uniform(0.35, 0.75)))
        book = block((x + wide, y, z + tall), (wide, deep, tall))
        parts[f"{name}{k}"] = book | {"bsdf": cover.as_mitsuba()}
        x += 2 * wide + 0.004
    return parts


def objects() -> dict[str, Any]:
    """Return the bookcase as Mitsuba shapes."""

    def made(name: str, key: str, triangles: Any, *at: float, turn_deg: float = 0.0) -> dict[str, Any]:
        return {name: mesh(name, SURFACES[key], triangles.placed(at, rotation(2, turn_deg)))}

    def plain(name: str, key: str, shape: dict[str, Any]) -> dict[str, Any]:
        return {name: shape | {"bsdf": SURFACES[key].as_mitsuba()}}

    left, centre, right = COLUMNS
    front, rear = -0.19, 0.19
    parts = made("mat", "mat", lathe(MAT), 0, 0, 0) | _case()
    jug = solid(_jug, (-0.16, -0.16, -0.02), (0.25, 0.16, 0.45), 150)
    arch = solid(_arch, (-0.2, -0.12, -0.02), (0.2, 0.12, 0.36), 120)
    # The front, from the bottom left.
    parts |= made("jug", "brass", jug, left, front, LOW, turn_deg=-60)
    parts |= plain("box_a", "crate", block((centre, front, LOW + 0.11), (0.15, 0.11, 0.11), 12))
    parts |= plain("ball_a", "red", ball((centre - 0.02, front, LOW + 0.33), 0.11))
    parts |= _books("book_a", right - 0.21, front, LOW, 80, 5)
    parts |= made("vase_a", "striped", wound(VASE), left - 0.08, front, HIGH)
    parts |= plain("ball_b", "cobalt", ball((left + 0.13, front - 0.03, HIGH + 0.085), 0.085))
    parts |= made("bowl_a", "cobalt", lathe(BOWL), centre, front + 0.01, HIGH)
    parts |= plain("ball_c", "clay", ball((centre + 0.03, front, HIGH + 0.15), 0.10))
    parts |= made("arch_a", "white", arch, right, front, HIGH, turn_deg=14)
    # The rear.
    parts |= _books("book_b", left - 0.20, rear, LOW, 91, 4)
    parts |= plain("ball_d", "green", ball((left + 0.17, rear + 0.02, LOW + 0.09), 0.09))
    parts |= made("vase_b", "red", wound(VASE), centre, rear, LOW)
    parts |= made("arch_b", "clay", arch, right, rear, LOW, turn_deg=-10)
    parts |= made("ring_a", "white", ring(0.10, 0.04), left, rear, HIGH + 0.04)
    parts |= plain("ball_e", "white", ball((left, rear, HIGH + 0.16), 0.09))
    parts |= plain("box_b", "green", block((centre - 0.05, rear, HIGH + 0.14), (0.10, 0.08, 0.14), -18))
    parts |= made("bowl_b", "striped", wound(BOWL), right, rear - 0.01, HIGH)
    # On top and beside.
    parts |= made("bowl_c", "brass", lathe(1.15 * BOWL), 0.42, -0.02, TOP + BOARD)
    parts |= plain("box_c", "crate", block((-0.45, 0.03, TOP + BOARD + 0.08), (0.2, 0.14, 0.08), 22))
    parts |= plain("ball_f", "clay", ball((-0.72, -0.68, FLOOR + 0.14), 0.14))
    return parts | made("ring_b", "cobalt", ring(0.14, 0.05), 0.55, 0.72, FLOOR + 0.05)

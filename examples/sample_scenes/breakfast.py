"""The sample: a brass jug, a glazed bowl with lemons, an apple, a pear and a folded cloth on a board."""

from typing import Any

import numpy as np
from tabletop.distance import ball, blend, carve, chain, hoop, rod, turned
from tabletop.patterns import linear, mixed, noise, plane_noise
from tabletop.supports import wood

from sample_scenes.shapes import Paint, Surface, Triangles, lathe, mesh, rotation, rounded, solid

TOP, RIM = -0.52, 1.02
"""Height of the board's top, and its radius."""
# fmt: off
BOARD = rounded([
    (0, -0.60), (0.6, -0.60), (RIM - 0.03, -0.60), (RIM, -0.585), (RIM + 0.01, -0.56), (RIM, -0.532),
    (RIM - 0.02, TOP), (RIM - 0.05, TOP), (0.6, TOP), (0, TOP),
], steps=6)
BOWL_OUTSIDE = rounded([
    (0, 0), (0.16, 0), (0.17, 0), (0.175, 0.02), (0.17, 0.045), (0.25, 0.09), (0.345, 0.18),
    (0.395, 0.29), (0.405, 0.335),
])
BOWL_INSIDE = rounded([
    (0.405, 0.335), (0.40, 0.348), (0.388, 0.345), (0.38, 0.33), (0.365, 0.27), (0.32, 0.185), (0.23, 0.105),
    (0.12, 0.066), (0, 0.058),
])
APPLE = rounded([
    (0, 0.03), (0.03, 0.012), (0.07, 0.0), (0.125, 0.03), (0.185, 0.115), (0.20, 0.20), (0.185, 0.275),
    (0.13, 0.335), (0.075, 0.345), (0.035, 0.325), (0.012, 0.29), (0, 0.28),
])
PEAR = rounded([
    (0, 0.02), (0.03, 0.0), (0.08, 0.005), (0.15, 0.06), (0.182, 0.15), (0.165, 0.235), (0.12, 0.32),
    (0.088, 0.39), (0.075, 0.44), (0.05, 0.475), (0.02, 0.482), (0, 0.478),
])
JUG = rounded([
    (0.150, 0.0), (0.168, 0.012), (0.172, 0.03), (0.166, 0.05), (0.185, 0.08), (0.228, 0.14),
    (0.253, 0.21), (0.257, 0.28), (0.238, 0.36), (0.194, 0.44), (0.150, 0.52), (0.123, 0.60), (0.116, 0.68),
    (0.128, 0.76), (0.150, 0.83), (0.160, 0.86),
])[:, ::-1]
"""Height and radius of the jug's outside."""
HANDLE = rounded([
    (0.14, 0.76), (0.24, 0.80), (0.345, 0.77), (0.40, 0.68), (0.395, 0.56), (0.34, 0.45), (0.235, 0.36),
], steps=5)
# fmt: on
JUG_WALL = 0.014


def _jug(p: np.ndarray) -> np.ndarray:
    """Return the distance to a jug whose handle is at +x and whose lip is at -x."""
    q = p.copy()
    # The mouth is drawn out to a lip.
    pull = np.clip((p[:, 2] - 0.68) / 0.18, 0.0, 1.0) ** 2 * np.clip(-p[:, 0] / 0.13, 0.0, 1.5) ** 2
    narrow = np.exp(-((p[:, 1] / 0.09) ** 2))
    q[:, 0] = p[:, 0] + 0.05 * pull * narrow
    q[:, 2] = p[:, 2] - 0.025 * pull * narrow
    outside = turned(q, JUG)
    inner = JUG[JUG[:, 0] > 0.07] - [0.0, JUG_WALL + 0.004]
    inner = np.concatenate([inner, [[0.90, inner[-1, 1] + 0.012]]])
    body = carve(outside, turned(q, inner), 0.012)
    body = blend(body, hoop(p, (0, 0, 0.045), 0.163, 0.010, 2), 0.012)
    # The other half is further from the handle than any fillet reaches.
    handle, near = np.ones(len(p), np.float32), p[:, 0] > 0.05
    handle[near] = chain(p[near], [(x, 0.0, z) for x, z in HANDLE], 0.024, 0.020)
    cut = -outside - JUG_WALL
    return 0.8 * blend(body, np.maximum(handle, cut), 0.03)


def _lemon(p: np.ndarray) -> np.ndarray:
    body = blend(ball(p, (0, 0, 0), (0.165, 0.125, 0.125)), rod(p, (-0.15, 0, 0), (0.15, 0, 0), 0.035), 0.05)
    body = blend(body, ball(p, (0.188, 0, 0), 0.022), 0.03)
    return body + 0.0035 * noise(p, 20.0, 301, 1)


def _peel(p: np.ndarray) -> Paint:
    shade = noise(p, 6.0, 302, 3)
    colour = mixed(linear("e3a80e"), linear("f2c92c"), 0.5 + 0.5 * shade)
    tip = np.clip((np.abs(p[:, 0]) - 0.165) / 0.03, 0.0, 1.0)
    colour = mixed(colour, linear("a9a03a"), 0.7 * tip)
    return Paint(base_colour=colour, perceptual_roughness=np.full(len(p), 0.42), metallic=np.zeros(len(p)))


def _apple_skin(p: np.ndarray) -> Paint:
    """Return a red skin with streaks, yellow around the stem and on the side away from the sun."""
    angle, radius = np.arctan2(p[:, 1], p[:, 0]), np.hypot(p[:, 0], p[:, 1])
    around = np.stack([np.cos(angle), np.sin(angle), 0.25 * p[:, 2]], axis=-1).astype(np.float32)
    streak = noise(around, 9.0, 303, 3) + 0.5 * noise(around, 2.0, 304, 2)
    hollow = np.exp(-((radius / 0.07) ** 2)) * (p[:, 2] > 0.2)
    ripe = 0.95 + 0.35 * np.cos(angle - 0.6) + 0.40 * streak - 1.1 * hollow
    colour = mixed(linear("d3a73a"), mixed(linear("b3231d"), linear("6e0f14"), 0.5 + 0.6 * streak), ripe)
    dots = noise(p, 34.0, 305, 1) > 0.72
    colour = np.where(dots[:, None], mixed(colour, linear("e0b46a"), np.full(len(p), 0.45)), colour)
    return Paint(base_colour=colour, perceptual_roughness=np.full(len(p), 0.22), metallic=np.zeros(len(p)))


def _pear_skin(p: np.ndarray) -> Paint:
    blush = 0.4 + 0.6 * np.cos(np.arctan2(p[:, 1], p[:, 0]) - 2.0) + 0.5 * noise(p, 5.0, 306, 3)
    colour = mixed(linear("8f9a35"), linear("b9a13c"), 0.5 + 0.5 * noise(p, 4.0, 307, 3))
    colour = mixed(colour, linear("a4592a"), 0.55 * np.clip(blush, 0.0, 1.0))
    dots = noise(p, 30.0, 308, 1) > 0.62
    colour = np.where(dots[:, None], 0.62 * colour, colour)
    return Paint(base_colour=colour, perceptual_roughness=np.full(len(p), 0.5), metallic=np.zeros(len(p)))


def _board_picture() -> np.ndarray:
    """Return the board's wood with a darker rim; texture coordinates are x and y from -1.25 to 1.25."""
    side = 1000
    picture = wood(side, side, 7, 75, "55341d", "9c6d42")
    y, x = np.meshgrid(np.linspace(-1.25, 1.25, side), np.linspace(-1.25, 1.25, side), indexing="ij")
    groove = np.exp(-(((np.hypot(x, y) - (RIM - 0.09)) / 0.008) ** 2))
    return np.clip(picture * (1.0 - 0.6 * groove)[..., None], 0.01, 0.9).astype(np.float32)


def _linen(height: int = 640, width: int = 900) -> np.ndarray:
    """Return woven linen: threads of uneven strength, blue stripes along one edge and across, a hem."""
    y, x = np.meshgrid(np.linspace(0, 1, height), np.linspace(0, 1, width), indexing="ij")
    threads = 0.10 * np.cos(2 * np.pi * 110 * x) * np.cos(2 * np.pi * 80 * y)
    slubs = 0.05 * plane_noise(height, width, 1.0, 309) + 0.05 * plane_noise(height, width, 5.0, 310)
    picture = np.broadcast_to(linear("e4dcc8"), (height, width, 3)).copy()
    for low, high in ((0.07, 0.10), (0.12, 0.20), (0.22, 0.25), (0.75, 0.78), (0.80, 0.88), (0.90, 0.93)):
        picture[(y > low) & (y < high)] = linear("35578a")
    across = ((0.06, 0.08), (0.095, 0.16), (0.175, 0.195), (0.805, 0.825), (0.84, 0.905), (0.92, 0.94))
    for low, high in across:
        band = (x > low) & (x < high)
        picture[band] = 0.45 * picture[band] + 0.55 * linear("b8482f")
    edge = np.minimum(np.minimum(x, 1 - x) * width, np.minimum(y, 1 - y) * height)
    picture[(edge > 9) & (edge < 12)] *= 0.7
    return np.clip(picture * (1.0 + threads + slubs)[..., None], 0.01, 0.9).astype(np.float32)


def _sheet(points: np.ndarray, thickness: float) -> Triangles:
    """Return a closed sheet around the grid `points` [rows, columns, 3]."""
    along, across = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normals = np.cross(along, across)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    rows, columns = points.shape[:2]
    v, u = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    grid = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (grid[i, j].ravel() for i in (np.s_[:-1], np.s_[1:]) for j in (np.s_[:-1], np.s_[1:]))
    top = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)])
    loop = np.concatenate([grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0]])
    after = np.roll(loop, -1)
    upper = points + 0.5 * thickness * normals
    lower = points - 0.5 * thickness * normals
    count = rows * columns
    flat, top_edge, low_edge = (each.reshape(-1, 3) for each in (points, upper, lower))
    # The rim has vertices of its own, whose normals face outwards.
    outward = np.cross(flat[after] - flat[np.roll(loop, 1)], normals.reshape(-1, 3)[loop])
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    k = np.arange(len(loop))
    n = np.roll(k, -1)
    first, second = 2 * count, 2 * count + len(loop)
    rim = np.concatenate(
        [np.stack([first + k, second + k, first + n], -1), np.stack([first + n, second + k, second + n], -1)]
    )
    return Triangles(
        positions=np.concatenate([top_edge, low_edge, top_edge[loop], low_edge[loop]]),
        normals=np.concatenate([normals.reshape(-1, 3), -normals.reshape(-1, 3), outward, outward]),
        uv=np.concatenate([uv, uv, uv[loop], uv[loop]]),
        faces=np.concatenate([top, top[:, ::-1] + count, rim]),
    )


def _napkin() -> Triangles:
    """Return a cloth folded in half, in waves, that hangs over the board's edge."""
    length, width, gap = 0.94, 0.52, 0.030
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 360), np.linspace(0.0, 1.0, 180))
    bend = np.pi * 0.5 * gap
    upper, lower = 0.46 * width * 2, 0.54 * width * 2
    way = s * (upper + bend + lower)
    turn = np.clip((way - lower) / (0.5 * gap), 0.0, np.pi)
    x = np.minimum(way, lower) + 0.5 * gap * np.sin(turn) - np.maximum(way - lower - bend, 0.0)
    h = 0.5 * gap * (1.0 - np.cos(turn))
    layer = turn / np.pi
    y = (t - 0.5) * length + 0.03 * layer * (x / width - 0.5)
    x = x - 0.55 * lower
    # Waves along the cloth, higher towards the free edges; the upper layer lifts a little off the lower.
    free = 0.25 + 0.75 * np.clip(1.2 * (0.30 - x) / 0.6, 0.0, 1.0)
    wave = 0.5 + 0.5 * np.sin(9.5 * y + 2.2 * x + 0.8 * np.sin(5.0 * x) + 0.6)
    ripple = 0.5 + 0.5 * np.sin(17.0 * y - 6.0 * x + 1.0)
    h = 0.008 + h + free * (0.050 * wave**2 + 0.014 * ripple) + 0.012 * layer * free * np.sin(6.0 * y + 1.0)
    flat = np.stack([x, y, np.zeros_like(x)], axis=-1) @ rotation(2, -152).T + np.array([-0.46, -0.56, 0.0])
    # Over the board's edge the cloth goes round a quarter of a circle and then straight down.
    radius = np.hypot(flat[..., 0], flat[..., 1])
    over, round_off = np.maximum(radius - (RIM - 0.03), 0.0), 0.045
    angle = np.minimum(over / round_off, 0.5 * np.pi)
    beyond = np.maximum(over - 0.5 * np.pi * round_off, 0.0)
    reach = np.minimum(radius, RIM - 0.03) + (round_off + h) * np.sin(angle)
    z = TOP + h * np.cos(angle) - round_off * (1.0 - np.cos(angle)) - beyond
    return _sheet(np.stack([flat[..., 0] / radius * reach, flat[..., 1] / radius * reach, z], axis=-1), 0.010)


SURFACES = {
    "board": Surface(base_colour=_board_picture(), perceptual_roughness=0.5),
    "jug": Surface(base_colour=(0.87, 0.62, 0.29), perceptual_roughness=0.28, metallic=1.0),
    "glaze": Surface(base_colour=(0.02, 0.20, 0.22), perceptual_roughness=0.12),
    "inside": Surface(base_colour=(0.72, 0.66, 0.52), perceptual_roughness=0.16),
    "cloth": Surface(base_colour=_linen(), perceptual_roughness=0.95),
    "stem": Surface(base_colour=(0.10, 0.055, 0.025), perceptual_roughness=0.8),
}


def _stem(p: np.ndarray) -> np.ndarray:
    return chain(p, [(0, 0, 0), (0.004, 0, 0.05), (0.018, 0.004, 0.10)], 0.009, 0.012)


def objects() -> dict[str, Any]:
    """Return the still life as Mitsuba shapes."""
    jug = solid(_jug, (-0.30, -0.30, -0.02), (0.46, 0.30, 0.92), 240)
    lemon = solid(_lemon, (-0.23, -0.15, -0.15), (0.24, 0.15, 0.15), 110)
    apple, pear = lathe(APPLE, 160), lathe(PEAR, 160)
    stem = solid(_stem, (-0.02, -0.02, -0.02), (0.04, 0.03, 0.125), 60)
    bowl = np.array([0.41, -0.22, TOP])
    at_apple, at_pear = np.array([-0.20, -0.11, TOP + 0.010]), np.array([0.50, 0.52, TOP + 0.208])
    lying = rotation(2, -35) @ rotation(1, 100)
    lemons = [
        lemon.placed(bowl + np.array([-0.122, 0.063, 0.222]), rotation(2, 70) @ rotation(1, -14)),
        lemon.placed(bowl + np.array([0.150, 0.027, 0.232]), rotation(2, 125) @ rotation(1, 20)),
    ]
    return {
        "board": mesh("board", SURFACES["board"], lathe(BOARD, 192)),
        "jug": mesh("jug", SURFACES["jug"], jug.placed((-0.24, 0.42, TOP), rotation(2, 140))),
        "bowl": mesh("bowl", SURFACES["glaze"], lathe(BOWL_OUTSIDE, 192).placed(bowl)),
        "bowl_inside": mesh("bowl_inside", SURFACES["inside"], lathe(BOWL_INSIDE, 192).placed(bowl)),
        "cloth": mesh("cloth", SURFACES["cloth"], _napkin()),
        "apple": mesh("apple", _apple_skin(apple.positions), apple.placed(at_apple, rotation(0, 8))),
        "apple_stem": mesh(
            "apple_stem", SURFACES["stem"], stem.placed(at_apple + np.array([0, -0.04, 0.28]))
        ),
        "pear": mesh("pear", _pear_skin(pear.positions), pear.placed(at_pear, lying)),
    } | {f"lemon_{k}": mesh(f"lemon_{k}", _peel(lemon.positions), placed) for k, placed in enumerate(lemons)}

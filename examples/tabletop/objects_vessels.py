"""A printed mug, and an enamel teapot with brass fittings and a wooden handle."""

import numpy as np

from tabletop.distance import blend, box, carve, chain, drum, hoop, turned
from tabletop.patterns import linear, mixed, noise, printed


def mug_distance(p: np.ndarray) -> np.ndarray:
    """Return the distance to a hollow mug, 8 cm wide, with a handle towards +x."""
    outside = drum(p, (0, 0, 0.49), 0.42, 0.49, 2, 0.05)
    handle = hoop(p, (0.45, 0, 0.5), 0.29, 0.075, 1)
    handle = np.where(p[:, 0] < 0.36, np.maximum(handle, 0.36 - p[:, 0]), handle)
    inside = drum(p, (0, 0, 0.62), 0.365, 0.55, 2, 0.06)
    return carve(blend(outside, handle, 0.05), inside, 0.03)


def mug_paint(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a cream glaze with a printed band around, a blue rim and a dark inside."""
    page = printed(1400, 460, 11, paper="f4ead2", picture_share=2.6)
    across = (np.arctan2(p[:, 1], p[:, 0]) / (2.0 * np.pi) % 1.0) * (page.shape[1] - 1)
    down = np.clip((0.86 - p[:, 2]) / 0.72, 0.0, 1.0) * (page.shape[0] - 1)
    speck = noise(p, 14.0, 12, 3)
    glaze = mixed(linear("ece3cf"), linear("d9c9a6"), 0.4 + 0.5 * speck)
    radius = np.hypot(p[:, 0], p[:, 1])
    band = (np.abs(radius - 0.42) < 0.012) & (np.abs(p[:, 2] - 0.5) < 0.36) & (n[:, 2] ** 2 < 0.2)
    band &= ~((p[:, 0] > 0.3) & (np.abs(p[:, 1]) < 0.15))
    glaze = np.where(band[:, None], page[down.astype(int), across.astype(int)], glaze)
    rim = mixed(linear("1d4f91"), linear("2b6cb8"), 0.5 + speck)
    glaze = np.where((p[:, 2] > 0.94)[:, None], rim, glaze)
    inside = (radius < 0.385) & (p[:, 2] < 0.94) & (p[:, 2] > 0.04)
    glaze = np.where(inside[:, None], mixed(linear("a8552d"), linear("c56f3d"), 0.5 + speck), glaze)
    handle = (p[:, 0] > 0.46) & (radius > 0.46)
    glaze = np.where(handle[:, None], mixed(linear("1d4f91"), linear("3277c4"), 0.5 + speck), glaze)
    return glaze, np.where(band, 0.32, 0.2), np.zeros(len(p))


# fmt: off
POT = np.array([
    (0.0, 0.52), (0.05, 0.58), (0.12, 0.62), (0.3, 0.78), (0.55, 0.88), (0.8, 0.84), (1.0, 0.7), (1.12, 0.52),
    (1.2, 0.46),
])
LID = np.array([(1.17, 0.47), (1.22, 0.47), (1.3, 0.38), (1.37, 0.2), (1.4, 0.09), (1.46, 0.07), (1.5, 0.1)])
# fmt: on
SPOUT = [(0.68, 0, 0.5), (1.02, 0, 0.62), (1.25, 0, 0.88), (1.38, 0, 1.14), (1.58, 0, 1.27)]
BAIL = [
    (-0.42, 0.0),
    (-0.62, 0.3),
    (-0.5, 0.55),
    (-0.2, 0.68),
    (0.2, 0.68),
    (0.5, 0.55),
    (0.62, 0.3),
    (0.42, 0.0),
]


def _teapot_parts(p: np.ndarray) -> dict[str, np.ndarray]:
    body = blend(turned(p, POT) - 0.01, chain(p, SPOUT, 0.22, 0.1), 0.12)
    body = carve(body, chain(p, [*SPOUT[3:], (1.72, 0, 1.34)], 0.06, 0.075), 0.02)
    ring = np.minimum(hoop(p, (0, 0, 1.18), 0.485, 0.03, 2), hoop(p, (0, 0, 0.05), 0.58, 0.035, 2))
    arch = [(x, 0.0, 1.12 + z) for x, z in BAIL]
    wire = chain(p, arch, 0.035, 0.035)
    ear = np.minimum(
        box(p, (-0.44, 0, 1.12), (0.07, 0.1, 0.07), 0.02), box(p, (0.44, 0, 1.12), (0.07, 0.1, 0.07), 0.02)
    )
    return {
        "enamel": np.minimum(body, turned(p, LID) - 0.008),
        "brass": np.minimum(np.minimum(ring, wire), ear),
        "wood": np.minimum(
            drum(p, (0, 0, 1.8), 0.085, 0.26, 0, 0.05),
            np.linalg.norm(p - np.float32([0, 0, 1.56]), axis=-1) - 0.1,
        ),
    }


def teapot_distance(p: np.ndarray) -> np.ndarray:
    """Return the distance to the teapot, its lid and its bail."""
    return np.minimum.reduce(list(_teapot_parts(p).values()))


def teapot_paint(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return teal enamel with painted flowers and worn spots down to the iron, brass and turned wood."""
    parts = _teapot_parts(p)
    part = np.argmin(np.abs(np.stack(list(parts.values()))), axis=0)
    speck = noise(p, 9.0, 21, 4)
    colour = mixed(linear("1f6f74"), linear("2f8d8e"), 0.5 + 0.5 * speck)
    turn, up = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    for k, (angle, height) in enumerate(
        [(0.9, 0.6), (1.75, 0.45), (2.5, 0.75), (-0.8, 0.5), (-1.7, 0.7), (-2.6, 0.5), (3.1, 0.4)]
    ):
        du = (np.mod(turn - angle + np.pi, 2.0 * np.pi) - np.pi) * 0.85
        far, petal = np.hypot(du, up - height), np.arctan2(up - height, du)
        size = 0.17 + 0.03 * (k % 3)
        ink = linear(["e7d9b8", "d9553f", "e8b23c"][k % 3])
        flower = far < size * (0.72 + 0.28 * np.cos((5 + k % 3) * petal + k))
        colour = np.where(flower[:, None], ink, colour)
        colour = np.where((far < 0.05)[:, None], linear("5a2417"), colour)
    band = (np.abs(up - 1.02) < 0.05) & (np.sin(28.0 * turn) > 0.0)
    colour = np.where(band[:, None], linear("f0e6cc"), colour)
    iron = noise(p, 4.0, 22, 4) > 1.12
    colour = np.where(iron[:, None], mixed(linear("4a3d36"), linear("7a5a44"), 0.5 + speck), colour)
    rough, metal = np.where(iron, 0.6, 0.22), np.where(iron, 0.7, 0.0)
    brass = mixed(linear("d9ad58"), linear("b98a3c"), 0.5 + 0.6 * speck)
    grain = noise(p * np.float32([0.6, 5.0, 5.0]), 4.0, 23, 4)
    wood = mixed(linear("7a4a26"), linear("a56d3c"), 0.5 + 0.8 * grain)
    colour = np.where((part == 1)[:, None], brass, np.where((part == 2)[:, None], wood, colour))
    rough = np.where(part == 1, 0.32, np.where(part == 2, 0.55, rough))
    return colour, rough, np.where(part == 1, 1.0, np.where(part == 2, 0.0, metal))

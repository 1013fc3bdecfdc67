"""A black lacquered cat with gold bands, and a tin robot."""

import numpy as np

from tabletop.distance import ball, blend, box, carve, chain, drum, hoop, rod, rotated
from tabletop.patterns import linear, mixed, noise


def cat_distance(p: np.ndarray) -> np.ndarray:
    """Return the distance to a sitting cat whose tail stands off its back."""
    body = blend(
        ball(p, (-0.25, 0, 0.55), (0.6, 0.52, 0.56)), ball(p, (0.1, 0, 1.05), (0.38, 0.36, 0.52)), 0.25
    )
    for side in (-1.0, 1.0):
        body = blend(body, ball(p, (-0.15, 0.42 * side, 0.32), (0.42, 0.2, 0.33)), 0.08)
        body = blend(body, rod(p, (0.3, 0.2 * side, 0.95), (0.45, 0.19 * side, 0.12), 0.15, 0.12), 0.1)
        body = blend(body, ball(p, (0.52, 0.19 * side, 0.1), (0.2, 0.13, 0.11)), 0.05)
    head = blend(
        ball(p, (0.3, 0, 1.66), (0.4, 0.42, 0.36)), ball(p, (0.6, 0, 1.55), (0.15, 0.19, 0.13)), 0.08
    )
    for side in (-1.0, 1.0):
        ear = rod(p, (0.24, 0.26 * side, 1.85), (0.2, 0.34 * side, 2.12), 0.16, 0.03)
        head = blend(head, carve(ear, ball(p, (0.36, 0.3 * side, 1.98), (0.1, 0.08, 0.14)), 0.03), 0.05)
        head = carve(head, ball(p, (0.66, 0.17 * side, 1.74), 0.075), 0.03)
    tail = [(-0.72, 0, 0.3), (-0.92, 0.08, 0.55), (-0.9, 0.16, 0.9), (-0.72, 0.14, 1.18), (-0.62, 0.05, 1.42)]
    whole = blend(blend(body, head, 0.12), chain(p, tail, 0.11, 0.08), 0.08)
    collar = np.hypot(np.hypot(p[:, 0] - 0.2, p[:, 1]) - 0.33, (p[:, 2] - 1.38) * 0.6) - 0.05
    return np.maximum(np.minimum(whole, collar), -p[:, 2])


def cat_paint(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return black lacquer with gold scrolls, a gold collar and red-brown wear."""
    cloud = noise(p, 4.0, 31, 4)
    colour = mixed(linear("15141a"), linear("241a1c"), 0.5 + 0.6 * cloud)
    scroll = np.sin(7.0 * np.arctan2(p[:, 1], p[:, 0] + 0.2) + 3.0 * np.sin(5.0 * p[:, 2])) * np.sin(
        9.0 * p[:, 2]
    )
    gold = (np.abs(scroll - 0.55) < 0.10) & (p[:, 2] < 1.25) & (p[:, 2] > 0.15)
    gold |= np.abs(np.hypot(np.hypot(p[:, 0] - 0.2, p[:, 1]) - 0.33, (p[:, 2] - 1.38) * 0.6) - 0.05) < 0.004
    gold |= np.linalg.norm(np.abs(p) - np.float32([0.66, 0.17, 1.74]), axis=-1) < 0.1
    gold |= (np.abs(np.mod(p[:, 2] * 6.0, 1.0) - 0.5) < 0.13) & (p[:, 0] < -0.62) & (p[:, 2] > 0.35)
    worn = (noise(p, 7.0, 32, 3) > 1.02) & ~gold
    colour = np.where(gold[:, None], mixed(linear("e2b04a"), linear("c08a2e"), 0.5 + cloud), colour)
    colour = np.where(worn[:, None], linear("5a2a1c"), colour)
    rough = np.where(gold, 0.28, np.where(worn, 0.5, 0.12 + 0.03 * cloud))
    return colour, rough, gold * 1.0


def _robot_parts(p: np.ndarray) -> dict[str, np.ndarray]:
    chest = box(p, (0, 0, 1.2), (0.42, 0.55, 0.5), 0.07)
    chest = carve(chest, box(p, (0.45, 0, 1.3), (0.07, 0.36, 0.26), 0.02), 0.02)
    head = np.minimum(
        box(p, (0.02, 0, 2.05), (0.34, 0.38, 0.27), 0.09), drum(p, (0, 0, 1.74), 0.2, 0.08, 2, 0.02)
    )
    limbs = []
    for side in (-1.0, 1.0):
        q = rotated(p, (0, 0.62 * side, 1.5), 1, 22.0 * side)
        arm = rod(q, (0, 0.74 * side, 1.48), (0.05, 0.84 * side, 0.92), 0.11, 0.09)
        hand = hoop(q, (0.07, 0.86 * side, 0.74), 0.13, 0.05, 0)
        limbs += [arm, carve(hand, box(q, (0.07, 0.86 * side, 0.6), (0.1, 0.06, 0.1)), 0.01)]
        limbs += [box(p, (0, 0.28 * side, 0.42), (0.17, 0.17, 0.32), 0.04)]
        limbs += [box(p, (0.1, 0.3 * side, 0.11), (0.38, 0.22, 0.12), 0.06)]
    aerials = [rod(p, (0, 0.25 * s, 2.3), (-0.04, 0.36 * s, 2.56), 0.025) for s in (-1, 1)]
    balls = [ball(p, (-0.04, 0.37 * s, 2.6), 0.07) for s in (-1, 1)]
    return {
        "tin": np.minimum(chest, head),
        "limbs": np.minimum.reduce(limbs),
        "brass": np.minimum.reduce(
            [drum(p, (0, 0.6 * s, 1.5), 0.15, 0.1, 1, 0.03) for s in (-1, 1)] + aerials
        ),
        "knobs": np.minimum.reduce(
            [*balls, drum(p, (-0.5, 0, 1.2), 0.05, 0.16, 0), box(p, (-0.68, 0, 1.2), (0.03, 0.2, 0.06), 0.02)]
        ),
        "eyes": np.minimum.reduce([drum(p, (0.36, 0.17 * s, 2.1), 0.11, 0.06, 0, 0.03) for s in (-1, 1)]),
    }


def robot_distance(p: np.ndarray) -> np.ndarray:
    """Return the distance to the robot."""
    return np.minimum.reduce(list(_robot_parts(p).values()))


def robot_paint(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return painted tin with rivets, dials and stripes, worn to the metal at the edges, and brass joints."""
    parts = _robot_parts(p)
    part = np.argmin(np.abs(np.stack(list(parts.values()))), axis=0)
    worn = noise(p, 6.0, 41, 4)
    colour = mixed(linear("b8412f"), linear("cf5a3c"), 0.5 + 0.6 * worn)
    stripes = (np.abs(p[:, 2] - 0.95) < 0.14) & (np.floor((p[:, 2] - 0.81) / 0.07) % 2 == 0) & (part == 0)
    colour = np.where(stripes[:, None], linear("f0dfb4"), colour)
    front = (p[:, 0] > 0.3) & (np.abs(p[:, 1]) < 0.36) & (np.abs(p[:, 2] - 1.3) < 0.26) & (part == 0)
    colour = np.where(front[:, None], linear("22313f"), colour)
    for y, z, ink in [
        (-0.2, 1.42, "e8c23c"),
        (0.0, 1.42, "e9e4d4"),
        (0.2, 1.42, "58a05c"),
        (-0.16, 1.18, "e9e4d4"),
    ]:
        far, turn = np.hypot(p[:, 1] - y, p[:, 2] - z), np.arctan2(p[:, 2] - z, p[:, 1] - y)
        dial = front & (far < 0.085)
        colour = np.where(dial[:, None], linear(ink), colour)
        colour = np.where(
            (dial & ((np.cos(8 * turn) > 0.8) & (far > 0.055)))[:, None], linear("181818"), colour
        )
    bars = front & (p[:, 1] > 0.0) & (np.abs(p[:, 2] - 1.17) < 0.09) & (np.mod(p[:, 1], 0.06) < 0.035)
    colour = np.where(bars[:, None], linear("d95f3a"), colour)
    back = (p[:, 0] < -0.35) & (part == 0) & (p[:, 2] < 1.65)
    cells = np.sin(np.floor(p[:, 1] / 0.08) * 12.99 + np.floor(p[:, 2] / 0.08) * 78.23) * 43758.5
    code = np.modf(np.abs(cells))[0]
    label = back & (np.abs(p[:, 1]) < 0.36) & (np.abs(p[:, 2] - 1.45) < 0.13)
    colour = np.where((label & (code > 0.5))[:, None], linear("f0dfb4"), colour)
    limbs = mixed(linear("2f5f86"), linear("4780aa"), 0.5 + 0.6 * worn)
    limbs = np.where((np.mod(p[:, 2], 0.18) < 0.05)[:, None], linear("e3d7b5"), limbs)
    colour = np.where((part == 1)[:, None], limbs, colour)
    bare = (noise(p, 5.0, 42, 4) > 1.0) & (part < 2)
    colour = np.where(bare[:, None], linear("8d8b88"), colour)
    rough, metal = np.where(bare, 0.38, 0.3 + 0.05 * worn), bare * 0.9
    flats = [("e0b458", 0.28, 1.0), ("e2c03a", 0.35, 0.0), ("e9e7df", 0.15, 0.0)]
    for k, (ink, roughness, metalness) in enumerate(flats, start=2):
        colour = np.where((part == k)[:, None], linear(ink) * (1.0 + 0.15 * worn)[:, None], colour)
        rough, metal = np.where(part == k, roughness, rough), np.where(part == k, metalness, metal)
    pupil = (part == 4) & (np.hypot(np.abs(p[:, 1]) - 0.17, p[:, 2] - 2.1) < 0.055)
    return np.where(pupil[:, None], linear("15181c"), colour), rough, metal

"""A painted wooden elephant on wheels, and a white porcelain rabbit with a relief."""

import numpy as np

from tabletop.distance import ball, blend, box, carve, chain, drum, rod, rotated
from tabletop.patterns import linear, mixed, noise

TRUNK = [(1.1, 0, 1.28), (1.38, 0, 1.12), (1.52, 0, 0.86), (1.58, 0, 0.62), (1.7, 0, 0.52), (1.84, 0, 0.56)]
WHEELS = [(x, y) for x in (-0.78, 0.78) for y in (-0.53, 0.53)]


def _ears(p: np.ndarray) -> np.ndarray:
    sides = []
    for side in (-1.0, 1.0):
        q = rotated(p, (0.72, 0.4 * side, 1.4), 2, -28.0 * side)
        thin = ball(q, (0.62, 0.47 * side, 1.34), (0.36, 0.075, 0.42))
        sides.append(carve(thin, ball(q, (0.66, 0.60 * side, 1.34), (0.24, 0.1, 0.30)), 0.04))
    return np.minimum(*sides)


def _elephant_parts(p: np.ndarray) -> dict[str, np.ndarray]:
    body = ball(p, (-0.05, 0, 1.12), (0.88, 0.52, 0.54))
    for x in (-0.58, 0.48):
        for y in (-0.24, 0.24):
            body = blend(body, rod(p, (x, y, 0.95), (x, y, 0.42), 0.21, 0.19), 0.16)
    head = blend(ball(p, (0.84, 0, 1.38), 0.42), chain(p, TRUNK, 0.2, 0.1), 0.18)
    tusks = np.minimum.reduce(
        [
            chain(p, [(1.1, 0.2 * s, 1.12), (1.32, 0.26 * s, 0.98), (1.5, 0.27 * s, 1.02)], 0.055, 0.025)
            for s in (-1, 1)
        ]
    )
    tail = chain(p, [(-0.9, 0, 1.2), (-1.08, 0, 1.05), (-1.16, 0, 0.82), (-1.22, 0, 0.66)], 0.05, 0.04)
    tail = np.minimum(tail, ball(p, (-1.24, 0, 0.6), (0.06, 0.06, 0.1)))
    return {
        "skin": np.minimum(blend(blend(body, head, 0.2), tail, 0.06), _ears(p)),
        "tusks": tusks,
        "board": box(p, (0.0, 0, 0.34), (1.18, 0.44, 0.09), 0.04),
        "wheels": np.minimum.reduce([drum(p, (x, y, 0.26), 0.26, 0.075, 1, 0.03) for x, y in WHEELS]),
        "axles": np.minimum.reduce([drum(p, (x, 0, 0.26), 0.07, 0.65, 1, 0.02) for x in (-0.78, 0.78)]),
        "knob": blend(rod(p, (-0.05, 0, 1.6), (-0.05, 0, 1.78), 0.09), ball(p, (-0.05, 0, 1.83), 0.14), 0.05),
    }


def elephant_distance(p: np.ndarray) -> np.ndarray:
    """Return the distance to the elephant, its board and its wheels."""
    return np.minimum.reduce(list(_elephant_parts(p).values()))


def elephant_paint(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the paint: grey-blue skin, a red blanket with diamonds, a lettered green board, brass axles."""
    parts = _elephant_parts(p)
    names = list(parts)
    part = np.argmin(np.abs(np.stack(list(parts.values()))), axis=0)
    worn = noise(p, 5.0, 1, 4)
    colour = mixed(linear("5d7389"), linear("7f93a4"), 0.5 + 0.6 * worn)
    rough, metal = 0.55 + 0.06 * worn, np.zeros(len(p))
    blanket = (np.abs(p[:, 0] + 0.05) < 0.42) & (p[:, 2] > 0.86) & (part == names.index("skin"))
    around = np.arctan2(p[:, 1], p[:, 2] - 1.12) * 1.1
    cloth = (np.floor((p[:, 0] + around) / 0.14) + np.floor((p[:, 0] - around) / 0.14)) % 2
    cloth_colour = mixed(linear("b3261e"), linear("e8b53a"), cloth)
    cloth_colour = mixed(
        cloth_colour, linear("1c4f8c"), (np.abs(np.abs(p[:, 0] + 0.05) - 0.37) < 0.035) * 1.0
    )
    colour = np.where(blanket[:, None], cloth_colour, colour)
    rough = np.where(blanket, 0.75, rough)
    inner = (np.abs(n[:, 1]) > 0.6) & (_ears(p) < 0.02) & (np.abs(p[:, 1]) > 0.42) & (p[:, 0] > 0.4)
    colour = np.where(inner[:, None], mixed(linear("c98f8a"), linear("b06f6c"), 0.5 + worn), colour)
    for side in (-1.0, 1.0):
        eye = np.linalg.norm(p - np.float32([1.15, 0.26 * side, 1.52]), axis=-1)
        colour = np.where((eye < 0.085)[:, None], linear("f0efe8"), colour)
        colour = np.where((eye < 0.055)[:, None], linear("101014"), colour)
    grain = noise(p * np.float32([1.0, 6.0, 6.0]), 3.0, 2, 4)
    board = mixed(linear("2f6b3d"), linear("4c8a4f"), 0.5 + 0.8 * grain)
    edge = (np.abs(p[:, 2] - 0.34) < 0.045) & (np.abs(n[:, 2]) < 0.5)
    marks = np.floor(np.where(np.abs(n[:, 1]) > 0.5, p[:, 0], p[:, 1]) / 0.09) * 12.9898
    marks = np.modf(np.abs(np.sin(marks) * 43758.5))[0]
    board = np.where((edge & (marks > 0.45))[:, None], linear("f0d9a0"), board)
    spokes = np.minimum.reduce(
        [np.hypot(p[:, 0] - x, p[:, 2] - 0.26) + 9.0 * (np.abs(p[:, 0] - x) > 0.35) for x in (-0.78, 0.78)]
    )
    turn = np.arctan2(p[:, 2] - 0.26, np.abs(p[:, 0]) - 0.78)
    wheel = mixed(linear("c03a28"), linear("e9c14b"), ((spokes < 0.2) & (np.cos(5.0 * turn) > 0.1)) * 1.0)
    wheel = wheel * (1.0 + 0.12 * worn)[:, None]
    flats = {
        "tusks": (mixed(linear("e9dfc4"), linear("d0bd92"), 0.5 + worn), 0.35, 0.0),
        "board": (board, 0.6, 0.0),
        "wheels": (wheel, 0.4, 0.0),
        "axles": (np.broadcast_to(linear("d6a84e"), colour.shape), 0.3, 1.0),
        "knob": (mixed(linear("e2b23c"), linear("c98d1f"), 0.5 + worn), 0.3, 0.0),
    }
    for name, (paint, roughness, metalness) in flats.items():
        here = part == names.index(name)
        colour = np.where(here[:, None], paint, colour)
        rough, metal = np.where(here, roughness, rough), np.where(here, metalness, metal)
    return colour, rough, metal


def _relief(p: np.ndarray) -> np.ndarray:
    """Return waves around the body, and leaves between them: what stands out, -1 to 1."""
    turn, up = np.arctan2(p[:, 1], p[:, 0]), p[:, 2]
    leaves = np.cos(9.0 * turn + 5.0 * np.sin(4.0 * up)) * np.cos(11.0 * up)
    return np.tanh(3.0 * leaves)


def rabbit_distance(p: np.ndarray) -> np.ndarray:
    """Return the distance to a sitting rabbit with a relief on its body and a collar."""
    body = ball(p, (-0.12, 0, 0.72), (0.78, 0.62, 0.74)) - 0.016 * _relief(p)
    body = blend(body, ball(p, (0.22, 0, 1.15), (0.42, 0.4, 0.5)), 0.25)
    for side in (-1.0, 1.0):
        body = blend(body, ball(p, (-0.1, 0.46 * side, 0.42), (0.52, 0.26, 0.44)), 0.06)
        body = blend(body, rod(p, (0.25, 0.3 * side, 0.12), (0.72, 0.36 * side, 0.1), 0.13, 0.11), 0.06)
        body = blend(body, rod(p, (0.42, 0.17 * side, 0.8), (0.68, 0.16 * side, 0.14), 0.13, 0.12), 0.1)
    head = blend(
        ball(p, (0.48, 0, 1.68), (0.45, 0.37, 0.38)), ball(p, (0.82, 0, 1.58), (0.2, 0.2, 0.17)), 0.12
    )
    for side in (-1.0, 1.0):
        q = rotated(p, (0.3, 0.16 * side, 1.95), 1, -14.0)
        ear = ball(q, (0.3, 0.2 * side, 2.3), (0.17, 0.1, 0.5))
        ear = carve(ear, ball(q, (0.44, 0.21 * side, 2.3), (0.11, 0.07, 0.38)), 0.03)
        head = blend(head, ear, 0.06)
        head = carve(head, ball(p, (0.8, 0.3 * side, 1.76), 0.07), 0.03)
    collar = np.hypot(np.hypot(p[:, 0] - 0.36, p[:, 1]) - 0.4, p[:, 2] - 1.42) - 0.055
    whole = np.minimum(blend(body, head, 0.14), collar)
    whole = blend(whole, ball(p, (-0.86, 0, 0.4), 0.17) - 0.012 * noise(p, 12.0, 3, 2), 0.05)
    return np.maximum(whole, -p[:, 2])


def rabbit_paint(p: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return white porcelain, a little darker in the relief's grooves, with faint crackle and a few chips."""
    groove = np.clip(-_relief(p), 0.0, 1.0) * (p[:, 2] < 1.35)
    crackle = np.exp(-((noise(p, 3.0, 4, 4) / 0.035) ** 2))
    white = mixed(linear("efede8"), linear("dcd4c6"), 0.35 * groove + 0.18 * crackle)
    chips = noise(p, 6.0, 5, 2) > 1.02
    white = np.where(chips[:, None], linear("cdbba0"), white)
    eyes = np.linalg.norm(p * np.float32([1, 0, 1]) - np.float32([0.78, 0, 1.76]), axis=-1) < 0.06
    white = np.where((eyes & (np.abs(p[:, 1]) > 0.2))[:, None], linear("6a6d78"), white)
    return white, np.where(chips, 0.8, 0.42 + 0.1 * groove), np.zeros(len(p))

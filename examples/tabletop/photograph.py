"""Pictures of a whole scene at a fraction of a path tracer's cost, without its noise.

Surroundings are shaded at a quarter of the resolution (radiance divided by base colour, averaged over the
neighbourhood on the same face of the same shape) and multiplied by their base colour at full resolution: a
shadow's edge is about four pixels soft. The object is path traced pixel by pixel, and its noise averaged
over neighbours of like colour and normal.
"""

import cv2
import mitsuba as mi
import numpy as np

from tabletop.cameras import Camera
from tabletop.tracing import NUM_FACES, FirstHits, coverage_of, first_hits, number_of, radiance, radiance_of

REDUCTION = 4
COVERAGE_SIDE = 4
DULL = 3.0
"""How much less light a path may bring from the surroundings than from the object."""
FLOOR = 0.02
"""Added to base colours before dividing by them."""
OFFSETS = ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75))


def photograph(
    scene: "mi.Scene", thing: "mi.Shape", camera: Camera, spp: int, seed: int, limit: float
) -> np.ndarray:
    """Return linear radiance and true coverage [H, W, 4] of what `camera` sees, without sensor noise.

    Light of paths beyond `limit`, far above white, is cut off.
    """
    shape = (camera.height, camera.width)
    hits = [first_hits(scene, camera, *offset) for offset in OFFSETS]
    own = number_of(thing)
    inside = np.stack([_is(hit, own) for hit in hits]).mean(axis=0).reshape(shape)
    near = cv2.dilate((inside > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    pixels = np.flatnonzero(near)
    traced = np.zeros((camera.height * camera.width, 4))
    traced[pixels] = radiance_of(scene, thing, camera, pixels, spp, seed, limit)
    traced = _calm(traced.reshape(*shape, 4), hits[0], near)
    behind = surroundings(scene, camera, hits, own, spp, seed, limit)
    covered = np.zeros(camera.height * camera.width)
    covered[pixels] = coverage_of(scene, thing, camera, pixels, COVERAGE_SIDE)
    seen = traced[..., :3] + (1.0 - traced[..., 3:]) * behind
    return np.concatenate([seen, covered.reshape(*shape, 1)], axis=-1)


def surroundings(
    scene: "mi.Scene",
    camera: Camera,
    hits: list[FirstHits],
    own: int,
    spp: int,
    seed: int,
    limit: float,
) -> np.ndarray:
    """Return the radiance [H, W, 3] of everything but the object, continued behind its outline."""
    shape = (camera.height, camera.width)
    coarse = camera.resized(camera.width // REDUCTION)
    middle = first_hits(scene, coarse, 0.5, 0.5)
    light = radiance(scene, coarse, spp, seed + 500_000, limit=limit / DULL)
    # A pixel's mean radiance belongs to its mean colour, which four rays estimate.
    colour = np.mean([first_hits(scene, coarse, *offset).colour for offset in OFFSETS], axis=0)
    shading = light.reshape(-1, 3) / (colour + FLOOR)
    total, count = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    for label in np.unique(np.concatenate([hit.label for hit in hits])):
        if label // NUM_FACES == own:
            continue
        seen = [(hit.label == label).reshape(shape) for hit in hits]
        smooth = _spread(shading, middle.label == label, coarse, shape) if label >= 0 else None
        for hit, here in zip(hits, seen, strict=True):
            colours = hit.colour.reshape(*shape, 3)[here]
            total[here] += colours if smooth is None else (colours + FLOOR) * smooth[here]
            count[here] += 1.0
    blurred = (
        cv2.GaussianBlur(total, (0, 0), 1.5)
        / np.maximum(cv2.GaussianBlur(count, (0, 0), 1.5), 1e-4)[..., None]
    )
    return np.where(count[..., None] > 0, total / np.maximum(count, 1.0)[..., None], blurred)


def _is(hit: FirstHits, number: int) -> np.ndarray:
    return hit.label // NUM_FACES == number


def _spread(shading: np.ndarray, here: np.ndarray, coarse: Camera, shape: tuple[int, int]) -> np.ndarray:
    """Return the shading of one face at full size: its mean over nearby coarse pixels of that face.

    Far around where it is even, close by where it changes: at the edge of a shadow.
    """
    size = (coarse.height, coarse.width)
    weight = here.reshape(size).astype(np.float32)
    value = (shading * here[:, None]).reshape(*size, 3).astype(np.float32)
    if not here.any():
        return np.broadcast_to(np.median(shading, axis=0).astype(np.float32), (*shape, 3))
    # Where the face has hardly a coarse pixel of its own, one from further away is better than none.
    wide, close = _mean_around(value, weight, 5.0), _mean_around(value, weight, 0.9)
    mid = _mean_around(value, weight, 2.2)
    change = np.abs(mid - wide).mean(axis=-1) / np.maximum(wide.mean(axis=-1), 1e-4)
    even = np.exp(-((change / 0.06) ** 2))[..., None]
    near_change = np.abs(close - mid).mean(axis=-1) / np.maximum(mid.mean(axis=-1), 1e-4)
    middling = np.exp(-((near_change / 0.12) ** 2))[..., None]
    chosen = even * wide + (1.0 - even) * (middling * mid + (1.0 - middling) * close)
    return cv2.resize(chosen, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)


def _mean_around(value: np.ndarray, weight: np.ndarray, sigma: float) -> np.ndarray:
    """Return the mean [h, w, 3] of weighted values within `sigma` pixels, of further ones where none is."""
    everywhere = value.sum(axis=(0, 1)) / weight.sum()
    above, below = cv2.GaussianBlur(value, (0, 0), sigma), cv2.GaussianBlur(weight, (0, 0), sigma)
    far_above, far_below = cv2.GaussianBlur(value, (0, 0), 12.0), cv2.GaussianBlur(weight, (0, 0), 12.0)
    above = above + 1e-3 * far_above + 1e-7 * everywhere
    below = below + 1e-3 * far_below + 1e-7
    return above / below[..., None]


def _calm(traced: np.ndarray, hit: FirstHits, near: np.ndarray) -> np.ndarray:
    """Return the object's premultiplied radiance, its noise averaged over like neighbours (5 x 5)."""
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    if not len(rows):
        return traced
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shape = near.shape
    part = traced[box].astype(np.float32)
    colour = hit.colour.reshape(*shape, 3)[box].astype(np.float32)
    normal = hit.normal.reshape(*shape, 3)[box].astype(np.float32)
    full = part[..., 3] > 0.999
    straight = part[..., :3] / np.maximum(part[..., 3:], 1e-3)
    divided = straight / (colour + 0.06)
    total, weights = np.zeros_like(divided), np.zeros(full.shape, np.float32)
    for down in range(-2, 3):
        for right in range(-2, 3):

            def moved(values: np.ndarray, shift: tuple[int, int] = (down, right)) -> np.ndarray:
                return np.roll(values, shift, axis=(0, 1))

            unlike = ((moved(normal) - normal) ** 2).sum(-1) / 0.03
            unlike += ((moved(colour) - colour) ** 2).sum(-1) / 0.01
            weight = np.exp(-unlike - (down**2 + right**2) / 4.5) * (full & moved(full))
            total += weight[..., None] * moved(divided)
            weights += weight
    calm = total / np.maximum(weights, 1e-6)[..., None] * (colour + 0.06) * part[..., 3:]
    result = traced.copy()
    result[box][..., :3] = np.where(full[..., None], calm, part[..., :3])
    return result

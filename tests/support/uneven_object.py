"""Three balls of different sizes, so that no turn or mirror image looks the same, and cameras around them."""

import numpy as np
from numpy import ndarray
from support.captures import look_at

SIDE = 40
FOCAL = 48.0
DISTANCE = 3.6
NUM_VIEWS = 16
BALLS = (((0.0, 0.0, -0.2), 0.7), ((0.75, 0.2, 0.3), 0.45), ((-0.2, -0.55, 0.75), 0.3))


def poses(offset: ndarray | None = None, scale: float = 1.0) -> list[ndarray]:
    """Return camera-to-world matrices (camera axes x right, y up, z backward) all around the object."""
    middle = np.zeros(3) if offset is None else np.asarray(offset)
    found = []
    for index in range(NUM_VIEWS):
        height = -0.75 + 1.5 * (index + 0.5) / NUM_VIEWS
        angle = 2.4 * index
        flat = np.sqrt(1.0 - height**2)
        spot = DISTANCE * np.array([flat * np.cos(angle), flat * np.sin(angle), height])
        pose = look_at(spot)
        pose[:3, 3] = scale * spot + middle
        found.append(pose)
    return found


def coverage(
    pose: ndarray, side: int = SIDE, *, offset: ndarray | None = None, scale: float = 1.0
) -> ndarray:
    """Return the silhouette [side, side] of the object: 255 on it, 0 beside it."""
    middle = np.zeros(3) if offset is None else np.asarray(offset)
    focal = FOCAL * side / SIDE
    rows, columns = np.mgrid[:side, :side] + 0.5
    rays = np.stack(
        [(columns - side / 2) / focal, -(rows - side / 2) / focal, -np.ones((side, side))], axis=-1
    )
    rays = rays @ pose[:3, :3].T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    hit = np.zeros((side, side), dtype=bool)
    for centre, radius in BALLS:
        to_centre = scale * np.array(centre) + middle - pose[:3, 3]
        along = rays @ to_centre
        hit |= to_centre @ to_centre - along**2 < (scale * radius) ** 2
    return np.where(hit, 255, 0).astype(np.uint8)


def colours(seed: int, side: int = SIDE) -> ndarray:
    """Return a picture [side, side, 3] that is different for every seed."""
    return np.random.default_rng(seed).integers(30, 220, (side, side, 3)).astype(np.uint8)

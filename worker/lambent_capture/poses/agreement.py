"""Finds photographs that were placed against the evidence of their own matches.

Where a pattern repeats, or an object looks alike from several sides, the mapper may fit a photograph to the
wrong place. Its matches with most other photographs then contradict the cameras.
"""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from jaxtyping import Float64
from numpy import ndarray

from lambent_capture.arrays import Rotation64

AGREE_PX = 4.0
"""Work pixels of Sampson error up to which a match agrees with the cameras; as in verification."""
MIN_SHARE = 0.5
"""Of a photograph's matches that must agree with its camera."""


def contradicted(model: Any, database: Path) -> list[int]:
    """Return the numbers (of COLMAP) of images most of whose verified matches contradict their cameras.

    A wrong image makes matches of right ones disagree too, so the worst is taken out first, until all that
    are left agree.
    """
    agreeing = _agreements(model, database)
    left = set(model.reg_image_ids())
    wrong: list[int] = []
    while True:
        shares = {image: share for image in left if (share := _share(agreeing, image, left)) is not None}
        worst = min(shares, key=lambda image: (shares[image], image), default=None)
        if worst is None or shares[worst] >= MIN_SHARE:
            return wrong
        wrong.append(worst)
        left.remove(worst)


def _share(agreeing: dict[int, dict[int, tuple[int, int]]], image: int, others: set[int]) -> float | None:
    """Return the share of an image's matches with `others` that agree, or None where it has none."""
    counts = np.array([agreeing[image][other] for other in sorted(agreeing[image]) if other in others])
    return float(counts[:, 0].sum() / counts[:, 1].sum()) if counts.size else None


def _agreements(model: Any, database: Path) -> dict[int, dict[int, tuple[int, int]]]:
    """Return for each image and each it was matched with how many matches agree, and how many there are."""
    poses, rays = {}, {}
    for number in model.reg_image_ids():
        image = model.image(number)
        camera = model.camera(image.camera_id)
        poses[number] = image.cam_from_world()
        rays[number] = camera.cam_from_img(np.array([point.xy for point in image.points2D]).reshape(-1, 2))
    focal = {number: model.camera(model.image(number).camera_id).params[0] for number in poses}
    with pycolmap.Database.open(database) as opened:
        pairs, geometries = opened.read_two_view_geometries()
    counts: dict[int, dict[int, tuple[int, int]]] = defaultdict(dict)
    for pair, geometry in zip(pairs, geometries, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair)
        matches = geometry.inlier_matches
        if not len(matches) or first not in poses or second not in poses:
            continue
        essential = pycolmap.essential_matrix_from_pose(poses[second] * poses[first].inverse())
        errors = _sampson(rays[first][matches[:, 0]], rays[second][matches[:, 1]], essential)
        good = int((errors * np.sqrt(focal[first] * focal[second]) < AGREE_PX).sum())
        counts[first][second] = counts[second][first] = good, len(matches)
    return counts


def _sampson(
    here: Float64[ndarray, "matches 2"], there: Float64[ndarray, "matches 2"], essential: Rotation64
) -> Float64[ndarray, " matches"]:
    """Return the distance of matches from agreeing with an essential matrix, to first order.

    Source: Hartley and Zisserman 2004, Eq. 11.9.
    """
    ones = np.ones((len(here), 1))
    first, second = np.hstack([here, ones]), np.hstack([there, ones])
    onward, back = first @ essential.T, second @ essential
    product = np.abs((second * onward).sum(axis=1))
    slope = (onward[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return product / np.sqrt(np.maximum(slope, 1e-24))

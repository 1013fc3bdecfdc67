"""COLMAP's database of a capture: lenses, photographs, their points, and which of them match.

Photographs are named by their number (`as_stored`), because COLMAP separates names with spaces. Everything in
it is in work pixels (`features`), and portrait photographs are turned by a quarter so that they share a lens
with landscape ones; `model` turns them back.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from jaxtyping import Float32
from numpy import ndarray

from lambent_capture.poses.features import Features, work_scale
from lambent_capture.poses.shots import Shot

GUESSED_FOCAL = 1.2
"""Focal length over longer side where EXIF does not say; COLMAP's own guess."""
BLOCK = 24
"""Pairs that are matched between two looks at whether the work shall stop."""
STILL_PX = 2.0
"""Work pixels that a point has to move between two photographs: what stands still tells nothing of depth."""
MODEL = "SIMPLE_RADIAL"


@contextmanager
def quiet() -> Iterator[None]:
    """Keep COLMAP from writing what it does to standard error, but for errors."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


def as_stored(number: int) -> str:
    """Return the name that the database has for a photograph."""
    return f"{number:06d}"


def create_database(path: Path, shots: Sequence[Shot], features: Sequence[Features], max_side: int) -> None:
    """Write a database with lenses and points, whole or not at all.

    Focal lengths that EXIF states count as known when pairs are verified (not in `verify_again`); they are
    refined either way.
    """
    partial = path.with_name(path.name + ".tmp")
    partial.unlink(missing_ok=True)
    with pycolmap.Database.open(partial) as database:
        rigs: dict[tuple[object, ...], tuple[int, int]] = {}
        for number, (shot, seen) in enumerate(zip(shots, features, strict=True)):
            if shot.lens not in rigs:
                rigs[shot.lens] = _write_lens(database, shot, max_side)
            camera, rig = rigs[shot.lens]
            image = pycolmap.Image(name=as_stored(number), camera_id=camera)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            database.write_keypoints(image.image_id, lying(seen.points, shot, max_side))
            descriptors = pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, seen.descriptors)
            database.write_descriptors(image.image_id, descriptors)
    partial.replace(path)


def lying(points: Float32[ndarray, "points 4"], shot: Shot, max_side: int) -> Float32[ndarray, "points 4"]:
    """Return points as in the photograph turned to landscape: a portrait one is turned clockwise."""
    if not shot.is_portrait:
        return points
    x, y, size, angle = points.T
    height = shot.height * work_scale(shot.width, shot.height, max_side)
    return np.stack([height - y, x, size, angle + np.float32(0.5 * np.pi)], axis=1).astype(np.float32)


def match_pairs(
    path: Path,
    pairs: Sequence[tuple[int, int]],
    seed: int,
    told: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Match and verify pairs of photographs, given by their numbers, those that were not matched yet.

    `told` is called with the number of pairs done, of how many, and may raise to stop: what was matched stays
    in the database.
    """
    with pycolmap.Database.open(path) as database:
        known = {image.name: image.image_id for image in database.read_all_images()}
        ids = [(known[as_stored(a)], known[as_stored(b)]) for a, b in pairs]
        done = [database.exists_two_view_geometry(*pair) for pair in ids]
    left = [pair for pair, is_done in zip(pairs, done, strict=True) if not is_done]
    listed = path.with_suffix(".pairs")
    for start in range(0, len(left), BLOCK):
        told(len(pairs) - len(left) + start, len(pairs))
        block = left[start : start + BLOCK]
        listed.write_text("".join(f"{as_stored(a)} {as_stored(b)}\n" for a, b in block))
        options = pycolmap.FeatureMatchingOptions()
        options.use_gpu = False
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listed
        with quiet():
            pycolmap.match_image_pairs(
                path,
                matching_options=options,
                pairing_options=pairing,
                verification_options=_verification(seed),
                device=pycolmap.Device.cpu,
            )
    listed.unlink(missing_ok=True)
    told(len(pairs), len(pairs))


def verify_again(path: Path, seed: int) -> None:
    """Verify all matches of a database once more, without trust in the focal lengths that it states."""
    with pycolmap.Database.open(path) as database:
        for camera in database.read_all_cameras():
            camera.has_prior_focal_length = False
            database.update_camera(camera)
        database.clear_two_view_geometries()
    with quiet():
        pycolmap.geometric_verification(path, two_view_geometry_options=_verification(seed))


def verified_pairs(path: Path) -> dict[tuple[int, int], int]:
    """Return the number of points that the photographs of each verified pair have in common, by numbers."""
    with pycolmap.Database.open(path) as database:
        numbers = {image.image_id: int(image.name) for image in database.read_all_images()}
        pairs, common = database.read_two_view_geometry_num_inliers()
    counts = {}
    for pair, count in zip(pairs, common, strict=True):
        first, second = sorted(numbers[image] for image in pycolmap.pair_id_to_image_pair(pair))
        if count:
            counts[first, second] = int(count)
    return counts


def flat_share(path: Path) -> float:
    """Return the share of verified pairs that one plane, or a camera that only turned, would explain."""
    kinds = pycolmap.TwoViewGeometryConfiguration
    flat = {kinds.PLANAR, kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC}
    with pycolmap.Database.open(path) as database:
        _, pairs = database.read_two_view_geometries()
    known = [pair.config in flat for pair in pairs if len(pair.inlier_matches)]
    return float(np.mean(known)) if known else 0.0


def partners(pairs: dict[tuple[int, int], int]) -> dict[int, tuple[int, int]]:
    """Return for each photograph the one that it has most points in common with, and how many."""
    best: dict[int, tuple[int, int]] = {}
    for (first, second), common in sorted(pairs.items()):
        for one, other in ((first, second), (second, first)):
            if common > best.get(one, (0, 0))[1]:
                best[one] = (other, common)
    return best


def _write_lens(database: Any, shot: Shot, max_side: int) -> tuple[int, int]:
    """Return the numbers of a lens and of the rig that consists of it."""
    scale = work_scale(shot.width, shot.height, max_side)
    width, height = scale * max(shot.width, shot.height), scale * min(shot.width, shot.height)
    focal = scale * shot.focal_px if shot.focal_px else GUESSED_FOCAL * width
    camera = pycolmap.Camera(
        model=MODEL,
        width=max(1, round(width)),
        height=max(1, round(height)),
        params=[focal, 0.5 * width, 0.5 * height, 0.0],
    )
    camera.has_prior_focal_length = shot.focal_px > 0.0
    camera.camera_id = database.write_camera(camera)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera.camera_id))
    return camera.camera_id, database.write_rig(rig)


def _verification(seed: int) -> Any:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    options.filter_stationary_matches = True
    options.stationary_matches_max_error = STILL_PX
    return options

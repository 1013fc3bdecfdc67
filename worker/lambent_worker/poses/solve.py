"""Runs COLMAP on a folder of photographs: features, matches of all pairs, cameras one after the other.

The same photographs and seed give the same cameras, nearly: random numbers are seeded and the mapper has one
thread, but COLMAP's order of summation differs between runs.
"""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from lambent_worker.errors import UsageError


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseSettings:
    """Settings of COLMAP."""

    seed: int = 0
    max_side: int = 1600
    """Longer side at which features are looked for, pixels; larger photographs are reduced for that."""
    max_features: int = 8192
    """Per photograph."""
    min_model: int = 3
    """Photographs that a model must have to count."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Solution:
    """Cameras found by COLMAP; scale and orientation of the world are arbitrary."""

    names: tuple[str, ...]
    """All photographs."""
    features: tuple[int, ...]
    """Points that were found in each."""
    partners: dict[str, tuple[str, int]]
    """For each photograph that has one, the one it fits best and the points they have in common."""
    camera_to_world: dict[str, Float[ndarray, "4 4"]]
    """Of the photographs whose cameras were found; camera axes x right, y down, z forward."""
    other_models: tuple[tuple[str, ...], ...] = ()
    """Photographs that fit together, but not to those of the largest model."""
    num_points: int = 0
    reprojection_error_px: float = 0.0
    """Mean distance of points from where they are seen, pixels."""
    field_deg: float = 0.0
    """Field of view of the widest lens along the longer side."""


def solve(
    folder: Path,
    names: tuple[str, ...],
    work: Path,
    settings: PoseSettings,
    *,
    masked: bool,
    one_camera: bool,
    tell: Callable[[str], None] = lambda text: None,
) -> Solution:
    """Find cameras for `names` in `folder`/images; write the largest model to `folder`/sparse/0, if any.

    With `masked`, only areas inside the masks of `folder`/masks are used. `one_camera` gives all photographs
    the same lens. `work` is an empty folder for COLMAP's own files. Raises `UsageError` where pycolmap is
    missing.
    """
    colmap = load_colmap()
    database = work / "database.db"
    colmap.set_random_seed(settings.seed)
    tell(f"looking for points in {len(names)} photographs")
    _extract(colmap, database, folder, names, settings, masked=masked, one_camera=one_camera)
    tell(f"comparing {len(names) * (len(names) - 1) // 2} pairs")
    verification = colmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = settings.seed
    matching = colmap.FeatureMatchingOptions()
    matching.use_gpu = False
    colmap.match_exhaustive(
        database, matching_options=matching, verification_options=verification, device=colmap.Device.cpu
    )
    tell("placing cameras")
    models = _map(colmap, database, folder / "images", work / "models", settings)
    with colmap.Database.open(database) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        features = {name: opened.num_keypoints_for_image(identity) for identity, name in images.items()}
        pairs, inliers = opened.read_two_view_geometry_num_inliers()
    partners = _partners(images, [colmap.pair_id_to_image_pair(pair) for pair in pairs], inliers)
    found = tuple(features.get(name, 0) for name in names)
    if not models:
        return Solution(names=names, features=found, partners=partners, camera_to_world={})
    best = models[0]
    target = folder / "sparse" / "0"
    target.mkdir(parents=True, exist_ok=True)
    best.write_binary(target)
    return Solution(
        names=names,
        features=found,
        partners=partners,
        camera_to_world=_poses(best),
        other_models=tuple(tuple(sorted(_poses(model))) for model in models[1:]),
        num_points=best.num_points3D(),
        reprojection_error_px=float(best.compute_mean_reprojection_error()),
        field_deg=max(_field_deg(camera) for camera in best.cameras.values()),
    )


def load_colmap() -> Any:
    """Return the module pycolmap, quiet; raises `UsageError` where it is not installed."""
    try:
        colmap = importlib.import_module("pycolmap")
    except ImportError as error:
        raise UsageError(
            "config.poses_missing",
            "finding cameras needs the package pycolmap, which is not here; pip install 'lambent[poses]', or "
            "bring cameras from another program",
        ) from error
    colmap.logging.minloglevel = colmap.logging.Level.ERROR.value
    return colmap


def _extract(
    colmap: Any,
    database: Path,
    folder: Path,
    names: tuple[str, ...],
    settings: PoseSettings,
    *,
    masked: bool,
    one_camera: bool,
) -> None:
    reader = colmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    if masked:
        reader.mask_path = folder / "masks"
    extraction = colmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.max_image_size = settings.max_side
    extraction.sift.max_num_features = settings.max_features
    colmap.extract_features(
        database,
        folder / "images",
        image_names=list(names),
        camera_mode=colmap.CameraMode.SINGLE if one_camera else colmap.CameraMode.PER_IMAGE,
        reader_options=reader,
        extraction_options=extraction,
        device=colmap.Device.cpu,
    )


def _map(colmap: Any, database: Path, images: Path, out: Path, settings: PoseSettings) -> list[Any]:
    """Return all models of enough photographs, the largest first."""
    options = colmap.IncrementalPipelineOptions()
    options.random_seed = settings.seed
    options.mapper.random_seed = settings.seed
    options.triangulation.random_seed = settings.seed
    options.num_threads = 1
    options.mapper.num_threads = 1
    options.min_model_size = settings.min_model
    options.extract_colors = False
    out.mkdir()
    models = colmap.incremental_mapping(database, images, out, options)
    large = [model for _, model in sorted(models.items()) if model.num_reg_images() >= settings.min_model]
    return sorted(large, key=lambda model: -model.num_reg_images())


def _partners(
    images: dict[int, str], pairs: Sequence[tuple[int, int]], inliers: Sequence[int]
) -> dict[str, tuple[str, int]]:
    best: dict[str, tuple[str, int]] = {}
    for (first, second), number in zip(pairs, inliers, strict=True):
        for one, other in ((images[first], images[second]), (images[second], images[first])):
            if number > best.get(one, ("", 0))[1]:
                best[one] = (other, int(number))
    return best


def _field_deg(camera: Any) -> float:
    side = max(camera.width, camera.height)
    return float(np.degrees(2.0 * np.arctan(0.5 * side / camera.mean_focal_length())))


def _poses(model: Any) -> dict[str, Float[ndarray, "4 4"]]:
    poses = {}
    for identity in model.reg_image_ids():
        image = model.image(identity)
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().inverse().matrix()
        poses[image.name] = pose
    return poses

"""A capture of a checkered ball before a grey wall: photographs without alpha, and the true masks."""

import json
from pathlib import Path

import numpy as np
from numpy import ndarray
from support.ball_views import SIDE, ball_hits, ball_views
from support.captures import save

FOCAL = 140.0


def write_ball_photographs(folder: Path, count: int = 12) -> dict[str, ndarray]:
    """Write a NeRF-Blender capture; return the true mask [height, width] of each frame by its name."""
    generator = np.random.default_rng(0)
    frames, masks = [], {}
    for number, silhouette in enumerate(ball_views(count)):
        hit, points = ball_hits(silhouette.camera, np.zeros(3), 0.6)
        checks = np.sign(np.sin(9.0 * points)).prod(axis=-1)[..., None] > 0.0
        colours = np.where(hit[..., None], np.where(checks, [200, 60, 40], [240, 220, 180]), [120, 125, 130])
        noisy = np.clip(colours + generator.normal(size=colours.shape), 0, 255)
        save(folder / "train" / f"r_{number}.png", noisy.astype(np.uint8))
        pose = silhouette.camera.camera_to_world.tolist()
        frames.append({"file_path": f"./train/r_{number}", "transform_matrix": pose})
        masks[f"train_r_{number}"] = hit
    angle = 2.0 * np.arctan(0.5 * SIDE / FOCAL)
    record = {"camera_angle_x": angle, "frames": frames}
    (folder / "transforms_train.json").write_text(json.dumps(record))
    return masks


def write_masks(folder: Path, masks: dict[str, ndarray]) -> Path:
    """Write a PNG for each mask, named like its frame."""
    for name, mask in masks.items():
        save(folder / f"{name}.png", np.where(mask, 255, 0).astype(np.uint8))
    return folder

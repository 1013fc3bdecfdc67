"""Small captures of an imaginary object, written to disk as people would upload them."""

import json
from pathlib import Path

import numpy as np
from numpy import ndarray
from PIL import Image

SIDE = 12
ANGLE = 0.7
DISTANCE = 4.0
REFERENCES = Path(__file__).parent.parent / "references"


def look_at(position: ndarray, target: ndarray | None = None) -> ndarray:
    """Return the camera-to-world matrix [4, 4] of a camera at `position` looking at `target` (the origin)."""
    back = position - (np.zeros(3) if target is None else target)
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, 3] = position
    return pose


def ring(count: int, distance: float = DISTANCE) -> list[ndarray]:
    """Return `count` poses around the z axis, a little above the object, all looking at it."""
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    spots = [np.array([np.cos(a), np.sin(a), 0.4]) * distance / np.hypot(1.0, 0.4) for a in angles]
    return [look_at(spot) for spot in spots]


def photograph(seed: int, side: int = SIDE) -> ndarray:
    """Return a picture [side, side, 4] of a coloured square on nothing, different for every seed."""
    pixels = np.zeros((side, side, 4), dtype=np.uint8)
    inner = slice(side // 4, 3 * side // 4)
    pixels[inner, inner, :3] = np.random.default_rng(seed).integers(0, 256, (side // 2, side // 2, 3))
    pixels[inner, inner, 3] = 255
    return pixels


def save(path: Path, pixels: ndarray) -> None:
    """Write a picture, and its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def write_tensoir(
    folder: Path,
    *,
    num_train: int = 5,
    num_test: int = 2,
    lights: tuple[str, ...] = ("sunset",),
    relight: tuple[str, ...] = ("city",),
) -> Path:
    """Write a TensoIR-synthetic capture without scene.json; test views also show the `relight` lights."""
    poses = ring(num_train + num_test)
    names = [f"train_{i:03d}" for i in range(num_train)] + [f"test_{i:03d}" for i in range(num_test)]
    for seed, (name, pose) in enumerate(zip(names, poses, strict=True)):
        metadata = {
            "imw": SIDE,
            "imh": SIDE,
            "cam_angle_x": ANGLE,
            "cam_transform_mat": ",".join(f"{value:.9g}" for value in pose.ravel()),
        }
        shown = lights if name.startswith("train") else (*lights, *relight)
        for index, light in enumerate(shown):
            save(folder / name / f"rgba_{light}.png", photograph(100 * seed + index))
        (folder / name / "metadata.json").write_text(json.dumps(metadata))
    return folder


def write_blender(folder: Path, *, num_train: int = 5, num_test: int = 2) -> Path:
    """Write a NeRF-Blender capture."""
    poses = iter(ring(num_train + num_test))
    seed = 0
    for split, count in (("train", num_train), ("test", num_test)):
        frames = []
        for index in range(count):
            save(folder / split / f"r_{index}.png", photograph(seed))
            frames.append({"file_path": f"./{split}/r_{index}", "transform_matrix": next(poses).tolist()})
            seed += 1
        if count:
            write_transforms(folder, split, {"camera_angle_x": ANGLE, "frames": frames})
    return folder


def read_transforms(folder: Path, split: str = "train") -> dict:
    """Return what is in `transforms_<split>.json`."""
    return json.loads((folder / f"transforms_{split}.json").read_text())


def write_transforms(folder: Path, split: str, value: object) -> None:
    """Replace `transforms_<split>.json`."""
    (folder / f"transforms_{split}.json").write_text(json.dumps(value))


def edit_frame(folder: Path, index: int, split: str = "train", **changes: object) -> None:
    """Change entries of one frame of a NeRF-Blender capture; None removes an entry."""
    transforms = read_transforms(folder, split)
    frame = {**transforms["frames"][index], **changes}
    transforms["frames"][index] = {key: value for key, value in frame.items() if value is not None}
    write_transforms(folder, split, transforms)

"""One small capture of an uneven object, written in every layout, with handles to spoil each of them."""

from __future__ import annotations

import json
import pickle
import shutil
import struct
from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
from numpy import ndarray
from support.captures import save
from support.uneven_object import DISTANCE, FOCAL, NUM_VIEWS, SIDE, colours, coverage, poses

OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


class LayoutFolder(ABC):
    """A capture in a folder; frames are numbered, and number 3 and the last are for training."""

    name: str
    zero_focal_code = "scene.lens_invalid"
    duplicate_code = "scene.frame_duplicate"
    size_code = "scene.image_size"
    count_code = "scene.camera_invalid"

    def __init__(self, folder: Path, *, offset: ndarray | None = None, scale: float = 1.0) -> None:
        self.folder = folder
        self.poses = poses(offset, scale)
        self.lens = FOCAL
        self.coverage = [coverage(pose, offset=offset, scale=scale) for pose in self.poses]
        for index in range(NUM_VIEWS):
            self.save_picture(index, colours(index), self.coverage[index])
        self.write_cameras()

    def has_mask_files(self) -> bool:
        """Return whether the layout keeps masks beside the photographs."""
        return self.mask(3) is not None

    def save_picture(self, index: int, rgb: ndarray, alpha: ndarray) -> None:
        """Write a photograph, and its mask where the layout has one."""
        mask = self.mask(index)
        if mask is None:
            save(self.picture(index), np.dstack([rgb, alpha]))
            return
        save(self.picture(index), rgb)
        save(mask, alpha)

    def set_pose(self, index: int, pose: ndarray) -> None:
        """Replace a frame's camera-to-world matrix."""
        self.poses[index] = pose
        self.write_cameras()

    def turn_all(self, axes: ndarray) -> None:
        """Multiply all poses from the right."""
        self.poses = [pose @ axes for pose in self.poses]
        self.write_cameras()

    def zero_focal(self) -> None:
        """Make the lens impossible."""
        self.lens = 0.0
        self.write_cameras()

    def path(self, index: int) -> str:
        """Return a photograph's path inside the folder."""
        return self.picture(index).relative_to(self.folder).as_posix()

    @property
    def angle(self) -> float:
        """Return the field of view of the lens, radians; 0 stands for an impossible one."""
        return 2.0 * np.arctan(0.5 * SIDE / self.lens) if self.lens else 0.0

    @abstractmethod
    def picture(self, index: int) -> Path: ...

    @abstractmethod
    def mask(self, index: int) -> Path | None: ...

    @abstractmethod
    def write_cameras(self) -> None: ...

    @abstractmethod
    def extra(self) -> Path:
        """Return where a picture would lie that belongs to no frame."""

    @abstractmethod
    def wrong_count(self) -> None:
        """Give frame 3 too few numbers."""

    @abstractmethod
    def duplicate(self) -> None:
        """Describe one frame twice."""


class TensoirFolder(LayoutFolder):
    name = "tensoir_synthetic"
    zero_focal_code = "scene.camera_angle_invalid"

    def picture(self, index: int) -> Path:
        return self.folder / f"train_{index:03d}" / "rgba_sunset.png"

    def mask(self, index: int) -> Path | None:
        return None

    def write_cameras(self) -> None:
        for index, pose in enumerate(self.poses):
            numbers = ",".join(f"{value:.9g}" for value in pose.ravel())
            self.write_metadata(index, numbers)

    def write_metadata(self, index: int, numbers: str) -> None:
        metadata = {"imw": SIDE, "imh": SIDE, "cam_angle_x": self.angle, "cam_transform_mat": numbers}
        (self.picture(index).parent / "metadata.json").write_text(json.dumps(metadata))

    def extra(self) -> Path:
        return self.picture(3).parent / "rgba_dusk.png"

    def wrong_count(self) -> None:
        self.write_metadata(3, "1,0,0,0,0,1,0,0,0,0,1,0,0,0")

    def duplicate(self) -> None:
        shutil.copytree(self.folder / "train_003", self.folder / "train_3")
        save(self.folder / "train_3" / "rgba_sunset.png", np.dstack([colours(99), self.coverage[3]]))


class BlenderFolder(LayoutFolder):
    name = "nerf_blender"
    zero_focal_code = "scene.camera_angle_invalid"
    size_code = "scene.image_sizes_mixed"

    def picture(self, index: int) -> Path:
        return self.folder / "train" / f"r_{index}.png"

    def mask(self, index: int) -> Path | None:
        return None

    def entries(self) -> list[dict]:
        return [
            {"file_path": f"./train/r_{index}", "transform_matrix": pose.tolist()}
            for index, pose in enumerate(self.poses)
        ]

    def write_cameras(self, entries: list[dict] | None = None) -> None:
        value = {"camera_angle_x": self.angle, "frames": entries or self.entries()}
        (self.folder / "transforms_train.json").write_text(json.dumps(value))

    def extra(self) -> Path:
        return self.folder / "train" / "r_99.png"

    def wrong_count(self) -> None:
        entries = self.entries()
        entries[3]["transform_matrix"] = entries[3]["transform_matrix"][:2]
        self.write_cameras(entries)

    def duplicate(self) -> None:
        self.write_cameras([*self.entries(), self.entries()[3]])


class NerfstudioFolder(BlenderFolder):
    name = "nerfstudio"
    zero_focal_code = "scene.lens_invalid"
    size_code = "scene.image_size"

    def picture(self, index: int) -> Path:
        return self.folder / "images" / f"frame_{index:05d}.jpg"

    def mask(self, index: int) -> Path | None:
        return self.folder / "masks" / f"frame_{index:05d}.png"

    def entries(self) -> list[dict]:
        return [
            {
                "file_path": self.path(index),
                "mask_path": f"masks/frame_{index:05d}.png",
                "transform_matrix": pose.tolist(),
            }
            for index, pose in enumerate(self.poses)
        ]

    def write_cameras(self, entries: list[dict] | None = None) -> None:
        lens = {"w": SIDE, "h": SIDE, "fl_x": self.lens, "fl_y": self.lens, "cx": SIDE / 2, "cy": SIDE / 2}
        value = {"camera_model": "OPENCV", **lens, "frames": entries or self.entries()}
        (self.folder / "transforms.json").write_text(json.dumps(value))

    def extra(self) -> Path:
        return self.folder / "images" / "frame_00099.jpg"


def quaternion(rotation: ndarray) -> ndarray:
    """Return w, x, y, z of a rotation matrix; not finite where the matrix is not."""
    if not np.isfinite(rotation).all():
        return np.full(4, np.nan)
    values, vectors = np.linalg.eigh(
        np.array(
            [
                [np.trace(rotation), *(_cross(rotation))],
                *(
                    [_cross(rotation)[i], *(rotation[i] + rotation[:, i] - np.trace(rotation) * np.eye(3)[i])]
                    for i in range(3)
                ),
            ]
        )
    )
    return vectors[:, values.argmax()]


def _cross(rotation: ndarray) -> ndarray:
    return np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )


class ColmapTextFolder(LayoutFolder):
    name = "colmap"
    count_code = "scene.metadata_unreadable"

    def picture(self, index: int) -> Path:
        return self.folder / "images" / f"IMG_{index:04d}.png"

    def mask(self, index: int) -> Path | None:
        return self.folder / "masks" / f"IMG_{index:04d}.png.png"

    def rows(self) -> list[tuple[ndarray, ndarray, str]]:
        """Return rotation, translation and name of every image, as COLMAP keeps them."""
        found = []
        for index, pose in enumerate(self.poses):
            singular = np.linalg.matrix_rank(pose[:3, :3]) < 3 if np.isfinite(pose).all() else False
            outer = np.full((4, 4), np.nan)
            if np.isfinite(pose).all():
                outer = OPENCV @ np.linalg.inv(pose if not singular else np.eye(4))
            turn = np.zeros(4) if singular else quaternion(outer[:3, :3])
            found.append((turn, outer[:3, 3], self.picture(index).name))
        return found

    def write_cameras(self) -> None:
        self.write_model(self.rows())

    def write_model(
        self, rows: list[tuple[ndarray, ndarray, str]], parameters: int = 4, announced: int | None = None
    ) -> None:
        place = self.folder / "sparse" / "0"
        place.mkdir(parents=True, exist_ok=True)
        values = [self.lens, self.lens, SIDE / 2, SIDE / 2][:parameters]
        camera = f"1 PINHOLE {SIDE} {SIDE} {' '.join(map(str, values))}"
        (place / "cameras.txt").write_text(f"# Number of cameras: 1\n{camera}\n")
        lines = [f"# Number of images: {announced or len(rows)}, mean observations per image: 0"]
        for number, (turn, shift, name) in enumerate(rows, start=1):
            lines += [f"{number} {' '.join(f'{v:.12g}' for v in (*turn, *shift))} 1 {name}", ""]
        (place / "images.txt").write_text("\n".join(lines) + "\n")

    def extra(self) -> Path:
        return self.folder / "images" / "IMG_0099.png"

    def wrong_count(self) -> None:
        self.write_model(self.rows(), parameters=3)

    def duplicate(self) -> None:
        self.write_model([*self.rows(), self.rows()[3]])


class ColmapBinaryFolder(ColmapTextFolder):
    def write_model(
        self, rows: list[tuple[ndarray, ndarray, str]], parameters: int = 4, announced: int | None = None
    ) -> None:
        place = self.folder / "sparse" / "0"
        place.mkdir(parents=True, exist_ok=True)
        values = struct.pack("<4d", self.lens, self.lens, SIDE / 2, SIDE / 2)
        (place / "cameras.bin").write_bytes(struct.pack("<QiiQQ", 1, 1, 1, SIDE, SIDE) + values)
        data = struct.pack("<Q", announced or len(rows))
        for number, (turn, shift, name) in enumerate(rows, start=1):
            data += struct.pack("<i7di", number, *turn, *shift, 1) + name.encode() + b"\0"
            data += struct.pack("<Q", 1) + struct.pack("<ddq", 1.0, 2.0, -1)
        (place / "images.bin").write_bytes(data)

    def wrong_count(self) -> None:
        self.write_model(self.rows(), announced=NUM_VIEWS + 1)


class OpenIlluminationFolder(LayoutFolder):
    name = "openillumination"
    zero_focal_code = "scene.camera_angle_invalid"
    duplicate_code = "scene.key_duplicate"

    def __init__(self, folder: Path, **options: object) -> None:
        self.base = folder / "obj_02_egg"
        super().__init__(folder, **options)
        for index in range(NUM_VIEWS):
            save(self.photograph(index, "009"), colours(100 + index))

    def photograph(self, index: int, light: str) -> Path:
        return self.base / "Lights" / light / "raw_undistorted" / f"{self.key(index)}.JPG"

    def key(self, index: int) -> str:
        return f"C{'ABCD'[index // 4]}{index % 4}"

    def picture(self, index: int) -> Path:
        return self.photograph(index, "013")

    def mask(self, index: int) -> Path | None:
        return self.base / "output" / "com_masks" / f"{self.key(index)}.png"

    def frames(self) -> dict[str, dict]:
        return {
            self.key(index): {
                "file_path": f"./images/{self.key(index)}",
                "light_idx": 0,
                "camera_angle_x": self.angle,
                "calib_imgw": SIDE,
                "transform_matrix": (pose @ OPENCV).tolist(),
            }
            for index, pose in enumerate(self.poses)
        }

    def write_cameras(self, frames: dict[str, dict] | None = None) -> None:
        text = json.dumps({"frames": frames or self.frames()})
        (self.base / "output" / "transforms_train.json").write_text(text)

    def extra(self) -> Path:
        return self.base / "Lights" / "013" / "raw_undistorted" / "ZZ9.JPG"

    def wrong_count(self) -> None:
        frames = self.frames()
        frames[self.key(3)]["transform_matrix"] = [[1.0, 0.0], [0.0, 1.0]]
        self.write_cameras(frames)

    def duplicate(self) -> None:
        once = json.dumps({"frames": self.frames()})
        again = json.dumps({self.key(3): self.frames()[self.key(3)]})[1:-1]
        text = once[:-2] + ", " + again + "}}"
        (self.base / "output" / "transforms_train.json").write_text(text)


class GlossyFolder(LayoutFolder):
    name = "glossy_synthetic"

    def __init__(self, folder: Path, **options: object) -> None:
        self.base = folder / "potion"
        super().__init__(folder, **options)
        self.write_split(["7", "15"])

    def write_split(self, tested: list[str]) -> None:
        trained = [str(index) for index in range(NUM_VIEWS) if index not in (7, 15)]
        (self.folder / "synthetic_split_128.pkl").write_bytes(pickle.dumps((tested, trained)))

    def picture(self, index: int) -> Path:
        return self.base / f"{index}.png"

    def mask(self, index: int) -> Path | None:
        return self.base / f"{index}-depth.png"

    def save_picture(self, index: int, rgb: ndarray, alpha: ndarray) -> None:
        save(self.picture(index), rgb)
        depth = np.where(alpha > 0, DISTANCE, 15.0)
        save(self.base / f"{index}-depth.png", np.round(depth / 15.0 * 65535.0).astype(np.uint16))

    def write_cameras(self) -> None:
        for index in range(NUM_VIEWS):
            self.write_camera(index, self.outer(index))

    def outer(self, index: int) -> ndarray:
        pose = self.poses[index] @ OPENCV
        if not np.isfinite(pose).all() or np.linalg.matrix_rank(pose) < 4:
            return pose[:3]
        return np.linalg.inv(pose)[:3]

    def write_camera(self, index: int, outer: ndarray) -> None:
        inner = np.array([[self.lens, 0.0, SIDE / 2], [0.0, self.lens, SIDE / 2], [0.0, 0.0, 1.0]])
        self.base.mkdir(parents=True, exist_ok=True)
        (self.base / f"{index}-camera.pkl").write_bytes(pickle.dumps([outer, inner]))

    def extra(self) -> Path:
        return self.base / "99.png"

    def wrong_count(self) -> None:
        self.write_camera(3, np.eye(3))

    def duplicate(self) -> None:
        self.write_split(["7", "15", "3"])


LAYOUT_FOLDERS = (
    TensoirFolder,
    BlenderFolder,
    NerfstudioFolder,
    ColmapTextFolder,
    ColmapBinaryFolder,
    OpenIlluminationFolder,
    GlossyFolder,
)

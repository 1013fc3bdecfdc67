"""Captures of a few photographs in the layouts that programs leave."""

import json
import struct
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy import ndarray
from strangers.masks import LOSSY, mask_alpha, write_mask
from strangers.pictures import SUFFIXES, Reading, Spec, turned, write_photograph
from support.captures import ring
from support.layouts import quaternion

ANGLE = 0.7
LAYOUTS = ("nerfstudio", "blender", "colmap text", "colmap binary", "photographs")
MASKED_LAYOUTS = ("nerfstudio", "colmap text", "colmap binary", "photographs")
_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """A capture to write."""

    spec: Spec
    layout: str = "nerfstudio"
    mask: str = "none"
    """A name in `MASKS`."""
    painted_upright: bool = False
    """Whether the mask was painted on the photograph as EXIF turns it."""
    seed: int = 0
    count: int = 3

    def __str__(self) -> str:
        """Return what makes it again."""
        mask = f" mask={self.mask}{' upright' if self.painted_upright else ''}" if self.mask != "none" else ""
        return f"{self.spec} {self.layout}{mask} seed={self.seed}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Written:
    """A capture on disk, and what it shows."""

    folder: Path
    readings: dict[str, list[Reading]]
    """Right readings of each photograph by path; none where it is to be refused."""
    masks: Path | None = None
    """A folder to be named to the program."""
    cameras: Path | None = None
    """A folder of found cameras, for photographs."""
    files: tuple[str, ...] = field(default=())


def write_capture(folder: Path, case: Case) -> Written:
    """Write a capture to a folder that is not there yet."""
    inner = {"nerfstudio": "images", "blender": "train", "photographs": "images"}.get(case.layout, "images")
    (folder / inner).mkdir(parents=True)
    readings: dict[str, list[Reading]] = {}
    masks: dict[str, str] = {}
    if case.layout == "photographs":  # smaller ones are refused, for nothing can be matched in them
        case = replace(case, spec=replace(case.spec, scale=3))
    outlined = mask_alpha(soft=False) if case.mask != "none" and case.spec.orientation != 1 else None
    for index in range(case.count):
        stem = f"view_{index:03d}"
        name = stem + SUFFIXES[case.spec.format]
        seed = 100 * case.seed + index
        found = write_photograph(folder / inner / name, case.spec, seed, outlined=outlined)
        path = f"{inner}/{name}"
        if case.mask != "none":
            masks[path], found = _with_mask(folder, stem, name, case, found)
        readings[path] = found
    poses = ring(case.count)
    first = next(iter(readings.values()))
    size = first[0].alpha.shape[::-1] if first else (32, 24)
    cameras = folder.with_name(folder.name + "-cameras") if case.layout == "photographs" else None
    if case.layout in ("nerfstudio", "blender"):
        _transforms(folder, case.layout, list(readings), poses, masks)
    else:
        place = folder if cameras is None else cameras
        names = [path.removeprefix("images/") for path in readings]
        _colmap(place / "sparse" / "0", names, poses, size, binary=case.layout == "colmap binary")
        if cameras is not None:
            record = {"inputs": "", "photographs": case.count}
            (cameras / "cameras.json").write_text(json.dumps(record))
    colmap_masks = folder / "masks" if masks and case.layout.startswith("colmap") else None
    files = tuple(path.name for path in folder.rglob("*") if path.is_file())
    return Written(folder=folder, readings=readings, masks=colmap_masks, cameras=cameras, files=files)


def _with_mask(
    folder: Path, stem: str, name: str, case: Case, found: list[Reading]
) -> tuple[str, list[Reading]]:
    """Write a mask; return its path and the readings of the photograph through it."""
    (folder / "masks").mkdir(exist_ok=True)
    called = name if case.layout.startswith("colmap") else stem
    spec, orientation = case.spec, case.spec.orientation
    # A mask that states a turn of its own means what people see.
    upright = case.painted_upright or spec.format == "heic" or case.mask == "orientation"
    turn = orientation if upright else 1
    mask, alpha = write_mask(folder / "masks", called, case.mask, shown=turn, scale=spec.scale)
    covered = []
    for each in found:
        fits = turned(alpha, each.shown)
        margin = max(each.alpha_margin, LOSSY.get(case.mask, 0.006))
        covered.append(replace(each, alpha=np.minimum(each.alpha, fits), alpha_margin=margin))
    return f"masks/{mask}", covered


def _transforms(
    folder: Path, layout: str, paths: list[str], poses: list[ndarray], masks: dict[str, str]
) -> None:
    frames = []
    for path, pose in zip(paths, poses, strict=True):
        frame: dict = {"file_path": path, "transform_matrix": pose.tolist()}
        if path in masks:
            frame["mask_path"] = masks[path]
        frames.append(frame)
    name = "transforms.json" if layout == "nerfstudio" else "transforms_train.json"
    (folder / name).write_text(json.dumps({"camera_angle_x": ANGLE, "frames": frames}))


def _colmap(
    place: Path, names: list[str], poses: list[ndarray], size: tuple[int, int], *, binary: bool
) -> None:
    place.mkdir(parents=True)
    focal = float(0.5 * size[0] / np.tan(0.5 * ANGLE))
    rows = []
    for pose in poses:
        outer = _OPENCV @ np.linalg.inv(pose)
        rows.append((*quaternion(outer[:3, :3]), *outer[:3, 3]))
    lens = (focal, focal, size[0] / 2, size[1] / 2)
    if binary:
        (place / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, *size, *lens))
        data = struct.pack("<Q", len(rows))
        for number, (row, name) in enumerate(zip(rows, names, strict=True), start=1):
            data += struct.pack("<i7di", number, *row, 1) + name.encode() + b"\0" + struct.pack("<Q", 0)
        (place / "images.bin").write_bytes(data)
        (place / "points3D.bin").write_bytes(struct.pack("<Q", 0))
        return
    (place / "cameras.txt").write_text(f"1 PINHOLE {size[0]} {size[1]} {' '.join(map(repr, lens))}\n")
    lines = []
    for number, (row, name) in enumerate(zip(rows, names, strict=True), start=1):
        lines += [f"{number} {' '.join(f'{value:.12g}' for value in row)} 1 {name}", ""]
    (place / "images.txt").write_text("\n".join(lines) + "\n")
    (place / "points3D.txt").write_text("")

"""COLMAP's models of the ball, in every version and place."""

import struct
from pathlib import Path

import numpy as np
from strangers.ball import COUNT, FOCAL, SIDE
from support.captures import ring
from support.layouts import quaternion

_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
MODELS = {0: 3, 1: 4, 12: 4}
"""Number of parameters of a camera model: SIMPLE_PINHOLE, PINHOLE, and one that came with COLMAP 4."""


def write_model(
    place: Path, names: list[str], *, binary: bool = True, model: int = 1, kind: str = "PINHOLE"
) -> None:
    """Write a model of the first photographs named."""
    place.mkdir(parents=True, exist_ok=True)
    rows = []
    for pose in ring(COUNT)[: len(names)]:
        outer = _OPENCV @ np.linalg.inv(pose)
        rows.append([*quaternion(outer[:3, :3]), *outer[:3, 3]])
    lens = [FOCAL, FOCAL, SIDE / 2, SIDE / 2]
    if not binary:
        numbers = " ".join(str(value) for value in lens)
        (place / "cameras.txt").write_text(f"1 {kind} {SIDE} {SIDE} {numbers}\n")
        lines: list[str] = []
        for number, (row, name) in enumerate(zip(rows, names, strict=True), start=1):
            lines += [f"{number} {' '.join(f'{value:.12g}' for value in row)} 1 {name}", ""]
        (place / "images.txt").write_text("\n".join(lines) + "\n")
        (place / "points3D.txt").write_text("")
        return
    numbers = struct.pack(f"<{MODELS[model]}d", *lens[: MODELS[model]])
    (place / "cameras.bin").write_bytes(struct.pack("<QiiQQ", 1, 1, model, SIDE, SIDE) + numbers)
    data = struct.pack("<Q", len(rows))
    for number, (row, name) in enumerate(zip(rows, names, strict=True), start=1):
        data += struct.pack("<i7di", number, *row, 1) + name.encode() + b"\0" + struct.pack("<Q", 0)
    (place / "images.bin").write_bytes(data)
    (place / "points3D.bin").write_bytes(struct.pack("<Q", 0))

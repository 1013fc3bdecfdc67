"""Captures whose cameras attack their reader, with codes of which one has to be among the findings."""

import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from support.captures import edit_frame, read_transforms, write_blender, write_transforms
from support.layouts import ColmapBinaryFolder, ColmapTextFolder, GlossyFolder, NerfstudioFolder

UNREADABLE, CAMERA, PATH = {"scene.metadata_unreadable"}, {"scene.camera_invalid"}, {"scene.path_unsafe"}
LARGE, FINITE, RIGID = {"scene.metadata_too_large"}, {"scene.camera_not_finite"}, {"scene.camera_not_rigid"}
FEW = {"scene.too_few_images"}
LENS = {"scene.lens_invalid", "scene.camera_angle_invalid"}

CAPTURES: dict[str, tuple[Callable[[Path], object], set[str]]] = {}


def _blender(name: str, codes: set[str], change: Callable[[Path], object]) -> None:
    def write(folder: Path) -> None:
        write_blender(folder)
        change(folder)

    CAPTURES[name] = (write, codes)


def _pose(name: str, codes: set[str], value: Any) -> None:
    _blender(f"pose: {name}", codes, lambda folder: edit_frame(folder, 1, transform_matrix=value))


def _text(name: str, codes: set[str], text: str | bytes) -> None:
    data = text.encode() if isinstance(text, str) else text
    _blender(f"JSON: {name}", codes, lambda folder: (folder / "transforms_train.json").write_bytes(data))


def _eye(scale: float = 1.0) -> list[list[float]]:
    return (np.diag([scale, scale, scale, 1.0]) @ np.eye(4)).tolist()


_pose("NaN", FINITE, [[float("nan")] * 4] * 4)
_pose("infinity", FINITE, [[float("inf")] * 4] * 4)
_pose("1e300", FINITE, [[1e300] * 4] * 4)
_pose("an integer of 5000 digits", FINITE | CAMERA | UNREADABLE, [[10**400] * 4] * 4)
_pose("a scale of 1000", RIGID, _eye(1000.0))
_pose("a mirror", RIGID, _eye(-1.0))
_pose("singular", RIGID, [[1.0, 0, 0, 0]] * 4)
_pose("zeros", RIGID, [[0.0] * 4] * 4)
_pose("three rows", CAMERA | RIGID, [[1.0, 0, 0, 0]] * 3)
_pose("words", CAMERA, "identity")
_pose("null", CAMERA | FINITE, [[None] * 4] * 4)
_pose("lists in lists", CAMERA | RIGID, [[[[[[[1.0]]]]]] * 4] * 4)
_pose("objects", CAMERA, [{"x": 1}] * 4)
_pose("a thousand columns", CAMERA, [[1.0] * 1000] * 4)

_text("100 000 lists deep", UNREADABLE, "[" * 100_000)
_text("100 000 objects deep", UNREADABLE, '{"a":' * 100_000)
_text(
    "a number of a million digits",
    UNREADABLE | {"scene.camera_angle_invalid"},
    '{"camera_angle_x": ' + "9" * 1_000_000 + ', "frames": []}',
)
_text(
    "a duplicate key", {"scene.key_duplicate"}, '{"camera_angle_x": 0.7, "camera_angle_x": 0.9, "frames": []}'
)
_text("cut off", UNREADABLE, '{"camera_angle_x": 0.7, "frames": [{"file')
_text("no UTF-8", UNREADABLE, b'{"camera_angle_x": 0.7, "frames": "\xff\xfe\xfa"}')
_text("UTF-16", FEW, '{"frames": []}'.encode("utf-16"))
_text(
    "a lone surrogate",
    UNREADABLE | PATH,
    '{"camera_angle_x": 0.7, "frames": [{"file_path": "\\ud800", "transform_matrix": 1}]}',
)
_text("a list", UNREADABLE | {"scene.camera_angle_invalid"}, "[1, 2, 3]")
_text("null", UNREADABLE | {"scene.camera_angle_invalid"}, "null")
_text("frames that are a number", UNREADABLE, '{"camera_angle_x": 0.7, "frames": 7}')
_text(
    "frames that are null",
    {"scene.file_path_missing"},
    '{"camera_angle_x": 0.7, "frames": [null, 3, "x", []]}',
)
_text("70 MiB", LARGE, '{"camera_angle_x": 0.7, "frames": [' + " " * (70 * 2**20) + "]}")
_text("an angle of 1e308", LENS | FEW, '{"camera_angle_x": 1e308, "frames": []}')
_text("an angle of NaN", LENS | FEW, '{"camera_angle_x": NaN, "frames": []}')
_text("an angle of text", LENS | FEW, '{"camera_angle_x": "wide", "frames": []}')

for _name, _path in {
    "outside": "../../../../etc/passwd",
    "the root": "/etc/passwd",
    "null byte": "train/r_1\0.png",
    "100 000 characters": "a" * 100_000,
    "a number": 7,
    "a list": ["train/r_1"],
    "an address": "http://127.0.0.1:8420/v1/jobs",
    "a device": "/dev/zero",
}.items():
    _blender(
        f"path: {_name}",
        PATH
        | {
            "scene.file_missing",
            "scene.frames_without_picture",
            "scene.file_path_missing",
            "scene.metadata_unreadable",
        },
        lambda folder, path=_path: edit_frame(folder, 1, file_path=path),
    )


def _many_frames(folder: Path) -> None:
    transforms = read_transforms(folder)
    transforms["frames"] *= 20_000
    write_transforms(folder, "train", transforms)


_blender("100 000 frames of five pictures", {"scene.frame_duplicate"}, _many_frames)
_blender(
    "a frame twice",
    {"scene.frame_duplicate"},
    lambda folder: write_transforms(
        folder, "train", {**read_transforms(folder), "frames": read_transforms(folder)["frames"] * 2}
    ),
)


# ---- COLMAP ----------------------------------------------------------------------


def _colmap(name: str, codes: set[str], change: Callable[[Path], object], *, text: bool = False) -> None:
    def write(folder: Path) -> None:
        (ColmapTextFolder if text else ColmapBinaryFolder)(folder)
        change(folder / "sparse" / "0")

    CAPTURES[f"COLMAP: {name}"] = (write, codes)


def _replace(name: str, at: int, data: bytes) -> Callable[[Path], object]:
    def change(place: Path) -> None:
        found = bytearray((place / name).read_bytes())
        found[at : at + len(data)] = data
        (place / name).write_bytes(found)

    return change


HUGE = struct.pack("<Q", 2**62)
_colmap("2^62 images", UNREADABLE, _replace("images.bin", 0, HUGE))
_colmap("2^62 cameras", UNREADABLE, _replace("cameras.bin", 0, HUGE))
_colmap(
    "an unknown camera model",
    UNREADABLE | {"scene.lens_unsupported"},
    _replace("cameras.bin", 12, struct.pack("<i", 99)),
)
_colmap(
    "a camera of 2^62 pixels",
    UNREADABLE | {"scene.lens_invalid", "scene.image_size"},
    _replace("cameras.bin", 16, HUGE),
)
_colmap(
    "a focal length of NaN", {"scene.lens_invalid"}, _replace("cameras.bin", 32, struct.pack("<d", np.nan))
)
_colmap(
    "a quaternion of NaN",
    FINITE | RIGID | CAMERA,
    _replace("images.bin", 12, struct.pack("<4d", *[np.nan] * 4)),
)
_colmap("a quaternion of zeros", RIGID | CAMERA | FINITE, _replace("images.bin", 12, bytes(32)))
_colmap("2^62 points of an image", UNREADABLE, _replace("images.bin", 8 + 64 + len("IMG_0000.png") + 1, HUGE))
_colmap(
    "a name without an end",
    UNREADABLE,
    lambda place: (place / "images.bin").write_bytes(
        (place / "images.bin").read_bytes()[:72] + b"a" * 100_000
    ),
)
_colmap(
    "names that lead outside",
    PATH | {"scene.file_missing"},
    lambda place: (place / "images.bin").write_bytes(
        (place / "images.bin").read_bytes().replace(b"IMG_0003.png", b"../../x3.png")
    ),
)
_colmap(
    "cut off",
    UNREADABLE,
    lambda place: (place / "images.bin").write_bytes((place / "images.bin").read_bytes()[:200]),
)
_colmap("empty", UNREADABLE, lambda place: (place / "cameras.bin").write_bytes(b""))
_colmap(
    "2^62 points",
    UNREADABLE | {""},
    lambda place: (place / "points3D.bin").write_bytes(HUGE + bytes(100)),
)
_colmap(
    "text of words",
    UNREADABLE,
    lambda place: (place / "cameras.txt").write_text("1 PINHOLE wide high f f c c\n"),
    text=True,
)
_colmap(
    "text of 10 million characters in a line",
    UNREADABLE | {"scene.lens_invalid"},
    lambda place: (place / "cameras.txt").write_text("1 PINHOLE 8 8 " + "1" * 10_000_000 + " 1 4 4\n"),
    text=True,
)

# ---- pickles ----------------------------------------------------------------------


class _Calls:
    """Runs a command when it is unpickled."""

    def __reduce__(self) -> Any:
        return (__import__("os").system, ("touch /tmp/lambent-attack",))


def _glossy(name: str, data: bytes) -> None:
    def write(folder: Path) -> None:
        GlossyFolder(folder)
        (folder / "potion" / "3-camera.pkl").write_bytes(data)

    CAPTURES[f"pickle: {name}"] = (write, {"scene.pickle_refused", "scene.camera_invalid"})


_glossy("a call", pickle.dumps(_Calls()))
_glossy("a call of numpy", b"cnumpy.core.multiarray\n_reconstruct\n(cos\nsystem\n(I0\ntS'b'\ntR.")
_glossy("a billion laughs", b"\x80\x02" + b"]2a" * 60 + b".")
_glossy("2^60 bytes", b"\x80\x04\x8e" + struct.pack("<Q", 2**60) + b"x.")
_glossy("a memo of 2^31", b"\x80\x02]r\xff\xff\xff\x7f.")
_glossy("100 000 lists deep", b"\x80\x02" + b"]" * 100_000 + b"a" * 99_999 + b".")
_glossy(
    "an array of 2^40 numbers",
    pickle.dumps(np.zeros((3, 4))).replace(struct.pack("<BB", 75, 3), b"\x8a\x06\0\0\0\0\0\1", 1),
)
_glossy("empty", b"")


@(lambda write: CAPTURES.__setitem__("npy of 2^60 numbers among photographs", (write, {""})))
def _(folder: Path) -> None:
    NerfstudioFolder(folder)
    head = b"\x93NUMPY\x01\0v\0{'descr': '<f8', 'fortran_order': False, 'shape': (1152921504606846976,), }"
    (folder / "data.npy").write_bytes(head.ljust(128))
    (folder / "more.npz").write_bytes(b"PK\x03\x04" + bytes(100))


@(lambda write: CAPTURES.__setitem__("a lens of 1e-300", (write, {"scene.lens_invalid"})))
def _(folder: Path) -> None:
    NerfstudioFolder(folder)
    value = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**value, "fl_x": 1e-300, "k1": 1e300}))


@(lambda write: CAPTURES.__setitem__("a lens that folds", (write, {"scene.lens_invalid"})))
def _(folder: Path) -> None:
    NerfstudioFolder(folder)
    value = json.loads((folder / "transforms.json").read_text())
    (folder / "transforms.json").write_text(json.dumps({**value, "k1": -5.0, "k2": 1e6}))

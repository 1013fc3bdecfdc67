"""The capture that the corpus changes: a ball of one colour before dark grey, seen from eight sides.

The ball's light is `BALL` in linear Rec. 709 and covers `COVER` of each photograph of `SIDE` x `SIDE` pixels.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy import ndarray
from strangers import profiles
from strangers.colours import SPACES, Space, levels_of
from support.captures import ring

SIDE = 64
COUNT = 8
BALL = (0.6, 0.2, 0.1)
GREY = 0.05
COVER = 0.3086
"""Of the disc of 20 pixels around the middle."""
ANGLE = 0.628318530717959
FOCAL = 98.486
"""Pixels, by `ANGLE`."""

Save = Callable[[Path, ndarray, ndarray], None]
"""Writes light [height, width, 3] and alpha [height, width] to a file."""


def disc() -> ndarray:
    """Return the coverage of the ball."""
    rows, columns = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    return (np.hypot(rows, columns) <= 20.0).astype(float)


def light() -> ndarray:
    """Return the photograph in linear Rec. 709."""
    return np.where(disc()[..., None] > 0, np.array(BALL), GREY)


def view_light(index: int) -> ndarray:
    """Return the photograph of a view; a spot tells it from the others."""
    colours = light()
    colours[2 + 6 * index : 7 + 6 * index, 1:9] = (0.05, 0.5 - 0.05 * index, 0.1 + 0.1 * index)
    return colours


def levels(colours: ndarray, space: Space | None = None, full: int = 255) -> ndarray:
    """Return levels of light in a space, sRGB by default."""
    shares = np.clip(levels_of(colours, space or SPACES["srgb"]), 0.0, 1.0)
    return np.round(shares * full).astype(np.uint8 if full == 255 else np.uint16)


def save_png(path: Path, colours: ndarray, alpha: ndarray) -> None:
    """Write sRGB levels without alpha."""
    del alpha
    path.write_bytes(profiles.png(levels(colours)))


def save_rgba(path: Path, colours: ndarray, alpha: ndarray) -> None:
    """Write sRGB levels with straight alpha."""
    cover = np.round(255 * alpha).astype(np.uint8)[..., None]
    path.write_bytes(profiles.png(np.concatenate([levels(colours), cover], axis=-1)))


def write_photographs(folder: Path, names: list[str], save: Save = save_png) -> None:
    """Write one photograph for each name."""
    for index, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        save(folder / name, view_light(index), disc())


def frames_of(names: list[str], **frame: object) -> list[dict]:
    """Return the frames of a transforms file; entries that are functions get the number of the frame."""
    return [
        {
            "file_path": name,
            "transform_matrix": pose.tolist(),
            **{key: value(index) if callable(value) else value for key, value in frame.items()},
        }
        for index, (name, pose) in enumerate(zip(names, ring(len(names)), strict=True))
    ]


def names_of(suffix: str = ".png", folder: str = "images/") -> list[str]:
    """Return the usual names of the photographs."""
    return [f"{folder}{index:03d}{suffix}" for index in range(COUNT)]


def write_transforms(
    folder: Path,
    names: list[str] | None = None,
    save: Save = save_png,
    *,
    lens: dict | None = None,
    named: Callable[[str], str] = lambda name: name,
    file: str = "transforms.json",
    frame: dict | None = None,
) -> None:
    """Write photographs and a transforms file; `named` is how the file calls them, `frame` adds to frames."""
    names = names or names_of()
    write_photographs(folder, names, save)
    record = {
        **({"camera_angle_x": ANGLE} if lens is None else lens),
        "frames": frames_of([named(name) for name in names], **(frame or {})),
    }
    (folder / file).write_text(json.dumps(record), encoding="utf-8")


def write_masks(folder: Path, names: list[str], write: Callable[[Path, ndarray], None]) -> None:
    """Write the mask of the ball for each name."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write(folder / name, disc())


def masked(write: Callable[[Path, ndarray], None], suffix: str = ".png") -> Callable[[Path], None]:
    """Return a writer of a capture whose frames name masks."""

    def make(folder: Path) -> None:
        write_transforms(folder, frame={"mask_path": lambda index: f"masks/{index:03d}{suffix}"})
        write_masks(folder, names_of(suffix, "masks/"), write)

    return make

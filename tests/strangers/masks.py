"""Masks as strangers save them, each meaning one object."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy import ndarray
from PIL import Image
from strangers import floats, profiles
from strangers.pictures import HEIGHT, WIDTH, enlarged, turned

Write = Callable[[Path, ndarray], None]


def mask_alpha(*, soft: bool) -> ndarray:
    """Return the coverage of a mask's object; it lies inside the frame, so that the border is background."""
    alpha = np.zeros((HEIGHT, WIDTH))
    alpha[3:19, 5:13] = 1.0
    alpha[10:19, 13:24] = 1.0
    alpha[3:7, 13:17] = 1.0
    if soft:
        alpha[3:19, 4] = 102 / 255
    return alpha


def _grey(scale: float, kind: type = np.uint8, *, bits: int = 0) -> Write:
    return lambda path, alpha: _save(path, profiles.png(np.round(alpha * scale).astype(kind), bits=bits))


def _save(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _palette(path: Path, alpha: ndarray, colours: bytes, *, bits: int = 0, labels: bool = False) -> None:
    index = np.round(alpha).astype(np.uint8)
    if labels:  # two parts of one object
        index[:, alpha.shape[1] // 2 :] *= 2
    path.write_bytes(profiles.png(index, palette=colours, bits=bits))


def _by_alpha(level: int) -> Write:
    def write(path: Path, alpha: ndarray) -> None:
        pixels = np.full((*alpha.shape, 4), level, np.uint8)
        pixels[..., 3] = np.round(255 * alpha)
        path.write_bytes(profiles.png(pixels))

    return write


def _labels(path: Path, alpha: ndarray) -> None:
    index = np.round(alpha).astype(np.uint8)
    index[:, alpha.shape[1] // 2 :] *= 2
    path.write_bytes(profiles.png(index))


def _pillow(suffix: str, **options: object) -> Write:
    del suffix

    def write(path: Path, alpha: ndarray) -> None:
        Image.fromarray(np.round(255 * alpha).astype(np.uint8)).save(path, **options)  # type: ignore[arg-type]

    return write


def _colours(path: Path, alpha: ndarray) -> None:
    grey = np.round(255 * alpha).astype(np.uint8)
    path.write_bytes(profiles.png(np.stack([grey] * 3, axis=-1)))


def _layers(path: Path, grey: ndarray, alpha: ndarray) -> None:
    path.write_bytes(profiles.png(np.stack([grey, 255 * alpha], axis=-1).round().astype(np.uint8)))


def _painted(path: Path, alpha: ndarray, colour: tuple[int, int, int], behind: tuple[int, int, int]) -> None:
    path.write_bytes(profiles.png(np.where(alpha[..., None] > 0, colour, behind).astype(np.uint8)))


MASKS: dict[str, tuple[str, Write]] = {
    "255": (".png", _grey(255)),
    "soft": (".png", _grey(255)),
    "01": (".png", _grey(1)),
    "labels": (".png", _labels),
    "1 bit": (".png", _grey(1, bits=1)),
    "16 bit": (".png", _grey(65535, np.uint16)),
    "16 bit 01": (".png", _grey(1, np.uint16)),
    "16 bit soft": (".png", _grey(65535, np.uint16)),
    "palette": (".png", lambda path, alpha: _palette(path, alpha, bytes([0, 0, 0, 128, 0, 0]))),
    "palette labels": (
        ".png",
        lambda path, alpha: _palette(path, alpha, bytes([0, 0, 0, 128, 0, 0, 0, 128, 0]), labels=True),
    ),
    "palette 1 bit": (
        ".png",
        lambda path, alpha: _palette(path, alpha, bytes([0, 0, 0, 255, 255, 255]), bits=1),
    ),
    "inverted": (".png", lambda path, alpha: _grey(255)(path, 1.0 - alpha)),
    "inverted 01": (".png", lambda path, alpha: _grey(1)(path, 1.0 - alpha)),
    "inverted 16 bit": (".png", lambda path, alpha: _grey(65535, np.uint16)(path, 1.0 - alpha)),
    "alpha white": (".png", _by_alpha(255)),
    "alpha black": (".png", _by_alpha(0)),
    "colours": (".png", _colours),
    "38": (".png", _grey(38)),
    "4 bit": (".png", _grey(15, bits=4)),
    "4 bit 01": (".png", _grey(1, bits=4)),
    "palette 2 bit": (
        ".png",
        lambda path, alpha: _palette(path, alpha, bytes([0, 0, 0, 9, 9, 9, 90, 0, 0]), bits=2, labels=True),
    ),
    "inverted 1 bit": (".png", lambda path, alpha: _grey(1, bits=1)(path, 1.0 - alpha)),
    "grey with alpha": (".png", lambda path, alpha: _layers(path, 255 * np.ones_like(alpha), alpha)),
    "grey with full alpha": (".png", lambda path, alpha: _layers(path, 255 * alpha, np.ones_like(alpha))),
    "red on black": (".png", lambda path, alpha: _painted(path, alpha, (255, 0, 0), (0, 0, 0))),
    "blue on white": (".png", lambda path, alpha: _painted(path, alpha, (0, 0, 255), (255, 255, 255))),
    "palette white first": (
        ".png",
        lambda path, alpha: _palette(path, 1.0 - alpha, bytes([255, 255, 255, 0, 0, 0])),
    ),
    "palette of greys": (
        ".png",
        lambda path, alpha: _palette(path, 255 * alpha, bytes(level for level in range(256) for _ in "rgb")),
    ),
    "palette clear": (
        ".png",
        lambda path, alpha: path.write_bytes(
            profiles.png(
                np.round(alpha).astype(np.uint8),
                profiles.chunk(b"tRNS", b"\0"),
                palette=bytes([0, 0, 0, 90, 40, 20]),
            )
        ),
    ),
    "exr": (".exr", lambda path, alpha: floats.write_exr(path, {"Y": alpha.astype(np.float16)})),
    "orientation": (
        ".png",
        lambda path, alpha: path.write_bytes(
            profiles.png(
                turned(np.round(255 * alpha).astype(np.uint8), 8),
                profiles.chunk(b"eXIf", profiles.exif(orientation=6)[6:]),
            )
        ),
    ),
    "jpeg": (".jpg", _pillow(".jpg", quality=97)),
    "webp": (".webp", _pillow(".webp", lossless=True)),
    "tiff": (".tif", _pillow(".tif")),
}
"""Suffix, and how the coverage is written."""
LOSSY = {"jpeg": 0.06}
"""Coverage by which a mask may miss."""
SOFT = ("soft", "16 bit soft", "alpha white", "jpeg")


def write_mask(folder: Path, stem: str, kind: str, *, shown: int = 1, scale: int = 1) -> tuple[str, ndarray]:
    """Write a mask and return its name and the coverage of the stored photograph that it means.

    `shown` is the EXIF orientation of the photograph on which it was painted upright; 1 for none.
    """
    suffix, write = MASKS[kind]
    alpha = enlarged(mask_alpha(soft=kind in SOFT), scale)
    write(folder / (stem + suffix), turned(alpha, shown))
    return stem + suffix, alpha

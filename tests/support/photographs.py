"""Photographs as people hand them over: textured, with EXIF, each of another part of one large picture."""

from functools import cache
from pathlib import Path

import numpy as np
from numpy import ndarray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy import ndimage

WIDTH, HEIGHT = 192, 144
NUM_VIEWS = 5


@cache
def canvas() -> ndarray:
    """Return the large picture, [height, width, 3] of 8 bit."""
    rng = np.random.default_rng(7)
    coarse = [ndimage.gaussian_filter(rng.uniform(0, 255, (400, 900)), 12.0) for _ in range(3)]
    colours = np.stack([(c - c.mean()) * 14.0 + 120.0 for c in coarse], axis=-1)
    fine = ndimage.gaussian_filter(rng.normal(0.0, 60.0, (400, 900, 1)), (0.8, 0.8, 0.0))
    return np.clip(colours + fine, 5, 245).astype(np.uint8)


def view(index: int, width: int = WIDTH, height: int = HEIGHT) -> Image.Image:
    """Return a textured photograph, another for every index."""
    rows, columns = 17 * index % (400 - HEIGHT), 97 * index % (900 - WIDTH)
    image = Image.fromarray(canvas()[rows : rows + HEIGHT, columns : columns + WIDTH])
    return image if (width, height) == (WIDTH, HEIGHT) else image.resize((width, height))


def exif(**changes: object) -> bytes:
    """Return the EXIF of an ordinary photograph; `changes` replaces focal length, time and sizes."""
    facts = {
        "focal": 28.0,
        "focal35": 42,
        "time": IFDRational(1, 60),
        "lens": "28mm F2",
        "size": (WIDTH, HEIGHT),
    }
    facts.update(changes)
    tags = Image.Exif()
    tags.update({0x010F: "Camera", 0x0110: "One", 0x0112: facts.get("orientation", 1)})
    tags.get_ifd(0x8769).update(
        {
            0x829A: facts["time"],
            0x829D: IFDRational(8, 1),
            0x8827: 100,
            0x920A: IFDRational(round(10 * float(facts["focal"])), 10),
            0xA405: facts["focal35"],
            0xA434: facts["lens"],
            0xA002: facts["size"][0],
            0xA003: facts["size"][1],
        }
    )
    return tags.tobytes()


def write_views(
    folder: Path, count: int = NUM_VIEWS, suffix: str = ".jpg", first: int = 0, **options: object
) -> None:
    """Write `count` sound photographs."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(first, first + count):
        if suffix == ".jpg":
            view(index).save(folder / f"IMG_{index:04d}.jpg", quality=90, **({"exif": exif()} | options))
        else:
            view(index).save(folder / f"IMG_{index:04d}{suffix}", **options)


def heif() -> None:
    """Teach Pillow to write HEIC."""
    import pillow_heif

    pillow_heif.register_heif_opener()

"""The small pictures of a contact sheet: from pictures as they lie in a folder, or kept aside in one file."""

import io
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from lambent_core.files import whole_file
from numpy.typing import NDArray
from PIL import Image

from lambent_relight.batch.run import Result

NAME = "tiles.zip"
TILE = 128
"""Width and height of a tile, pixels."""
_PAPER = (255, 255, 255, 255)


def thumbnail(folder: Path, result: Result, side: int = TILE) -> Image.Image | None:
    """Return a picture over white, at most `side` pixels wide and high; None where there is none."""
    record = result.record
    if record is None:
        return None
    if "png" in record.files:
        with Image.open(folder / record.files["png"].path) as image:
            picture = image.convert("RGBA")
    else:
        picture = _from_exr(folder / record.files["exr"].path)
    picture.thumbnail((side, side), Image.Resampling.BICUBIC)
    return Image.alpha_composite(Image.new("RGBA", picture.size, _PAPER), picture).convert("RGB")


def _from_exr(path: Path) -> Image.Image:
    """Return the beauty pass of a linear EXR, whose colours are multiplied by alpha, over white."""
    import OpenEXR
    from lambent_core.colour import srgb_from_linear

    channels = OpenEXR.File(str(path), separate_channels=True).parts[0].channels
    planes: list[NDArray[np.float32]] = [channels[name].pixels.astype(np.float32) for name in "RGBA"]
    rgb = np.stack(planes[:3], axis=-1) + (1.0 - planes[3][..., None])
    return Image.fromarray(np.round(255.0 * srgb_from_linear(rgb)).astype(np.uint8)).convert("RGBA")


def write_tiles(folder: Path, results: Iterable[Result]) -> Path:
    """Write the tile of every picture in `folder` into one zip there, under the pictures' names."""
    path = folder / NAME
    with whole_file(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        for result in results:
            tile = thumbnail(folder, result)
            if tile is not None:
                buffer = io.BytesIO()
                tile.save(buffer, format="PNG")
                archive.writestr(f"{result.path}.png", buffer.getvalue())
    return path


class Tiles:
    """Tiles of several files that `write_tiles` made; one of them is open at a time."""

    def __init__(self, paths: Iterable[Path]) -> None:
        self._places: dict[str, Path] = {}
        for path in paths:
            with zipfile.ZipFile(path) as archive:
                self._places |= dict.fromkeys(archive.namelist(), path)

    def __call__(self, result: Result) -> Image.Image | None:
        """Return the tile of a picture; None where there is none."""
        name = f"{result.path}.png"
        if name not in self._places:
            return None
        with zipfile.ZipFile(self._places[name]) as archive:
            content = archive.read(name)
        with Image.open(io.BytesIO(content)) as image:
            return image.convert("RGB")

"""Rows of the corpus about formats of pictures: EXR, Radiance, TIFF, AVIF and those that are not read."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from strangers import floats
from strangers.ball import BALL, COUNT, COVER, SIDE, levels, names_of, write_photographs
from strangers.colours import SPACES, levels_of
from strangers.rows import Make, jpeg, posed, row

# Pictures: EXR.


def _exr(**options: object) -> Callable:
    """Return a writer of half floats; `alpha` is none, straight or premultiplied."""
    alpha_is = str(options.pop("alpha", "none"))
    space = SPACES[str(options.pop("space", "linear"))]
    layer = str(options.pop("layer", ""))
    stated = space if space.name != "linear" else None

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        values = levels_of(colours, space)
        if alpha_is == "premultiplied":
            values = values * alpha[..., None]
        planes = {layer + name: values[..., index].astype(np.float16) for index, name in enumerate("RGB")}
        if alpha_is != "none":
            planes[layer + "A"] = alpha.astype(np.float16)
        floats.write_exr(path, planes, space=stated, **options)  # type: ignore[arg-type]

    return save


def _soft_exr(rim: float) -> Callable:
    """Return a writer of premultiplied colours whose outline is half covered, and so much brighter."""

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        rows, columns = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
        radius = np.hypot(rows, columns)
        alpha = np.where(radius <= 16.0, 1.0, np.where(radius <= 20.0, 0.5, 0.0))
        edge = ((radius > 16.0) & (radius <= 20.0))[..., None]
        _exr(alpha="premultiplied")(path, np.where(edge, rim * colours, colours), alpha)

    return save


def _window(grow: int) -> Callable:
    """Return a writer whose stored pixels reach so far beyond the frame on each side; less with < 0."""

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        if grow > 0:
            colours = np.pad(colours, ((grow, grow), (grow, grow), (0, 0)), mode="edge")
            alpha = np.pad(alpha, grow)
        else:
            part = slice(-grow, grow)
            colours, alpha = colours[part, part], alpha[part, part]
        writer = _exr(alpha="premultiplied", data_at=(-grow, -grow), display=(SIDE, SIDE))
        writer(path, colours, alpha)

    return save


def _luminance_chroma(sampling: int) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        y = colours @ np.array([0.2126, 0.7152, 0.0722])
        planes = {"Y": (y, 1)}
        for name, channel in (("RY", 0), ("BY", 2)):
            planes[name] = ((colours[..., channel] / y - 1.0)[::sampling, ::sampling], sampling)
        floats.write_subsampled_exr(path, planes)

    return save


def _parts(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    depth = {"depth": {"Z": np.ones((SIDE, SIDE), np.float32)}}
    small = {"thumbnail": {name: np.zeros((8, 8), np.float16) for name in "RGB"}}
    _exr(alpha="premultiplied", extra_parts={**depth, **small})(path, colours, alpha)


def _integers(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    del alpha
    values = np.round(255 * colours).astype(np.uint32)
    floats.write_exr(path, {name: values[..., index] for index, name in enumerate("RGB")})


_CUT = {"light": BALL, "alpha": COVER}
row("a11 exr premultiplied", posed(_soft_exr(1.0), ".exr"), light=BALL, alpha=0.2534)
row(
    "a11d exr premultiplied with a bright rim",
    posed(_soft_exr(2.0), ".exr"),
    edge=(1.2, 0.4, 0.2),
    alpha=0.2534,
    or_said=("straight",),
)
row("a11e exr premultiplied, its outline", posed(_soft_exr(1.0), ".exr"), edge=BALL, alpha=0.2534)
row("a11c exr without alpha", posed(_exr(), ".exr"), light=BALL)
row("a12 exr data window", posed(_window(-10), ".exr"), **_CUT, or_said=("window",))
row("a12b exr overscan", posed(_window(4), ".exr"), **_CUT, or_said=("window",))
for _name in ("ap1", "ap0", "rec2020-linear", "p3-linear"):
    row(f"a13 exr {_name}", posed(_exr(space=_name), ".exr"), light=BALL)
row("a14 exr luminance chroma", posed(_luminance_chroma(2), ".exr"), light=BALL, or_said=("Y",))
row("a14b exr luminance chroma everywhere", posed(_luminance_chroma(1), ".exr"), light=BALL, or_said=("Y",))
row("a14c exr parts", posed(_parts, ".exr"), **_CUT)
row("a14d exr layer", posed(_exr(alpha="premultiplied", layer="ViewLayer.Combined."), ".exr"), **_CUT)
row("a14e exr integers", posed(_integers, ".exr"), refused=("integer", "000.exr"))

# Pictures: formats.


def _tiff(full: int = 255, **options: object) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        import tifffile

        del alpha
        tifffile.imwrite(path, levels(colours, full=full), photometric="rgb", metadata=None, **options)

    return save


def _float_tiff(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    import tifffile

    del alpha
    tifffile.imwrite(path, colours.astype(np.float32), photometric="rgb", metadata=None)


def _mixed(suffix: str, save: Callable) -> Make:
    def make(folder: Path) -> None:
        write_photographs(folder, [f"IMG_{index:03d}.jpg" for index in range(COUNT // 2)], jpeg())
        rest = [f"IMG_{index:03d}{suffix}" for index in range(COUNT // 2, COUNT)]
        write_photographs(folder, rest, save)

    return make


def _format(name: str) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        Image.fromarray(levels(colours)).save(path, name)

    return save


def _avif(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    del alpha
    Image.fromarray(levels(colours)).save(path, "AVIF", quality=100, subsampling="4:4:4")


row("a16 tiff", posed(_tiff(), ".tif"), light=BALL, or_said=("TIFF",))
row("a16d tiff lzw", posed(_tiff(compression="lzw"), ".tiff"), light=BALL, or_said=("TIFF",))
row("a16e tiff 16 bit zip", posed(_tiff(65535, compression="zlib"), ".tif"), light=BALL, or_said=("TIFF",))
row("a16f tiff of floats", posed(_float_tiff, ".tif"), light=BALL, or_said=("TIFF",))
row("a16b tiff beside jpeg", _mixed(".tif", _tiff()), has_cameras=False, or_said=("4 .tif", ".tif"))
row("a16c avif", _mixed(".avif", _avif), has_cameras=False, or_said=(".avif",))
row("a16g avif named", posed(_avif, ".avif"), light=BALL, or_said=("AVIF",))
row("a16h bmp beside jpeg", _mixed(".bmp", _format("BMP")), has_cameras=False, or_said=(".bmp",))
row("a16i gif named", posed(_format("GIF"), ".gif"), refused=(".gif",))
row(
    "a16j bmp alone",
    lambda folder: write_photographs(folder, names_of(".bmp", ""), _format("BMP")),
    refused=(".bmp",),
)

"""Opens OpenEXR photographs: any primaries, windows, parts and layers, as colours with straight alpha.

Colours in an EXR are multiplied by alpha (OpenEXR, "Technical Introduction": associated alpha) and are
divided by it here.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Channels32, Grey32, Reduced32
from lambent_capture.pictures.colour_space import LINEAR, ColourSpace, of_chromaticities
from lambent_capture.pictures.picture_error import PictureError, first_bytes

MAX_EXR_PIXELS = 16 * 2**20
"""Pixels of a single picture: 4096 x 4096; they are up to four times as large in memory as 8-bit ones."""
LEAST_ALPHA = 1e-4
"""Where less than this is covered, a colour divided by alpha would be rounding."""
STRAIGHT_SHARE = 0.5
"""Share of the transparent pixels that show colours from which on a file cannot hold multiplied ones."""
_NEAR, _LEAST_OUTLINE = 3.0, 20
"""How far from the object pixels of its outline count, and how many of them say something."""
_LEAST_SLOPE = 0.4
"""Slope of log brightness over log alpha along the outline: 1 for multiplied colours, 0 for others."""
STRAIGHT = (
    "has colours that are not multiplied by alpha, as those of an EXR are to be, so they are taken as they "
    "are (straight)"
)
_WINDOW = re.compile(rb"d(?:ata|isplay)Window\0box2i\0\x10\0\0\0(.{16})", re.DOTALL)
_PREFERRED_LAYERS = ("combined", "beauty", "rgba", "composite", "color", "colour", "rgb")
_REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
_LUMINANCE = (0.2126, 0.7152, 0.0722)


def exr_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels of the display window of the part that is read.

    Raises `PictureError` for a file without a readable header, or whose windows hold more than the limit.
    """
    return _size(_chosen(path)[1]["displayWindow"])


def exr_has_alpha(path: Path) -> bool:
    """Return whether the part that is read has alpha, from the header."""
    return "A" in _chosen(path)[2]


def exr_pixels(path: Path) -> tuple[Channels32, Grey32 | None, ColourSpace, str]:
    """Return colours (one or three channels) over the display window, straight alpha, their space, any doubt.

    What the data window leaves out is black, and transparent where there is alpha; what it has beyond the
    display window is dropped. Raises `PictureError`.
    """
    number, header, names = _chosen(path)
    from lambent_core.errors import EnvironmentFileError
    from lambent_core.exr import read_exr_parts

    try:
        channels = read_exr_parts(path, max_pixels=MAX_EXR_PIXELS)[number].channels
    except EnvironmentFileError as error:
        said = error.message.removeprefix(f'"{path.name}" ')
        raise PictureError("scene.image_broken", f"cannot be decoded ({said}); export it again") from error
    planes = {key: _plane(channels[name], header) for key, name in names.items()}
    space = _space(header)
    if "RY" in planes:
        planes = _from_luminance_chroma(planes, header)
    colours = np.stack([planes[key] for key in ("RGB" if "R" in planes else "Y")], axis=-1)
    alpha = np.clip(planes["A"], 0.0, 1.0) if "A" in planes else None
    if alpha is None:
        return colours, None, space, ""
    if _is_straight(colours, alpha):
        return colours, alpha, space, STRAIGHT
    covered = alpha > LEAST_ALPHA
    colours[covered] /= alpha[covered][:, None]
    return colours, alpha, space, ""


def _chosen(path: Path) -> tuple[int, dict[str, Any], dict[str, str]]:
    """Return number and header of the part to read, and which of its channels are R, G, B, A or Y, RY, BY."""
    import OpenEXR

    head = first_bytes(path, 65536)
    if not head.startswith(b"\x76\x2f\x31\x01"):
        raise PictureError("scene.image_not_a_picture", "is not an EXR picture; export or copy it again")
    # The library does not open a file whose windows are absurd, and does not say why.
    for match in _WINDOW.finditer(head):
        x0, y0, x1, y1 = np.frombuffer(match[1], dtype="<i4").tolist()
        _refuse_large((x1 - x0 + 1, y1 - y0 + 1))
    try:
        headers = [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
        sizes = [
            (_size(header["dataWindow"]), _size(header["displayWindow"]), header["channels"])
            for header in headers
        ]
    except Exception as error:  # the library raises anything for headers that are damaged
        raise PictureError("scene.image_broken", "cannot be decoded as OpenEXR; export it again") from error
    candidates = []
    for number, (stored, shown, channels) in enumerate(sizes):
        if min(*stored, *shown) <= 0:
            raise PictureError("scene.image_broken", "has no pixels; export it again")
        _refuse_large(stored)
        _refuse_large(shown)
        named = _colour_channels([str(channel.name) for channel in channels])
        if named:
            rank = ("R" in named) + ("A" in named), int(np.prod(shown)), -number
            candidates.append((rank, number, named))
    if not candidates:
        every = sorted(str(channel.name) for *_, channels in sizes for channel in channels)
        raise PictureError(
            "scene.image_broken",
            f"has channels {every[:16]}, expected R, G, B (and A), Y, or one layer of them; export it again",
        )
    _, number, names = max(candidates, key=lambda candidate: candidate[0])
    return number, headers[number], names


def _refuse_large(size: tuple[int, int]) -> None:
    if min(size) > 0 and size[0] * size[1] > MAX_EXR_PIXELS:
        raise PictureError(
            "scene.image_too_large",
            f"has {size[0]} x {size[1]} pixels; the limit is {MAX_EXR_PIXELS} pixels, so reduce it",
        )


def _colour_channels(names: list[str]) -> dict[str, str]:
    """Return the channel for each of R, G, B, A (or Y, RY, BY, A) of the picture proper, or nothing.

    Layers are named before a dot: `ViewLayer.Combined.R`. A picture of several layers without one that is
    usual for the picture itself has nothing that could be chosen.
    """
    layers: dict[str, dict[str, str]] = {}
    for name in names:
        layer, _, channel = name.rpartition(".")
        key = {"red": "R", "green": "G", "blue": "B", "alpha": "A"}.get(channel.lower(), channel.upper())
        layers.setdefault(layer, {})[key] = name
    usable = {}
    for layer, channels in layers.items():
        for keys in (("R", "G", "B"), ("Y", "RY", "BY"), ("Y",)):
            if all(key in channels for key in keys):
                usable[layer] = {key: channels[key] for key in (*keys, "A") if key in channels}
                break
    if "" in usable:
        return usable[""]
    for word in _PREFERRED_LAYERS:
        for layer in sorted(usable):
            if layer.lower().rpartition(".")[2] == word:
                return usable[layer]
    return next(iter(usable.values())) if len(usable) == 1 else {}


def _plane(channel: Any, header: Mapping[str, Any]) -> Grey32:
    """Return a channel over the display window. Chroma may be stored for every second pixel."""
    pixels = channel.pixels
    if pixels is None or pixels.dtype not in (np.float16, np.float32):
        raise PictureError(
            "scene.image_format", "stores colours as integers, whose scale is not stated; save half or float"
        )
    (x0, y0), (x1, y1) = (tuple(int(v) for v in corner) for corner in header["dataWindow"])
    across, down = x1 - x0 + 1, y1 - y0 + 1
    if (channel.xSampling, channel.ySampling) != (1, 1):
        pixels = _upsampled(pixels.astype(np.float32), (x0, y0), (across, down), channel)
    if pixels.shape != (down, across):
        raise PictureError("scene.image_broken", "has channels of different sizes; export it again")
    (left, top), (right, bottom) = (tuple(int(v) for v in corner) for corner in header["displayWindow"])
    if (left, top, right, bottom) == (x0, y0, x1, y1):
        return pixels.astype(np.float32)
    plane = np.zeros((bottom - top + 1, right - left + 1), dtype=np.float32)
    first_x, last_x = max(x0, left), min(x1, right) + 1
    first_y, last_y = max(y0, top), min(y1, bottom) + 1
    if first_x < last_x and first_y < last_y:
        plane[first_y - top : last_y - top, first_x - left : last_x - left] = pixels[
            first_y - y0 : last_y - y0, first_x - x0 : last_x - x0
        ]
    return plane


def _upsampled(pixels: Reduced32, origin: tuple[int, int], size: tuple[int, int], channel: Any) -> Grey32:
    """Return a subsampled channel at every pixel, linearly between its samples.

    Samples lie where the coordinate is a multiple of the sampling. Source: OpenEXR file layout.
    """
    for axis, sampling, start, count in (
        (0, channel.ySampling, origin[1], size[1]),
        (1, channel.xSampling, origin[0], size[0]),
    ):
        if not pixels.shape[axis]:
            raise PictureError("scene.image_broken", "has an empty channel; export it again")
        first = -(-start // sampling) * sampling
        places = np.clip((np.arange(start, start + count) - first) / sampling, 0, pixels.shape[axis] - 1)
        low = np.floor(places).astype(int)
        high = np.minimum(low + 1, pixels.shape[axis] - 1)
        weight = (places - low).astype(np.float32)
        weight = weight[:, None] if axis == 0 else weight[None, :]
        pixels = np.take(pixels, low, axis) * (1.0 - weight) + np.take(pixels, high, axis) * weight
    return pixels


def _from_luminance_chroma(planes: dict[str, ndarray], header: Mapping[str, Any]) -> dict[str, Grey32]:
    """Return R, G, B of Y, RY = (R - Y) / Y and BY = (B - Y) / Y. Source: OpenEXR, ImfRgbaYca.h."""
    red_weight, green_weight, blue_weight = _luminance(header)
    luminance = planes["Y"]
    red, blue = (planes["RY"] + 1.0) * luminance, (planes["BY"] + 1.0) * luminance
    green = (luminance - red_weight * red - blue_weight * blue) / green_weight
    alpha = {"A": planes["A"]} if "A" in planes else {}
    return {"R": red, "G": green, "B": blue, **alpha}


def _luminance(header: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the share of red, green and blue in the luminance of the file's primaries."""
    stated = header.get("chromaticities")
    if stated is None:
        return _LUMINANCE
    corners = np.array([(x, y, 1.0 - x - y) for x, y in np.reshape(stated, (4, 2)).tolist()]).T
    try:
        shares = corners[1, :3] * np.linalg.solve(corners[:, :3], corners[:, 3] / corners[1, 3])
    except (np.linalg.LinAlgError, ZeroDivisionError, FloatingPointError):
        shares = np.full(3, np.nan)
    if not np.isfinite(shares).all() or abs(shares[1]) < 1e-6:
        raise PictureError(
            "scene.colour_space", "states primaries that span no colours; export it as linear Rec. 709"
        )
    red, green, blue = shares.tolist()
    return red, green, blue


def _space(header: Mapping[str, Any]) -> ColourSpace:
    stated = header.get("chromaticities")
    if stated is None or np.allclose(np.ravel(stated), _REC709, atol=2e-3):
        return LINEAR
    return of_chromaticities(tuple(float(value) for value in np.ravel(stated)))


def _is_straight(colours: Channels32, alpha: Grey32) -> bool:
    """Return whether colours were clearly not multiplied by alpha, as some programs write them.

    Multiplied colours are 0 where alpha is, but for what glows (a flame, a lens flare), and along outlines
    they are darker than the object beside them, by alpha.
    """
    clear = alpha <= 0.0
    if clear.any() and float((colours[clear] > 0.0).any(axis=-1).mean()) > STRAIGHT_SHARE:
        return True
    light = colours.mean(axis=-1)
    far, nearest = ndimage.distance_transform_edt(alpha < 0.99, return_indices=True)
    rows, columns = np.nonzero((alpha > 0.1) & (alpha < 0.9) & (far <= _NEAR))
    beside = light[nearest[0][rows, columns], nearest[1][rows, columns]]
    share, seen = alpha[rows, columns], light[rows, columns]
    known = (beside > 1e-4) & (seen > 1e-5)
    if known.sum() < _LEAST_OUTLINE:
        return False
    ratio, by_alpha = np.log(seen[known] / beside[known]), np.log(share[known])
    as_multiplied = float(np.median(np.abs(ratio - by_alpha)))
    # Not for a rim that is brighter than what lies inside: multiplied colours still follow alpha there.
    follows = float(np.polyfit(by_alpha, ratio, 1)[0]) if np.ptp(by_alpha) > 0.5 else 1.0
    return follows < _LEAST_SLOPE and float(np.median(np.abs(ratio))) < 0.5 * as_multiplied


def _size(window: Any) -> tuple[int, int]:
    (x0, y0), (x1, y1) = ([int(v) for v in corner] for corner in window)
    return x1 - x0 + 1, y1 - y0 + 1

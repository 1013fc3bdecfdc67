"""Files of light as floats: OpenEXR through its library, Radiance HDR byte by byte."""

import struct
from pathlib import Path

import numpy as np
from numpy import ndarray
from strangers.colours import Space


def write_exr(
    path: Path,
    planes: dict[str, ndarray],
    *,
    space: Space | None = None,
    data_at: tuple[int, int] = (0, 0),
    display: tuple[int, int] | None = None,
    extra_parts: dict[str, dict[str, ndarray]] | None = None,
) -> None:
    """Write channels of half, float or unsigned numbers; `display` is width and height of the frame.

    `data_at` is where the first stored pixel lies in the frame; `extra_parts` come before, by name.
    """
    import OpenEXR

    shape = next(iter(planes.values())).shape[:2]

    def header(height: int, width: int) -> dict:
        shown = display or (shape[1], shape[0])  # one for all parts
        found: dict = {
            "compression": OpenEXR.ZIP_COMPRESSION,
            "type": OpenEXR.scanlineimage,
            "dataWindow": (
                np.array(data_at, np.int32),
                np.array([data_at[0] + width - 1, data_at[1] + height - 1], np.int32),
            ),
            "displayWindow": (np.zeros(2, np.int32), np.array([shown[0] - 1, shown[1] - 1], np.int32)),
        }
        if space is not None:
            found["chromaticities"] = (*space.primaries, *space.white)
        return found

    channels = {name: np.ascontiguousarray(plane) for name, plane in planes.items()}
    if not extra_parts:
        OpenEXR.File(header(*shape), channels).write(str(path))
        return
    parts = [
        OpenEXR.Part(header(*next(iter(part.values())).shape[:2]), part, name)
        for name, part in extra_parts.items()
    ]
    OpenEXR.File([*parts, OpenEXR.Part(header(*shape), channels, "picture")]).write(str(path))


def write_subsampled_exr(path: Path, planes: dict[str, tuple[ndarray, int]]) -> None:
    """Write half floats of which each plane has the pixels of every n-th row and column.

    The library for Python refuses planes of different sizes. Source: OpenEXR, "OpenEXR File Layout".
    """
    height, width = next(plane.shape for plane, sampling in planes.values() if sampling == 1)
    names = sorted(planes)

    def attribute(name: str, kind: str, data: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data

    channels = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", 1, 0, planes[name][1], planes[name][1])
        for name in names
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"\x76\x2f\x31\x01\x02\0\0\0"
    head += attribute("channels", "chlist", channels + b"\0") + attribute("compression", "compression", b"\0")
    head += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    head += attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0))
    head += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)) + b"\0"
    lines, offsets = [], []
    at = len(head) + 8 * height
    for row in range(height):
        data = b"".join(
            planes[name][0][row // planes[name][1]].astype("<f2").tobytes()
            for name in names
            if row % planes[name][1] == 0
        )
        lines.append(struct.pack("<ii", row, len(data)) + data)
        offsets.append(at)
        at += len(lines[-1])
    path.write_bytes(head + struct.pack(f"<{height}Q", *offsets) + b"".join(lines))


def rgbe(light: ndarray) -> ndarray:
    """Return pixels of red, green, blue and a shared exponent. Source: Ward, Graphics Gems II (1991)."""
    top = light.max(axis=-1)
    mantissa, exponent = np.frexp(np.maximum(top, 1e-30))
    scale = mantissa * 256.0 / np.maximum(top, 1e-30)
    bytes_ = np.zeros((*light.shape[:-1], 4), np.uint8)
    bytes_[..., :3] = (light * scale[..., None]).clip(0, 255).astype(np.uint8)
    bytes_[..., 3] = np.where(top > 1e-30, exponent + 128, 0)
    bytes_[top <= 1e-30] = 0
    return bytes_


def rgbe_light(pixels: ndarray) -> ndarray:
    """Return the light of such pixels at the lower end of each step.

    Radiance takes the middle, other readers do not; so half a step is allowed.
    """
    scale = np.ldexp(1.0, pixels[..., 3].astype(int) - 136)
    return np.where(pixels[..., 3:] > 0, pixels[..., :3] * scale[..., None], 0.0)


def write_hdr(
    path: Path, pixels: ndarray, *, header: tuple[str, ...] = (), coded: bool = True, rows: str = "-Y +X"
) -> None:
    """Write pixels of `rgbe`; `coded` packs rows by runs, `header` has lines such as EXPOSURE.

    `rows` is the order of the file: "-Y +X" begins at the upper left and goes along rows, "+X -Y" along
    columns.
    """
    if "+Y" in rows:
        pixels = pixels[::-1]
    if "-X" in rows:
        pixels = pixels[:, ::-1]
    first, second = rows.split()
    if "X" in first:
        pixels = pixels.swapaxes(0, 1)
    height, width = pixels.shape[:2]
    lines = ["#?RADIANCE", *header, "FORMAT=32-bit_rle_rgbe", "", f"{first} {height} {second} {width}", ""]
    data = "\n".join(lines).encode()
    for row in pixels:
        if not coded:
            data += row.tobytes()
            continue
        data += bytes([2, 2, width >> 8, width & 255])
        for channel in range(4):
            for start in range(0, width, 128):
                part = row[start : start + 128, channel].tobytes()
                data += bytes([len(part)]) + part
    path.write_bytes(data)

"""One known radiance, a polynomial of direction, written as an environment file in every layout and coding.

Directions are built by turning a viewer, or by the sentences of a format's specification, never by the tables
of the readers. `python tests/support/environment_layouts.py` writes tests/golden/environments, which the
tests of the Python and of the TypeScript reader share.
"""

import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

FOLDER = Path(__file__).parents[1] / "golden/environments"
SIDE, PROBE, SMALL = 16, 48, (8, 16)
REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
RADIANCE_DEFAULT = (0.640, 0.330, 0.290, 0.600, 0.150, 0.060, 1 / 3, 1 / 3)
# As published with ACES for linear sRGB, white adapted by Bradford.
ACESCG_FROM_REC709 = np.array([[0.6131, 0.3395, 0.0474], [0.0702, 0.9164, 0.0134], [0.0206, 0.1096, 0.8698]])
# ITU-R BT.2087, annex 2.
REC2020_FROM_REC709 = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])


def radiance(directions: np.ndarray) -> np.ndarray:
    """Return the radiance from directions [*batch, 3] in our world; all turns and mirrorings change it."""
    x, y, z = np.moveaxis(directions / np.linalg.norm(directions, axis=-1, keepdims=True), -1, 0)
    return np.stack(
        [1.0 + 0.5 * x + 0.3 * y * z, 1.0 + 0.6 * y - 0.2 * x, 1.0 + 0.7 * z + 0.2 * x * y], axis=-1
    )


def seen(ahead: np.ndarray, right: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return our directions of what a viewer along +x, upright, sees there."""
    return np.stack(np.broadcast_arrays(ahead, -right, up), axis=-1)


def face(side: int, *, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> np.ndarray:
    """Return radiance [side, side, 3] in a camera of 90 degrees that was turned right and then up."""
    place = (np.arange(side) + 0.5) * (2.0 / side) - 1.0
    down, right = np.meshgrid(place, place, indexing="ij")
    yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
    ahead, up = np.cos(pitch) + np.sin(pitch) * down, np.sin(pitch) - np.cos(pitch) * down
    return radiance(
        seen(np.cos(yaw) * ahead - np.sin(yaw) * right, np.sin(yaw) * ahead + np.cos(yaw) * right, up)
    )


def cube(side: int) -> dict[str, np.ndarray]:
    """Return the six faces upright, top and bottom as they join the front."""
    turns = {"front": (0, 0), "right": (90, 0), "back": (180, 0), "left": (-90, 0), "top": (0, 90)}
    return {n: face(side, yaw_deg=a, pitch_deg=b) for n, (a, b) in (turns | {"bottom": (0, -90)}).items()}


def cross_horizontal(side: int) -> np.ndarray:
    """Return a cross of 4 x 3 faces."""
    faces, empty = cube(side), np.zeros((side, side, 3))
    top, bottom = ([empty, faces[name], empty, empty] for name in ("top", "bottom"))
    middle = [faces[name] for name in ("left", "front", "right", "back")]
    return np.vstack([np.hstack(row) for row in (top, middle, bottom)])


def cross_vertical(side: int) -> np.ndarray:
    """Return a cross of 3 x 4 faces; the lowest is reached by tilting the camera on from the bottom."""
    faces, empty = cube(side), np.zeros((side, side, 3))
    middle = [faces[name] for name in ("left", "front", "right")]
    columns = (faces["top"], faces["bottom"], face(side, pitch_deg=-180))
    top, bottom, back = ([empty, picture, empty] for picture in columns)
    return np.vstack([np.hstack(row) for row in (top, middle, bottom, back)])


def strip(side: int) -> list[np.ndarray]:
    """Return +X, -X, +Y, -Y, +Z, -Z of OpenGL, in whose left-handed cube +z is ahead and +x right."""
    return [cube(side)[name] for name in ("right", "left", "top", "bottom", "front", "back")]


def openexr_cube(side: int) -> np.ndarray:
    """Return faces as ImfEnvmap.h of OpenEXR places them: pixel of (position in face), direction of it."""
    image = np.empty((6 * side, side, 3))
    last = side - 1
    for place_x in range(side):
        for place_y in range(side):
            a, b = 2.0 * place_x / last - 1.0, 2.0 * place_y / last - 1.0
            pixels = [
                ((place_y, last - place_x), (1, a, b)),
                ((last - place_y, last - place_x), (-1, a, b)),
                ((place_x, last - place_y), (a, 1, b)),
                ((place_x, place_y), (a, -1, b)),
                ((last - place_x, last - place_y), (a, b, 1)),
                ((place_x, last - place_y), (a, b, -1)),
            ]
            for number, ((column, row), (x, y, z)) in enumerate(pixels):
                # Its latitude-longitude maps have +z in the middle, +x to the left of it and y up.
                image[number * side + row, column] = radiance(
                    seen(np.float64(z), np.float64(-x), np.float64(y))
                )
    return image


def _disc(side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    place = (np.arange(side) + 0.5) * (2.0 / side) - 1.0
    down, right = np.meshgrid(place, place, indexing="ij")
    return right, -down, np.hypot(right, down)


def angular(side: int) -> np.ndarray:
    """Return a light probe: the angle from ahead is pi times the distance from the middle."""
    right, up, radius = _disc(side)
    around, angle = np.arctan2(up, right), np.pi * radius
    found = radiance(seen(np.cos(angle), np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around)))
    return np.where(radius[..., None] <= 1.0, found, 0.0)


def mirror_ball(side: int) -> np.ndarray:
    """Return a ball of mirrors seen by a far eye on +x, upright: what is ahead of the ball is the eye."""
    aside, up, radius = _disc(side)
    # To the eye's right is +y.
    normal = np.stack([np.sqrt(np.maximum(1.0 - radius**2, 0.0)), aside, up], axis=-1)
    mirrored = 2.0 * normal[..., :1] * normal - np.array([1.0, 0.0, 0.0])
    return np.where(
        radius[..., None] <= 1.0, radiance(np.where(radius[..., None] <= 1.0, mirrored, 1.0)), 0.0
    )


def latlong(height: int, width: int) -> np.ndarray:
    """Return a latitude-longitude map: ahead in the middle, what is right of it to the right."""
    turn = (np.arange(width) + 0.5) / width * 2.0 * np.pi - np.pi
    rise = np.pi / 2.0 - (np.arange(height)[:, None] + 0.5) / height * np.pi
    return radiance(seen(np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise) + 0.0 * turn))


def rgbe(image: np.ndarray) -> np.ndarray:
    """Return shared-exponent pixels [height, width, 4], rounded."""
    top = np.maximum(image.max(axis=-1), 1e-30)
    exponent = np.frexp(top * 256.0 / 255.0)[1]
    mantissa = np.round(image * np.ldexp(256.0, -exponent)[..., None])
    pixels = np.concatenate([mantissa, exponent[..., None] + 128], axis=-1)
    return np.where(image.max(axis=-1, keepdims=True) > 0.0, pixels, 0).astype(np.uint8)


def coded(line: np.ndarray) -> bytes:
    """Return pixels [length, 4] of a line run-length coded, with runs where values repeat."""
    body = bytearray(struct.pack(">BBH", 2, 2, len(line)))
    for plane in line.T:
        at = 0
        while at < len(plane):
            run = 1
            while at + run < len(plane) and run < 127 and plane[at + run] == plane[at]:
                run += 1
            body += bytes((128 + run, plane[at])) if run > 1 else bytes((1, plane[at]))
            at += run
    return bytes(body)


def repeated(line: np.ndarray) -> bytes:
    """Return pixels of a line with the old format's repeats."""
    body, at = bytearray(), 0
    while at < len(line):
        run = 1
        while at + run < len(line) and run < 256 and (line[at + run] == line[at]).all():
            run += 1
        body += bytes(line[at]) + (bytes((1, 1, 1, run - 1)) if run > 1 else b"")
        at += run
    return bytes(body)


def hdr(
    image: np.ndarray,
    *,
    header: str = "",
    order: str = "-Y +X",
    line: Callable[[int, np.ndarray], bytes] = lambda number, pixels: coded(pixels),
) -> bytes:
    """Return a Radiance file of the upright picture, stored in the scan order."""
    height, width, _ = image.shape
    pixels = rgbe(image)
    if "+Y" in order:
        pixels = pixels[::-1]
    if "-X" in order:
        pixels = pixels[:, ::-1]
    if order[1] == "X":
        pixels = pixels.transpose(1, 0, 2)
    sizes = {"X": width, "Y": height}
    size = f"{order[:2]} {sizes[order[1]]} {order[3:]} {sizes[order[4]]}"
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n{header}\n{size}\n".encode()
    return head + b"".join(line(number, np.ascontiguousarray(each)) for number, each in enumerate(pixels))


def like_coded() -> np.ndarray:
    """Return pixels [8, 384, 4] of which some begin a line like the head of a coded one of that length."""
    pixels = rgbe(latlong(8, 384))
    pixels[0, 0] = pixels[5, 0] = (2, 2, 1, 128)
    return pixels


def _primaries(values: tuple[float, ...]) -> str:
    return f"PRIMARIES= {' '.join(f'{value:.5f}' for value in values)}\n"


def _exr(path: Path, image: np.ndarray, **attributes: Any) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | attributes
    planes = {name: np.ascontiguousarray(image[..., at], np.float16) for at, name in enumerate("RGB")}
    OpenEXR.File(header, planes).write(str(path))


def subsampled(image: np.ndarray) -> bytes:
    """Return an uncompressed OpenEXR file whose blue has half the resolution."""
    height, width, _ = image.shape

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    names = (("B", 2), ("G", 1), ("R", 1))
    channels = b"".join(n.encode() + b"\0" + struct.pack("<iiii", 1, 0, step, step) for n, step in names)
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<ii", 20000630, 2) + attribute("channels", "chlist", channels + b"\0")
    head += attribute("compression", "compression", b"\0") + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window)
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0))
    head += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)) + b"\0"
    halves, chunks, offsets = image.astype(np.float16), b"", []
    for row in range(height):
        line = (halves[row, ::2, 2].tobytes() if row % 2 == 0 else b"") + halves[row, :, 1].tobytes()
        line += halves[row, :, 0].tobytes()
        offsets.append(len(head) + 8 * height + len(chunks))
        chunks += struct.pack("<ii", row, len(line)) + line
    return head + struct.pack(f"<{height}Q", *offsets) + chunks


def _window(left: int, top: int, right: int, bottom: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([left, top], np.int32), np.array([right, bottom], np.int32)


def _flat(_number: int, line: np.ndarray) -> bytes:
    return line.tobytes()


def _mixed(number: int, line: np.ndarray) -> bytes:
    return (coded, np.ndarray.tobytes, repeated)[number % 3](line)


def write_all(folder: Path) -> list[dict[str, Any]]:
    """Write every file, and return what a reader makes of it: `read_as` or `code`, and the `given` layout."""
    folder.mkdir(parents=True, exist_ok=True)
    cases: list[dict[str, Any]] = []

    def case(name: str, content: bytes | None = None, **wanted: Any) -> Path:
        if content is not None:
            (folder / name).write_bytes(content)
        cases.append({"file": name, **wanted})
        return folder / name

    small, stripes = latlong(*SMALL), strip(SIDE)
    case("latlong.hdr", hdr(latlong(32, 64)), read_as="latlong")
    case("cross_horizontal.hdr", hdr(cross_horizontal(SIDE)), read_as="cross-horizontal")
    _exr(case("cross_vertical.exr", read_as="cross-vertical"), cross_vertical(SIDE))
    _exr(case("strip_horizontal.exr", read_as="strip-horizontal"), np.hstack(stripes))
    case("strip_vertical.hdr", hdr(np.vstack(stripes)), read_as="strip-vertical")
    _exr(case("cube.exr", read_as="cube"), openexr_cube(SIDE), envmap=OpenEXR.ENVMAP_CUBE)
    case("angular.hdr", hdr(angular(PROBE)), read_as="angular")
    _exr(case("mirror_ball.exr", given="mirror-ball", read_as="mirror-ball"), mirror_ball(PROBE))
    white = np.where(cross_vertical(SIDE) > 0.0, cross_vertical(SIDE), 1.0)
    case("cross_on_white.hdr", hdr(white), read_as="cross-vertical")
    _exr(case("stated_latlong.exr", read_as="latlong"), latlong(16, 48), envmap=OpenEXR.ENVMAP_LATLONG)
    for order in ("+Y +X", "-Y -X", "+Y -X", "+X -Y", "-X -Y", "+X +Y", "-X +Y"):
        name = order.replace("+", "p").replace("-", "m").replace(" ", "_")
        case(f"order_{name}.hdr", hdr(small, order=order), read_as="latlong", coarse=True)
    case("mixed_rows.hdr", hdr(small, line=_mixed), read_as="latlong", coarse=True)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 384\n"
    flat = head + like_coded().tobytes()
    case("flat_like_coded.hdr", flat, given="latlong", read_as="latlong", coarse=True, skip_first=True)
    exposed = hdr(4.0 * small * (1.0, 2.0, 0.5), header="EXPOSURE=2\nCOLORCORR=1 2 0.5\nEXPOSURE=2\n")
    case("exposure.hdr", exposed, read_as="latlong", coarse=True)
    wide = small @ REC2020_FROM_REC709.T
    case("rec2020.hdr", hdr(wide, header=_primaries(REC2020)), read_as="latlong", coarse=True)
    aces = small @ ACESCG_FROM_REC709.T
    _exr(case("acescg.exr", read_as="latlong", coarse=True), aces, chromaticities=ACESCG)
    larger = np.pad(small, ((1, 2), (3, 1), (0, 0)), constant_values=9.0)
    windows = {"dataWindow": _window(-3, -1, 16, 9), "displayWindow": _window(0, 0, 15, 7)}
    _exr(case("overscan.exr", read_as="latlong", coarse=True), larger, **windows)
    windows = {"dataWindow": _window(2, 0, 17, 7), "displayWindow": _window(0, 0, 15, 7)}
    _exr(case("shifted.exr", code="environment.exr_cropped"), small, **windows)
    depth = OpenEXR.Part({}, {"Z": np.ones(SMALL, np.float32)}, "depth")
    # The library puts its own objects in place of the arrays.
    planes = {name: np.ascontiguousarray(small[..., at], np.float16) for at, name in enumerate("RGB")}
    path = case("second_part.exr", read_as="latlong", coarse=True)
    OpenEXR.File([depth, OpenEXR.Part({}, planes, "colour")]).write(str(path))
    planes = {"G": np.ascontiguousarray(small[..., 1], np.float32)}
    path = case("green_only.exr", code="environment.exr_channels")
    OpenEXR.File({"type": OpenEXR.scanlineimage, "compression": OpenEXR.PIZ_COMPRESSION}, planes).write(
        str(path)
    )
    ball = np.pad(mirror_ball(PROBE - 8), ((4, 4), (4, 4), (0, 0)))
    case("ball_with_margin.hdr", hdr(ball), code="environment.layout_unclear")
    case("subsampled.exr", subsampled(small), code="environment.exr_channels")
    lit = np.where(cross_horizontal(SIDE) > 0.0, cross_horizontal(SIDE), latlong(3 * SIDE, 4 * SIDE))
    case("lit_cross.hdr", hdr(lit), code="environment.layout_unclear")
    case("lit_square.hdr", hdr(latlong(PROBE, PROBE)), code="environment.layout_unclear")
    case("wide.hdr", hdr(latlong(8, 40)), code="environment.shape")
    case("not_six.hdr", hdr(latlong(8, 40)), given="strip-horizontal", code="environment.shape")
    flat_primaries = _primaries((0.3,) * 8)
    case("no_primaries.hdr", hdr(small, header=flat_primaries), code="environment.hdr_damaged")
    bad = (0.3,) * 8
    _exr(case("no_primaries.exr", code="environment.exr_primaries"), small, chromaticities=bad)
    return cases


def index(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the cases with directions and the radiance from there."""
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return {
        "cases": cases,
        "directions": np.round(directions, 6).tolist(),
        "radiance": np.round(radiance(np.round(directions, 6)), 6).tolist(),
    }


def lines_of(data: dict[str, Any]) -> Iterator[str]:
    """Yield the index as text with a case a line."""
    yield '{\n "cases": [\n  ' + ",\n  ".join(json.dumps(case) for case in data["cases"]) + "\n ],\n"
    yield f' "directions": {json.dumps(data["directions"])},\n'
    yield f' "radiance": {json.dumps(data["radiance"])}\n}}\n'


if __name__ == "__main__":
    text = "".join(lines_of(index(write_all(FOLDER))))
    (FOLDER / "index.json").write_text(text, encoding="utf-8")

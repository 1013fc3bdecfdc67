"""Layouts of environment maps and their conversion to latitude-longitude.

Whatever is ahead (the middle of a probe, the face under the top of a cross) ends up in the middle of the
map, which is +x; up is +z. Faces have the order and orientation of OpenGL's cube maps, OpenEXR's `envmap`
cubes those of its ImfEnvmap.h. Position (s, t) in a face is in [-1, 1], s to the right and t downwards; a
face shows the direction ahead + s right + t down. Source: docs/reference/conventions.md (layouts).
"""

import math
from dataclasses import dataclass

import numpy as np
from lambent_core.directions import Array
from lambent_core.errors import EnvironmentFileError
from numpy.typing import NDArray

LATLONG, AUTO = "latlong", "auto"
LAYOUTS = {
    LATLONG: "a latitude-longitude map",
    "angular": "an angular map (light probe)",
    "mirror-ball": "a mirror ball",
    "cross-horizontal": "a horizontal cross of cube faces",
    "cross-vertical": "a vertical cross of cube faces",
    "strip-horizontal": "a horizontal strip of cube faces",
    "strip-vertical": "a vertical strip of cube faces",
    "cube": "an OpenEXR cube",
}
"""Layouts by name, in words."""
CHOICES = (AUTO, *LAYOUTS)
"""What may be given as a layout."""
MAX_WIDTH = 8192
"""Widest result of a conversion, pixels."""
_SUBSAMPLES = 3
_DARK = 0.01
"""Share of the mean radiance up to which the unused parts of a picture count as empty."""
_RIM = (0.95, 0.98)
"""Distances from the middle of a probe between which at least something must be lit."""
_ROWS_AT_ONCE = 32

_X, _Y, _Z = np.eye(3)
# Ahead, right and down of +X, -X, +Y, -Y, +Z, -Z. OpenGL's (x, y, z) is our (z, -x, y): its faces are seen
# from inside with x to the right, y up and z ahead.
_OPENGL = (
    (-_Y, -_X, -_Z),
    (_Y, _X, -_Z),
    (_Z, -_Y, _X),
    (-_Z, -_Y, -_X),
    (_X, -_Y, -_Z),
    (-_X, _Y, -_Z),
)
# OpenEXR's (x, y, z) is our (z, x, y): the middle of its latitude-longitude maps is +z.
_OPENEXR = (
    (_Y, _X, -_Z),
    (-_Y, -_X, -_Z),
    (_Z, _Y, -_X),
    (-_Z, _Y, _X),
    (_X, -_Y, -_Z),
    (-_X, _Y, -_Z),
)
# Column and row of each face, and whether it is upside down.
_CELLS = {
    "cross-horizontal": ((2, 1, 0), (0, 1, 0), (1, 0, 0), (1, 2, 0), (1, 1, 0), (3, 1, 0)),
    "cross-vertical": ((2, 1, 0), (0, 1, 0), (1, 0, 0), (1, 2, 0), (1, 1, 0), (1, 3, 1)),
    "strip-horizontal": tuple((at, 0, 0) for at in range(6)),
    "strip-vertical": tuple((0, at, 0) for at in range(6)),
    "cube": tuple((0, at, 0) for at in range(6)),
}
_GRIDS = {
    "cross-horizontal": (4, 3),
    "cross-vertical": (3, 4),
    "strip-horizontal": (6, 1),
    "strip-vertical": (1, 6),
    "cube": (1, 6),
    "angular": (1, 1),
    "mirror-ball": (1, 1),
}


def layout_of_size(height: int, width: int) -> str:
    """Return the layout that pictures of this size have, or "" where there is none.

    Twice as wide as high, within 2 %, is latitude-longitude, as is a single pixel; other squares are angular
    maps.
    """
    if abs(width - 2 * height) <= max(1.0, 0.02 * width) or height == width == 1:
        return LATLONG
    names = ("angular", "cross-horizontal", "cross-vertical", "strip-horizontal", "strip-vertical")
    return next((name for name in names if _fits(name, height, width)), "")


def decided_layout(name: str, height: int, width: int, stated: str | None, given: str = AUTO) -> str:
    """Return the layout of the file `name`: the `given` one, else the `stated` one, else that of its size.

    Raises EnvironmentFileError for an unknown layout and for a size that it, or none, can have.
    """
    if given not in CHOICES:
        raise EnvironmentFileError(
            "environment.unknown_layout", f"layout {given!r}", f"use one of {', '.join(CHOICES)}"
        )
    layout = given if given != AUTO else stated or layout_of_size(height, width)
    if layout == LATLONG or (layout and _fits(layout, height, width)):
        return layout
    reason = f"which {LAYOUTS[layout]} cannot have" if layout else "which no layout has"
    raise EnvironmentFileError(
        "environment.shape",
        f'"{name}" has {width} x {height} pixels, {reason}; expected twice as wide as high '
        "(latitude-longitude), 4:3 or 3:4 (cross), 6:1 or 1:6 (strip) or a square (light probe)",
        "crop or convert the map, or name its layout: --env-layout (latlong takes any size)",
    )


def blank_unused(name: str, image: NDArray[np.float32], layout: str, *, certain: bool) -> NDArray[np.float32]:
    """Return the picture with black where the layout has no light: outside the disc or in a cross's corners.

    Unless the layout is `certain`, raises EnvironmentFileError where such a part is neither dark nor of one
    colour, or where a probe is black all around its rim, because then the picture is something else.
    """
    if layout == "angular" and not certain and _is_black_at_its_rim(image):
        raise _unclear(name, layout, "is black all around the rim, which shows what is behind")
    unused = _unused(layout, *image.shape[:2])
    if not unused.any():
        return image
    outside, inside = image[unused], image[~unused]
    dark = _mean_size(outside) <= _DARK * _mean_size(inside)
    plain = np.isfinite(outside).all() and (outside == outside[0]).all()
    # One colour outside is a margin only where the rest has more than that colour.
    if not certain and not dark and not (plain and (inside != outside[0]).any()):
        part = "outside the disc" if layout == "angular" else "in the corners that a cross leaves empty"
        raise _unclear(name, layout, f"has light {part}")
    return np.where(unused[..., None], np.float32(0.0), image)


def to_latlong(image: NDArray[np.float32], layout: str, *, max_width: int = MAX_WIDTH) -> NDArray[np.float32]:
    """Return a latitude-longitude map [W / 2, W, 3] of a picture in another layout.

    A pixel is the mean of 3 x 3 interpolated values, evenly spread in its solid angle. W is four times the
    side of a face, twice that of a probe, at most `max_width`.
    """
    if layout == LATLONG:
        return image
    if layout in ("angular", "mirror-ball"):
        source: _Cube | _Probe = _Probe(image, layout == "mirror-ball")
        width = min(2 * image.shape[0], max_width)
    else:
        source = _cube_of(image, layout)
        width = min(4 * (image.shape[1] // _GRIDS[layout][0]), max_width)
    height = width // 2
    result = np.empty((height, width, 3), np.float32)
    across = (np.arange(width * _SUBSAMPLES) + 0.5) / (width * _SUBSAMPLES)
    azimuth = math.pi - 2.0 * math.pi * across
    edges = np.cos(math.pi * np.arange(height + 1) / height)
    inside = (np.arange(_SUBSAMPLES) + 0.5) / _SUBSAMPLES
    for row in range(0, height, _ROWS_AT_ONCE):
        top, bottom = edges[:-1][row : row + _ROWS_AT_ONCE], edges[1:][row : row + _ROWS_AT_ONCE]
        up = (top[:, None] + (bottom - top)[:, None] * inside).ravel()[:, None]
        level = np.sqrt(np.maximum(1.0 - up * up, 0.0))
        parts = (
            level * np.cos(azimuth),
            level * np.sin(azimuth),
            np.broadcast_to(up, (len(up), len(across))),
        )
        radiance = source.lookup(np.stack(parts, axis=-1))
        result[row : row + len(top)] = radiance.reshape(len(top), _SUBSAMPLES, width, _SUBSAMPLES, 3).mean(
            axis=(1, 3)
        )
    return result


def _unclear(name: str, layout: str, but: str) -> EnvironmentFileError:
    return EnvironmentFileError(
        "environment.layout_unclear",
        f'"{name}" has the size of {LAYOUTS[layout]}, but {but}',
        f"name its layout ({', '.join(LAYOUTS)}): --env-layout, or convert it to latitude-longitude; "
        "octahedral maps and single faces are not read",
    )


def _is_black_at_its_rim(image: NDArray[np.float32]) -> bool:
    """Return whether a lit disc has no light at all in a ring near its edge, as a ball with a margin."""
    radius = _radii(image.shape[0])
    rim = (radius > _RIM[0]) & (radius < _RIM[1])
    lit = (image != 0.0).any(axis=-1)
    return bool(rim.any() and not lit[rim].any() and lit[radius <= _RIM[0]].any())


def _radii(side: int) -> NDArray[np.float64]:
    """Return the distance of pixels from the middle of a square, 1 at the edge."""
    place = (np.arange(side) + 0.5) * (2.0 / side) - 1.0
    return np.hypot(place[:, None], place)


def _fits(layout: str, height: int, width: int) -> bool:
    columns, rows = _GRIDS[layout]
    return width * rows == height * columns and width % columns == 0


def _unused(layout: str, height: int, width: int) -> NDArray[np.bool_]:
    """Return which pixels [height, width] show no direction."""
    if layout in ("angular", "mirror-ball"):
        # Edges are soft in pictures: two pixels around the disc may be lit.
        return _radii(height) > 1.0 + 4.0 / height
    unused = np.zeros((height, width), np.bool_)
    if layout.startswith("cross"):
        side = width // _GRIDS[layout][0]
        unused[:] = True
        for column, row, _ in _CELLS[layout]:
            unused[row * side : (row + 1) * side, column * side : (column + 1) * side] = False
    return unused


def _mean_size(values: NDArray[np.float32]) -> float:
    return float(np.where(np.isfinite(values), np.abs(values), 0.0).mean(dtype=np.float64))


def _bilinear(
    image: NDArray[np.float32], column: Array, row: Array, offset: Array | int
) -> NDArray[np.float32]:
    """Return interpolated pixels of pictures [picture, height, width, 3], held at their edges."""
    _, height, width, _ = image.shape
    column, row = np.clip(column, 0.0, width - 1.0), np.clip(row, 0.0, height - 1.0)
    left, top = column.astype(np.int64), row.astype(np.int64)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    x, y = (column - left).astype(np.float32)[..., None], (row - top).astype(np.float32)[..., None]
    flat, upper, lower = (
        image.reshape(-1, 3),
        (offset * height + top) * width,
        (offset * height + bottom) * width,
    )
    above = flat[upper + left] * (1 - x) + flat[upper + right] * x
    below = flat[lower + left] * (1 - x) + flat[lower + right] * x
    return above * (1 - y) + below * y


@dataclass(frozen=True)
class _Cube:
    faces: NDArray[np.float32]
    """+X, -X, +Y, -Y, +Z, -Z: [6, side, side, 3]."""
    axes: NDArray[np.float64]
    """Ahead, right and down of each face, [6, 3, 3]."""
    scale: float
    """Pixels from the middle of a face to its edge."""

    def lookup(self, directions: Array) -> NDArray[np.float32]:
        """Return the radiance from `directions` [*batch, 3], interpolated within faces."""
        face = np.argmax(directions @ self.axes[:, 0].T, axis=-1)
        ahead, right, down = (
            np.einsum("...i,...i->...", directions, self.axes[face, axis]) for axis in range(3)
        )
        middle = 0.5 * (self.faces.shape[1] - 1)
        column, row = middle + self.scale * right / ahead, middle + self.scale * down / ahead
        return _bilinear(self.faces, column, row, face)


def _cube_of(image: NDArray[np.float32], layout: str) -> _Cube:
    side = image.shape[1] // _GRIDS[layout][0]
    cells = []
    for column, row, upside_down in _CELLS[layout]:
        cell = image[row * side : (row + 1) * side, column * side : (column + 1) * side]
        cells.append(cell[::-1, ::-1] if upside_down else cell)
    faces = np.ascontiguousarray(np.stack(cells))
    if layout == "cube":
        # The outermost pixels of OpenEXR's faces lie on the edges of the cube.
        return _Cube(faces, np.array(_OPENEXR), 0.5 * (side - 1))
    # A frame of the neighbours' pixels, so that there are no seams between faces.
    plain = _Cube(faces, np.array(_OPENGL), 0.5 * side)
    place = (np.arange(side + 2) - 0.5) * (2.0 / side) - 1.0
    framed = np.empty((6, side + 2, side + 2, 3), np.float32)
    framed[:, 1:-1, 1:-1] = faces
    for face, (ahead, right, down) in enumerate(_OPENGL):
        for frame in (np.s_[0, :], np.s_[-1, :], np.s_[:, 0], np.s_[:, -1]):
            t, s = (grid[frame][..., None] for grid in np.meshgrid(place, place, indexing="ij"))
            framed[face][frame] = plain.lookup(ahead + s * right + t * down)
    return _Cube(framed, np.array(_OPENGL), 0.5 * side)


@dataclass(frozen=True)
class _Probe:
    image: NDArray[np.float32]
    mirrored: bool
    """Whether it shows a mirror ball, whose right side reflects the left of what is ahead."""

    def lookup(self, directions: Array) -> NDArray[np.float32]:
        """Return the radiance from unit `directions` [*batch, 3], interpolated in the disc."""
        side = self.image.shape[0]
        ahead, left, up = directions[..., 0], directions[..., 1], directions[..., 2]
        level = np.hypot(left, up)
        if self.mirrored:
            # The normal is half way between the eye (+x, far away) and the reflected direction.
            radius = np.sqrt(np.maximum(0.5 * (1.0 - ahead), 0.0))
        else:
            radius = np.arctan2(level, ahead) / math.pi
        # What is behind is the whole rim: pixels that the rim crosses are only partly covered.
        radius = np.minimum(radius, max(1.0 - 3.0 / side, 0.0)) / np.maximum(level, 1e-12)
        right = left if self.mirrored else -left
        middle = 0.5 * (side - 1)
        column, row = middle + 0.5 * side * radius * right, middle - 0.5 * side * radius * up
        return _bilinear(self.image[None], column, row, 0)

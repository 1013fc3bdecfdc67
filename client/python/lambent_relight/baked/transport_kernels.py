"""Compiled loops over many directions and points, for baking transport and for shading what it shows.

They release the interpreter lock and write only their outputs. Spherical harmonics are those of
`lambent_relight.environment.harmonics`, in single precision.
"""

import math
from functools import cache

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray


@cache
def recurrence(bands: int) -> NDArray[np.float32]:
    """Return the factors of the recurrence in `harmonics.legendre`: diagonal, two per degree and order."""
    table = np.zeros((3, bands, bands), np.float32)
    diagonal = math.sqrt(0.25 / math.pi)
    for m in range(bands):
        if m > 0:
            diagonal *= math.sqrt((2 * m + 1) / (2 * m))
        table[0, m, m] = diagonal * (math.sqrt(2.0) if m else 1.0)
        for degree in range(m + 1, bands):
            scale = math.sqrt((4 * degree**2 - 1) / (degree**2 - m**2))
            table[1, degree, m] = scale
            before = ((degree - 1) ** 2 - m**2) / (4 * (degree - 1) ** 2 - 1)
            table[2, degree, m] = scale * math.sqrt(max(before, 0.0))
    return table


@inlined()
def basis_at(x, y, z, table, out):
    """Write the basis at one unit direction to `out` [bands^2]."""
    bands = table.shape[1]
    cosine, sine = np.float32(1.0), np.float32(0.0)
    for m in range(bands):
        before, value = np.float32(0.0), table[0, m, m]
        for degree in range(m, bands):
            if degree > m:
                value, before = table[1, degree, m] * z * value - table[2, degree, m] * before, value
            centre = degree * (degree + 1)
            out[centre + m] = value * cosine
            if m > 0:
                out[centre - m] = value * sine
        cosine, sine = cosine * x - sine * y, cosine * y + sine * x


@compiled()
def _basis_rows(directions, table, out):
    for row in range(directions.shape[0]):
        basis_at(directions[row, 0], directions[row, 1], directions[row, 2], table, out[row])


def basis_rows(directions: NDArray[np.floating], bands: int) -> NDArray[np.float32]:
    """Return the basis at unit directions [n, 3], as [n, bands^2]; `harmonics.basis`, faster."""
    out = np.empty((len(directions), bands**2), np.float32)
    _basis_rows(np.ascontiguousarray(directions, np.float32), recurrence(bands), out)
    return out


@compiled()
def _mirrored_sums(opacity, normals, directions, least, scale, table, out):
    values = np.empty(out.shape[1], np.float32)
    for t in range(opacity.shape[0]):
        nx, ny, nz = normals[t, 0], normals[t, 1], normals[t, 2]
        for j in range(opacity.shape[1]):
            if opacity[t, j] <= least:
                continue
            x, y, z = directions[j, 0], directions[j, 1], directions[j, 2]
            twice = np.float32(2.0) * (x * nx + y * ny + z * nz)
            basis_at(x - twice * nx, y - twice * ny, z - twice * nz, table, values)
            weight = scale * np.float32(opacity[t, j])
            for k in range(out.shape[1]):
                out[t, k] += weight * values[k]


def mirrored_sums(
    opacity: NDArray[np.uint8],
    normals: NDArray[np.float32],
    directions: NDArray[np.float32],
    bands: int,
    *,
    least: int,
    scale: float,
) -> NDArray[np.float32]:
    """Return sum over j of scale opacity[t, j] Y(direction j mirrored below the horizon), [texel, bands^2].

    Opacities up to `least` are left out.
    """
    out = np.zeros((len(opacity), bands**2), np.float32)
    arguments = (opacity, np.ascontiguousarray(normals, np.float32), directions)
    _mirrored_sums(*arguments, least, np.float32(scale), recurrence(bands), out)
    return out


class NearestPoint:
    """Finds a nearest point among many on a surface: exact near the surface, approximate far from it."""

    def __init__(self, points: NDArray[np.floating]) -> None:
        """Sort `points` [point, 3] into cubic cells; there must be one at least."""
        points = np.ascontiguousarray(points, np.float32)
        self._low = points.min(axis=0)
        extent = np.maximum(points.max(axis=0) - self._low, 1e-6)
        # About as many cells along a side as give a surface's points two or three to a cell.
        count = np.clip(np.sqrt(len(points) / 6.0), 1.0, 96.0)
        self._cell = np.float32(extent.max() / count)
        # A rim of empty cells, so that neighbours need no check.
        self._low = self._low - self._cell
        self._shape = (extent / self._cell).astype(np.int64) + 3
        place = np.minimum(((points - self._low) / self._cell).astype(np.int64), self._shape - 2)
        number = (place[:, 0] * self._shape[1] + place[:, 1]) * self._shape[2] + place[:, 2]
        self._order = np.argsort(number, kind="stable").astype(np.int32)
        self._points = points[self._order]
        counts = np.bincount(number, minlength=int(np.prod(self._shape)))
        self._first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self._home = np.full(len(counts), -1, np.int32)
        occupied = np.flatnonzero(counts).astype(np.int32)
        self._home[occupied] = occupied
        _spread_cells(self._home, self._shape, occupied)

    def __call__(self, queries: NDArray[np.floating]) -> NDArray[np.int32]:
        """Return the index of a point near each of `queries` [n, 3].

        It is the nearest one if that is less than a cell away; else it may be two cells further than it.
        """
        out = np.empty(len(queries), np.int32)
        places = np.ascontiguousarray(queries, np.float32)
        _nearest(places, self._points, self._first, self._home, self._shape, self._low, self._cell, out)
        return self._order[out]


@compiled()
def _spread_cells(home, shape, occupied):
    """Give every cell the nearest occupied one, by flooding outwards from those."""
    size_y, size_z = shape[1], shape[2]
    queue = np.empty(home.shape[0], np.int32)
    queue[: occupied.shape[0]] = occupied
    end = occupied.shape[0]
    place = 0
    while place < end:
        number = queue[place]
        place += 1
        i, j, k = number // (size_y * size_z), (number // size_z) % size_y, number % size_z
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    a, b, c = i + di, j + dj, k + dk
                    if a < 0 or b < 0 or c < 0 or a >= shape[0] or b >= size_y or c >= size_z:
                        continue
                    other = (a * size_y + b) * size_z + c
                    if home[other] < 0:
                        home[other] = home[number]
                        queue[end] = other
                        end += 1


@compiled()
def _nearest(queries, points, first, home, shape, low, cell, out):
    size_y, size_z = shape[1], shape[2]
    for q in range(queries.shape[0]):
        x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
        i = min(max(math.floor((x - low[0]) / cell), 1), shape[0] - 2)
        j = min(max(math.floor((y - low[1]) / cell), 1), shape[1] - 2)
        k = min(max(math.floor((z - low[2]) / cell), 1), shape[2] - 2)
        best, nearest = np.float32(np.inf), -1
        # First around the query, then, where nothing is, around the nearest occupied cell.
        for attempt in range(2):
            if attempt == 1:
                if nearest >= 0:
                    break
                number = home[(i * size_y + j) * size_z + k]
                i, j, k = number // (size_y * size_z), (number // size_z) % size_y, number % size_z
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    row = (a * size_y + b) * size_z
                    for p in range(first[row + k - 1], first[row + k + 2]):
                        dx, dy, dz = points[p, 0] - x, points[p, 1] - y, points[p, 2] - z
                        distance = dx * dx + dy * dy + dz * dz
                        if distance < best:
                            best, nearest = distance, p
        out[q] = nearest

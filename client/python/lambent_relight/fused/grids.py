"""Feature grids as compiled code reads them, a block of points at a time.

Points lie as [3, STRIDE] and features as [feature, STRIDE]; the first BLOCK columns are points. Most levels
are dense or have a power of two of rows: there, all voxels of a block are found before any is read, which
vectorises, and the number of features is a constant of the code. Source: docs/reference/bundle-format.md
(feature grids).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from lambent_compute.compiling import inlined
from lambent_compute.tiles import COLUMNS as BLOCK
from numpy.typing import NDArray

from lambent_relight.bundle.graphs import Rows


class Grid(NamedTuple):
    """A multi-resolution feature grid; one without levels has no features."""

    table: Rows
    """[row, features], read-only."""
    levels: NDArray[np.int64]
    """Resolution, first row, number of rows, multipliers of y and z, [level, 5]."""
    half_extent: float

    @classmethod
    def empty(cls) -> "Grid":
        """Return a grid without features."""
        table = np.zeros((1, 1), np.float32)
        table.flags.writeable = False
        return cls(table, np.zeros((0, 5), np.int64), 1.0)

    @property
    def num_outputs(self) -> int:
        """Features of a point."""
        return len(self.levels) * self.table.shape[1]


@inlined()
def _mix(table, f, rows, fu, fv, fw):
    """Return feature `f` between eight rows of `table`, z slowest, at the place (fu, fv, fw) in the voxel."""
    a0, a1, a2, a3, b0, b1, b2, b3 = rows
    x00 = table[a0, f] + fu * (table[a1, f] - table[a0, f])
    x10 = table[a2, f] + fu * (table[a3, f] - table[a2, f])
    x01 = table[b0, f] + fu * (table[b1, f] - table[b0, f])
    x11 = table[b2, f] + fu * (table[b3, f] - table[b2, f])
    y0, y1 = x00 + fv * (x10 - x00), x01 + fv * (x11 - x01)
    return y0 + fw * (y1 - y0)


def _interpolation(num_features: int) -> Callable[..., None]:
    """Return the compiled interpolation of so many features, a constant of the code.

    It reads rows of `table` [row, features] at an index modulo 2^32, of which `mask` leaves the lower bits.
    """

    @inlined()
    def interpolate(table, mask, multiplier_y, multiplier_z, corner, inside, count, out):
        one, by, bz = np.uint32(1), np.uint32(multiplier_y), np.uint32(multiplier_z)
        for r in range(count):
            a, fu, fv, fw = corner[r], inside[0, r], inside[1, r], inside[2, r]
            b = np.uint32(a + bz)
            a0, a1 = a & mask, np.uint32(a + one) & mask
            a2, a3 = np.uint32(a + by) & mask, np.uint32(a + by + one) & mask
            b0, b1 = b & mask, np.uint32(b + one) & mask
            b2, b3 = np.uint32(b + by) & mask, np.uint32(b + by + one) & mask
            for f in range(num_features):
                out[f, r] = _mix(table, f, (a0, a1, a2, a3, b0, b1, b2, b3), fu, fv, fw)

    return interpolate


_interpolate_one, _interpolate_two, _interpolate_four = (_interpolation(count) for count in (1, 2, 4))


@inlined()
def _voxels(points, n, scale, multiplier_y, multiplier_z, corner, inside):
    """Write each point's voxel corner, its index modulo 2^32, and the place in the voxel [3, BLOCK]."""
    zero, last = np.float32(0.0), np.float32(n - 1)
    shift, most = np.float32(0.5 * (n - 1)), np.int32(n - 2)
    by, bz = np.uint32(multiplier_y), np.uint32(multiplier_z)
    for r in range(BLOCK):
        u = points[0, r] * scale + shift
        v = points[1, r] * scale + shift
        w = points[2, r] * scale + shift
        # Written so that what is not a number becomes zero: it must not become an address.
        u, v, w = u if u > zero else zero, v if v > zero else zero, w if w > zero else zero
        u, v, w = min(u, last), min(v, last), min(w, last)
        i, j, k = min(np.int32(u), most), min(np.int32(v), most), min(np.int32(w), most)
        inside[0, r] = u - np.float32(i)
        inside[1, r] = v - np.float32(j)
        inside[2, r] = w - np.float32(k)
        corner[r] = np.uint32(np.uint32(i) + by * np.uint32(j) + bz * np.uint32(k))


@inlined()
def _row_of(index, num_rows):
    """Return `index` mod `num_rows`; a division is avoided where it can be, which is nearly everywhere."""
    if index < num_rows:
        return index
    if num_rows & (num_rows - 1) == 0:
        return index & (num_rows - 1)
    return index % num_rows


@inlined()
def any_level(points, count, table, n, scale, multiplier_y, multiplier_z, out):
    """Write the features of any level, whose rows are `table`, to `out` [features, STRIDE]."""
    num_rows, num_features = table.shape
    by, bz = multiplier_y, multiplier_z
    zero, last, shift = np.float32(0.0), np.float32(n - 1), np.float32(0.5 * (n - 1))
    for r in range(count):
        u = points[0, r] * scale + shift
        v = points[1, r] * scale + shift
        w = points[2, r] * scale + shift
        # Written so that what is not a number becomes zero: it must not become an address.
        u, v, w = u if u > zero else zero, v if v > zero else zero, w if w > zero else zero
        u, v, w = min(u, last), min(v, last), min(w, last)
        i, j, k = min(int(u), n - 2), min(int(v), n - 2), min(int(w), n - 2)
        fu, fv, fw = u - np.float32(i), v - np.float32(j), w - np.float32(k)
        a = i + by * j + bz * k
        b = a + bz
        a0, a1 = _row_of(a, num_rows), _row_of(a + 1, num_rows)
        a2, a3 = _row_of(a + by, num_rows), _row_of(a + by + 1, num_rows)
        b0, b1 = _row_of(b, num_rows), _row_of(b + 1, num_rows)
        b2, b3 = _row_of(b + by, num_rows), _row_of(b + by + 1, num_rows)
        for f in range(num_features):
            out[f, r] = _mix(table, f, (a0, a1, a2, a3, b0, b1, b2, b3), fu, fv, fw)


@inlined()
def encode(grid, points, count, out):
    """Write trilinear features of `points` [3, STRIDE] to `out` [levels * features, STRIDE].

    Features are written for the first `count` points.
    """
    num_features = grid.table.shape[1]
    corner, inside = np.empty(BLOCK, np.uint32), np.empty((3, BLOCK), np.float32)
    for level in range(len(grid.levels)):
        n, first, rows, by, bz = grid.levels[level]
        # The factor is rounded once, as in the ONNX graph, or points on a voxel border would part ways.
        scale = np.float32(n / (2.0 * grid.half_extent))
        table, target = grid.table[first : first + rows], out[level * num_features :]
        dense = by >= 0 and bz >= 0 and max(by, bz) <= rows and (n - 1) * (1 + by + bz) < rows
        power = rows & (rows - 1) == 0 and rows <= 1 << 31
        if not (dense or power) or num_features not in (1, 2, 4):
            any_level(points, count, table, n, scale, by, bz, target)
            continue
        mask = np.uint32(rows - 1) if power else np.uint32(0xFFFFFFFF)
        _voxels(points, n, scale, by, bz, corner, inside)
        if num_features == 1:
            _interpolate_one(table, mask, by, bz, corner, inside, count, target)
        elif num_features == 2:
            _interpolate_two(table, mask, by, bz, corner, inside, count, target)
        else:
            _interpolate_four(table, mask, by, bz, corner, inside, count, target)

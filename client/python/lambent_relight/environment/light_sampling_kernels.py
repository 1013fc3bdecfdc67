"""Compiled loops of `light_sampling`: directions from a sampling table, and their density.

Both find the row of an axis in the same way, bit for bit, or the density would not be that of the directions.
"""

import math
from typing import NamedTuple

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray

AXES_SIDE = 16
"""Bins along each side of the octahedral map of axes."""


class Table(NamedTuple):
    """A sampling table; rows are lobes about axes, columns are cells of the map."""

    pmf: NDArray[np.float32]
    """Probability of every cell, [row, cell]."""
    cell_ends: NDArray[np.float64]
    """Cumulative probability, row r between r and r + 1, [row * cell]."""
    cells: NDArray[np.int64]
    """First and last place of a cell's pixels in `ends` and `order`, [cell, 2]."""
    ends: NDArray[np.float64]
    """Cumulative mass of the pixels, cell after cell."""
    order: NDArray[np.int64]
    """Numbers of the pixels, cell after cell."""
    cell_of_pixel: NDArray[np.int64]
    inside: NDArray[np.float64]
    """Density of a pixel's directions inside its cell, 1/sr, [pixel]."""
    means: NDArray[np.float64]
    """Mean of the map under the lobe of a row, 1/sr: radiance over the map's integral, [row]."""
    height: int
    width: int
    angle: float
    """By which the map is turned about +z, radians."""


@inlined(fastmath=False)
def row_of(table, lobe, x, y, z):
    """Return the row for a lobe about the unit axis (x, y, z): bins of an octahedral map of 16 x 16."""
    cosine, sine = math.cos(table.angle), math.sin(table.angle)
    x, y = cosine * x + sine * y, cosine * y - sine * x
    size = max(abs(x) + abs(y) + abs(z), 1e-20)
    px, py = x / size, y / size
    if z < 0.0:
        folded = (1.0 - abs(py)) * (-1.0 if px < 0.0 else 1.0)
        py = (1.0 - abs(px)) * (-1.0 if py < 0.0 else 1.0)
        px = folded
    column = min(max(int((px + 1.0) * (AXES_SIDE / 2)), 0), AXES_SIDE - 1)
    row = min(max(int((py + 1.0) * (AXES_SIDE / 2)), 0), AXES_SIDE - 1)
    return (lobe * AXES_SIDE + row) * AXES_SIDE + column


@inlined(fastmath=False)
def _first_above(values, start, end, wanted):
    """Return the first place from `start` to `end` whose value is above `wanted`, or `end`."""
    while start < end:
        middle = (start + end) // 2
        if values[middle] > wanted:
            end = middle
        else:
            start = middle + 1
    return start


@inlined(fastmath=False)
def direction_in(table, row, u1, u2):
    """Return a direction (x, y, z) of a row, from uniforms in [0, 1)."""
    num_cells = table.pmf.shape[1]
    begin = row * num_cells
    cell = min(_first_above(table.cell_ends, begin, begin + num_cells, row + u1) - begin, num_cells - 1)
    mass = np.float64(table.pmf[row, cell])
    inside_cell = (row + u1 - (table.cell_ends[begin + cell] - mass)) / max(mass, 1e-30)
    inside_cell = min(max(inside_cell, 0.0), 1.0)

    first, last, ends = table.cells[cell, 0], table.cells[cell, 1], table.ends
    start = ends[first - 1] if first > 0 else 0.0
    target = start + u2 * (ends[last] - start)
    place = min(_first_above(ends, first, last + 1, target), last)
    before = ends[place - 1] if place > 0 else 0.0
    inside_pixel = min(max((target - before) / max(ends[place] - before, 1e-300), 0.0), 1.0)

    pixel_row, pixel_column = table.order[place] // table.width, table.order[place] % table.width
    top = math.cos(math.pi * pixel_row / table.height)
    bottom = math.cos(math.pi * (pixel_row + 1) / table.height)
    z = top + (bottom - top) * inside_cell
    azimuth = table.angle + math.pi - (2.0 * math.pi / table.width) * (pixel_column + inside_pixel)
    radius = math.sqrt(max(1.0 - z * z, 0.0))
    return radius * math.cos(azimuth), radius * math.sin(azimuth), z


@inlined(fastmath=False)
def pixel_at(table, x, y, z):
    """Return the number of the pixel that the unit direction (x, y, z) points at."""
    u = 0.5 - (math.atan2(y, x) - table.angle) / (2.0 * math.pi)
    u -= math.floor(u)
    v = math.atan2(math.sqrt(x * x + y * y), z) / math.pi
    row = min(max(int(v * table.height), 0), table.height - 1)
    return row * table.width + int(u * table.width) % table.width


@inlined(fastmath=False)
def density_in(table, row, pixel):
    """Return the density of `direction_in` at the directions of a pixel, 1/sr."""
    return table.pmf[row, table.cell_of_pixel[pixel]] * table.inside[pixel]


@compiled(fastmath=False)
def sample(table, u1, u2, axes, lobes, out):
    """Write directions for lobes [n] about `axes` [n, 3] to `out` [n, 3], from uniforms [n]."""
    for n in range(len(axes)):
        row = row_of(table, lobes[n], axes[n, 0], axes[n, 1], axes[n, 2])
        out[n, 0], out[n, 1], out[n, 2] = direction_in(table, row, u1[n], u2[n])


@compiled(fastmath=False)
def means(table, axes, lobes, out):
    """Write the means of the map under lobes [n] about `axes` [n, 3] to `out` [n]."""
    for n in range(len(axes)):
        out[n] = table.means[row_of(table, lobes[n], axes[n, 0], axes[n, 1], axes[n, 2])]


@compiled(fastmath=False)
def densities(table, directions, axes, lobes, out):
    """Write the densities of `directions` [n, 3] for lobes [n] about `axes` [n, 3] to `out` [n, 1]."""
    for n in range(len(directions)):
        row = row_of(table, lobes[n], axes[n, 0], axes[n, 1], axes[n, 2])
        pixel = pixel_at(table, directions[n, 0], directions[n, 1], directions[n, 2])
        out[n, 0] = density_in(table, row, pixel)

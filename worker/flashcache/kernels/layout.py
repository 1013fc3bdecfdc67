"""The layout of a multi-resolution feature grid: the row of each voxel in the grid's table.

One table of rows holds all levels after each other. A voxel (x, y, z) of a level is row
`first_row + (x + multiplier_y y + multiplier_z z) mod num_rows`. A level with n^3 <= T voxels is dense
(multipliers n and n^2, no two voxels share a row), a finer one is hashed into T rows.

The voxels that share a row with voxel 0 form a lattice; the multipliers are chosen so that its shortest
vector is as long as possible, so colliding voxels are as far from each other as T rows allow. Unlike the
exclusive-or hash of instant NGP the formula needs neither integer overflow nor bit operations, which some
runtimes lack.

A point z in the cube [-b, b]^3 is looked up in a level of resolution n as follows, per axis:

    u    = clamp(z n / (2 b) + (n - 1) / 2, 0, n - 1)     voxel centres are at integer u
    cell = min(floor(u), n - 2)
    f    = u - cell                                        in [0, 1]

so voxel 0 is centred half a voxel inside the cube. The feature is the trilinear interpolation, by f, of the 8
voxels cell + {0, 1}^3. Its derivative by z is that of the formula: n / (2 b) times the difference along the
axis where 0 <= u <= n - 1 holds before clamping, and zero beyond.
"""

import math
from dataclasses import dataclass
from typing import Final

from flashcache.errors import ConfigError

MAX_COORDINATE: Final = 2048
"""Largest voxel coordinate: 2048 (1 + (T - 1) + (T - 1)) stays below 2**31 for T up to 2**19."""

MULTIPLIERS: Final[dict[int, tuple[int, int]]] = {
    12: (1099, 1191),
    13: (1162, 4744),
    14: (6024, 4829),
    15: (25950, 9244),
    16: (37642, 4945),
    17: (53974, 15840),
    18: (177852, 190581),
    19: (5468, 133766),
}
"""log2(T) -> (b, c), found by `search` (benchmarks/lattice_search.py in revision 41a0d66)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GridLevel:
    """One resolution of a grid; all numbers are counts or row numbers."""

    resolution: int
    first_row: int
    num_rows: int
    multiplier_y: int
    multiplier_z: int


@dataclass(frozen=True, kw_only=True, slots=True)
class GridLayout:
    """The levels of a grid, coarse to fine, over the cube [-half_extent, half_extent]^3."""

    levels: tuple[GridLevel, ...]
    num_features: int
    half_extent: float

    @property
    def num_rows(self) -> int:
        """Rows of the whole table."""
        return self.levels[-1].first_row + self.levels[-1].num_rows

    @property
    def num_outputs(self) -> int:
        """Features of a point: all levels, coarse to fine, after each other."""
        return len(self.levels) * self.num_features


def level_resolutions(base: int, finest: int, num_levels: int) -> tuple[int, ...]:
    """Return `num_levels` resolutions, spaced geometrically from `base` to `finest` inclusive.

    With `num_levels` 0 their number is the smallest for which neighbours differ by a factor of at most two
    (16 to 256: 16, 32, 64, 128, 256).
    Raises ConfigError where the numbers are out of range or two levels would coincide.
    """
    if not 2 <= base <= finest <= MAX_COORDINATE:
        raise ConfigError(
            f"grid resolutions must satisfy 2 <= base <= finest <= {MAX_COORDINATE}, got {base} and {finest}"
        )
    count = num_levels or 1 + math.ceil(math.log2(finest / base) - 1e-9)
    if count == 1:
        return (finest,)
    growth = (finest / base) ** (1.0 / (count - 1))
    resolutions = tuple(round(base * growth**level) for level in range(count))
    if len(set(resolutions)) < count:
        raise ConfigError(f"{count} levels between {base} and {finest} coincide; use fewer levels")
    return resolutions


def build_layout(
    resolutions: tuple[int, ...], *, num_features: int, log2_table_size: int, half_extent: float
) -> GridLayout:
    """Return the layout of a grid with these resolutions and at most 2**log2_table_size rows per level.

    Raises ConfigError for a table size without stored multipliers.
    """
    if log2_table_size not in MULTIPLIERS:
        raise ConfigError(f"log2_table_size must be one of {sorted(MULTIPLIERS)}, got {log2_table_size}")
    table_size = 2**log2_table_size
    levels = []
    first_row = 0
    for n in resolutions:
        dense = n**3 <= table_size
        num_rows = n**3 if dense else table_size
        multiplier_y, multiplier_z = (n, n * n) if dense else MULTIPLIERS[log2_table_size]
        levels.append(
            GridLevel(
                resolution=n,
                first_row=first_row,
                num_rows=num_rows,
                multiplier_y=multiplier_y,
                multiplier_z=multiplier_z,
            )
        )
        first_row += num_rows
    return GridLayout(levels=tuple(levels), num_features=num_features, half_extent=half_extent)


def dense_layout(resolution: int) -> GridLayout:
    """Return the layout of one dense level with one feature over the cube [-1, 1]^3."""
    level = GridLevel(
        resolution=resolution,
        first_row=0,
        num_rows=resolution**3,
        multiplier_y=resolution,
        multiplier_z=resolution**2,
    )
    return GridLayout(levels=(level,), num_features=1, half_extent=1.0)


def level_constants(layout: GridLayout) -> tuple[list[tuple[int, ...]], list[tuple[float, ...]]]:
    """Return what the compiled backends read per level: six integers, and three numbers for float32.

    The integers are first row, row mask, multiplier of y, multiplier of z, resolution - 2, and rows. A voxel
    with the number x + multiplier_y y + multiplier_z z is row `first row + (number & mask)`: the mask has
    all bits where rows are not a power of two, since such a level is dense and its numbers are below that
    already.
    The others are d u / d z, u of the cube's centre, and the largest u.
    """
    counts: list[tuple[int, ...]] = []
    scales: list[tuple[float, ...]] = []
    for le in layout.levels:
        mask = -1 if le.num_rows & (le.num_rows - 1) else le.num_rows - 1
        n = le.resolution
        counts.append((le.first_row, mask, le.multiplier_y, le.multiplier_z, n - 2, le.num_rows))
        scales.append((n / (2.0 * layout.half_extent), (n - 1) / 2.0, n - 1.0))
    return counts, scales

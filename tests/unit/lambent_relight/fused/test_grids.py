"""The vectorised lookup of a feature grid is the plain one, and reads no row that is not there."""

import numpy as np
import pytest
from lambent_relight.fused import grids
from lambent_relight.fused.kernels import BLOCK, STRIDE

DENSE, HASHED = (5, 0, 125, 5, 25), (40, 125, 256, 2_654_435_761, 805_459_861)
ODD = (40, 381, 300, 2_654_435_761, 805_459_861)
"""A hashed level whose number of rows is not a power of two."""


def grid_of(num_features: int, *levels: tuple[int, ...]) -> grids.Grid:
    table = np.random.default_rng(num_features).normal(size=(681, num_features)).astype(np.float32)
    table.flags.writeable = False
    return grids.Grid(table, np.array(levels, np.int64), 1.0)


def plain(grid: grids.Grid, points: np.ndarray, count: int) -> np.ndarray:
    out = np.zeros((grid.num_outputs, STRIDE), np.float32)
    width = grid.table.shape[1]
    for level, (n, first, rows, by, bz) in enumerate(grid.levels):
        table, target = grid.table[first : first + rows], out[width * level :]
        grids.any_level(points, count, table, n, np.float32(n / 2.0), by, bz, target)
    return out


@pytest.mark.parametrize("num_features", [1, 2, 3, 4])
@pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK])
def test_features_are_those_of_the_plain_loop_bit_for_bit(num_features, count):
    points = np.random.default_rng(1).uniform(-1.3, 1.3, (3, STRIDE)).astype(np.float32)
    grid = grid_of(num_features, DENSE, HASHED, ODD)
    out = np.zeros((grid.num_outputs, STRIDE), np.float32)
    grids.encode(grid, points, count, out)
    np.testing.assert_array_equal(out, plain(grid, points, count))
    assert out[:, :count].std() > 0.1


def test_a_corner_of_a_voxel_has_the_features_of_its_row():
    n, first, _, by, bz = HASHED
    i, j, k = 7, 11, 13
    points = np.zeros((3, STRIDE), np.float32)
    points[:, 0] = [2.0 * (index - 0.5 * (n - 1)) / n for index in (i, j, k)]
    grid = grid_of(2, HASHED)
    out = np.zeros((2, STRIDE), np.float32)
    grids.encode(grid, points, 1, out)
    np.testing.assert_allclose(out[:, 0], grid.table[first + (i + by * j + bz * k) % 256], atol=1e-4)


@pytest.mark.parametrize("level", [DENSE, HASHED, ODD])
def test_what_is_no_number_reads_the_first_voxel(level):
    points = np.full((3, STRIDE), np.nan, np.float32)
    points[1], points[2] = np.inf, -np.inf
    grid = grid_of(2, level)
    out = np.zeros((2, STRIDE), np.float32)
    grids.encode(grid, points, BLOCK, out)
    assert np.isfinite(out[:, :BLOCK]).all()


def test_a_level_with_too_few_rows_for_its_voxels_is_read_modulo_their_number():
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (3, STRIDE)).astype(np.float32)
    grid = grid_of(1, (16, 0, 681, 16, 256))
    out = np.zeros((1, STRIDE), np.float32)
    grids.encode(grid, points, BLOCK, out)
    np.testing.assert_array_equal(out, plain(grid, points, BLOCK))

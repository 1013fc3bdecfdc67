"""Feature grids for blocks of points against the reference."""

import numba
import numpy as np
import pytest
import torch
from flashcache.kernels import cpu, lookup, reference
from flashcache.kernels.layout import build_layout

COUNT = 100


@numba.njit
def look_up(points, count, table, counts, scales, scale, features):
    grid = lookup.Grid(table, counts, scales, scale)
    lookup.encode(points, count, grid, lookup.voxels_of(points.shape[1]), features, 1)


def found(z: torch.Tensor, table: torch.Tensor, layout, scale: float = 1.0) -> np.ndarray:
    """Return the features [feature, point] of the first COUNT points, between rows that are not theirs."""
    features = np.full((layout.num_outputs + 2, len(z)), 7.0, np.float32)
    levels = cpu.levels_of(layout)
    look_up(z.T.contiguous().numpy(), COUNT, table.numpy(), *levels, np.float32(scale), features)
    assert (features[[0, -1]] == 7.0).all()
    assert (features[:, COUNT:] == 7.0).all()
    return features[1:-1, :COUNT]


@pytest.mark.parametrize("num_features", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("resolutions", [(5, 16), (30, 300), (5, 30, 512)])
def test_features_are_the_references(num_features, resolutions):
    layout = build_layout(resolutions, num_features=num_features, log2_table_size=12, half_extent=1.3)
    generator = torch.Generator().manual_seed(3)
    z = 3.2 * torch.rand(COUNT + 5, 3, generator=generator) - 1.6
    z[:2] = torch.tensor([[-1.3, 0.0, 1.3], [5.0, -5.0, 0.1]])
    table = torch.randn(layout.num_rows, num_features, generator=generator)
    wanted = 1.5 * reference.encode(z[:COUNT], table, layout)
    # A position between voxels is rounded to 2^-24 of the resolution; neighbours differ by up to 8.
    np.testing.assert_allclose(found(z, table, layout, 1.5), wanted.T, rtol=0.0, atol=1e-3)
    assert abs(found(z, table, layout, 1.5) - wanted.T.numpy()).mean() < 2e-5


def test_positions_that_are_no_numbers_read_the_first_voxel():
    layout = build_layout((8,), num_features=2, log2_table_size=12, half_extent=1.0)
    table = torch.arange(2.0 * layout.num_rows).reshape(-1, 2)
    nowhere = torch.full((COUNT, 3), torch.nan)
    assert (found(nowhere, table, layout) == np.array([[0.0], [1.0]])).all()

"""Grids, points and upstream gradients on which the compiled encoders are compared with the reference."""

import numpy as np
import torch
from flashcache.kernels.layout import GridLayout, build_layout, dense_layout

LAYOUTS = {
    "dense, 1 feature": build_layout((3, 7, 16), num_features=1, log2_table_size=12, half_extent=1.0),
    "hashed, 2 features": build_layout((24, 300), num_features=2, log2_table_size=12, half_extent=1.0),
    "mixed, 2 features": build_layout((6, 11, 99), num_features=2, log2_table_size=13, half_extent=2.0),
    "mixed, 4 features": build_layout((9, 2048), num_features=4, log2_table_size=12, half_extent=0.7),
}
# Every number of features that a row may have, and levels whose rows are not a power of two.
INTERPRETED = LAYOUTS | {
    "one voxel": dense_layout(1),
    "mixed, 3 features": build_layout((5, 40), num_features=3, log2_table_size=12, half_extent=1.0),
    "mixed, 5 features": build_layout((5, 40), num_features=5, log2_table_size=12, half_extent=1.0),
    "mixed, 8 features": build_layout((6, 500), num_features=8, log2_table_size=12, half_extent=1.5),
}


def case(layout: GridLayout, count: int = 3000) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return points (some outside, some on borders and voxel centres), a table and two upstream gradients."""
    random = np.random.default_rng(5)
    z = random.uniform(-1.1, 1.1, (count, 3)).astype(np.float32) * np.float32(layout.half_extent)
    z[:4] = [[0.0] * 3, [layout.half_extent] * 3, [-layout.half_extent] * 3, [np.inf, -np.inf, 0.1]]
    for place, level in enumerate(layout.levels, start=2):
        # The centres of the first and the last voxel, where the derivative across the border ends.
        z[2 * place : 2 * place + 2] = (
            np.array([[-1.0], [1.0]]) * (1.0 - 1.0 / level.resolution) * layout.half_extent
        )
    table = random.normal(size=(layout.num_rows, layout.num_features)).astype(np.float32)
    by_features = random.normal(size=(count, layout.num_outputs)).astype(np.float32)
    by_jacobian = random.normal(size=(count, layout.num_outputs, 3)).astype(np.float32)
    return z, table, by_features, by_jacobian


def close(found: np.ndarray, expected: torch.Tensor) -> bool:
    """Return whether two float32 results agree to about 30 roundings of their largest value."""
    expected = expected.detach().numpy()
    return bool(np.abs(found - expected).max() <= 2e-6 * max(1.0, np.abs(expected).max()))

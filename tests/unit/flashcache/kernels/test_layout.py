"""Levels of a grid and the rows of their voxels."""

import itertools
import math

import numpy as np
import pytest
from flashcache.errors import ConfigError
from flashcache.kernels.layout import MAX_COORDINATE, MULTIPLIERS, build_layout, level_resolutions

# Checkpoints and bundles were written with these; a better pair would make them unreadable.
SHORTEST_SQUARED = {12: 310, 13: 494, 14: 794, 15: 1253, 16: 2014, 17: 3198, 18: 5051, 19: 8000}


def test_resolutions_double_when_their_number_is_left_open():
    assert level_resolutions(16, 256, 0) == (16, 32, 64, 128, 256)
    assert level_resolutions(16, 2048, 0) == (16, 32, 64, 128, 256, 512, 1024, 2048)


@pytest.mark.parametrize(("base", "finest", "count"), [(16, 256, 8), (8, 96, 6), (16, 96, 0), (16, 16, 0)])
def test_resolutions_start_at_the_base_end_at_the_finest_and_grow(base, finest, count):
    resolutions = level_resolutions(base, finest, count)
    assert resolutions[0] == base
    assert resolutions[-1] == finest
    assert all(a < b <= 2.1 * a for a, b in itertools.pairwise(resolutions))
    assert len(resolutions) == (count or len(resolutions))


@pytest.mark.parametrize(("base", "finest", "count"), [(1, 16, 0), (16, 8, 0), (16, 2049, 0), (16, 20, 12)])
def test_impossible_resolutions_are_refused(base, finest, count):
    with pytest.raises(ConfigError):
        level_resolutions(base, finest, count)


def test_a_table_size_without_constants_is_refused():
    with pytest.raises(ConfigError, match="log2_table_size"):
        build_layout((16,), num_features=2, log2_table_size=20, half_extent=1.0)


def test_every_voxel_of_a_dense_level_has_a_row_of_its_own():
    (level,) = build_layout((5,), num_features=1, log2_table_size=12, half_extent=1.0).levels
    assert level.num_rows == level.resolution**3
    rows = {
        (x + level.multiplier_y * y + level.multiplier_z * z) % level.num_rows
        for x, y, z in itertools.product(range(5), repeat=3)
    }
    assert rows == set(range(125))


def test_levels_follow_each_other_without_gaps_and_are_hashed_above_the_table_size():
    layout = build_layout((16, 17, 64), num_features=4, log2_table_size=12, half_extent=2.0)
    assert [level.num_rows == level.resolution**3 for level in layout.levels] == [True, False, False]
    assert [level.first_row for level in layout.levels] == [0, 4096, 8192]
    assert layout.num_rows == 3 * 4096
    assert layout.num_outputs == 12


def shortest_collision_squared(table_size: int, b: int, c: int) -> int:
    """Return the squared length of the shortest voxel offset that maps to the same row, by enumeration."""
    reach = math.ceil(math.sqrt(2.0) ** (1 / 3) * table_size ** (1 / 3)) + 1
    y, z = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1), indexing="ij")
    x = (b * y + c * z) % table_size
    x = np.minimum(x, table_size - x)
    x[(y == 0) & (z == 0)] = table_size
    return int((x * x + y * y + z * z).min())


@pytest.mark.parametrize("log2_table_size", sorted(MULTIPLIERS))
def test_colliding_voxels_are_nearly_as_far_apart_as_the_densest_packing_allows(log2_table_size):
    found = shortest_collision_squared(2**log2_table_size, *MULTIPLIERS[log2_table_size])
    assert found == SHORTEST_SQUARED[log2_table_size]
    assert math.sqrt(found) >= 0.98 * (math.sqrt(2.0) * 2**log2_table_size) ** (1 / 3)


def test_no_sum_of_coordinates_overflows_a_signed_32_bit_integer():
    largest = max(b + c for b, c in MULTIPLIERS.values())
    assert MAX_COORDINATE * (1 + largest) < 2**31
    assert all(0 < m < 2**k for k, pair in MULTIPLIERS.items() for m in pair)

"""The stored multipliers of the additive hash."""

import math

import numpy as np
import pytest
from flashcache.kernels.layout import MAX_COORDINATE, MULTIPLIERS

# Checkpoints and bundles were written with these; a better pair would make them unreadable.
SHORTEST_SQUARED = {12: 310, 13: 494, 14: 794, 15: 1253, 16: 2014, 17: 3198, 18: 5051, 19: 8000}


def shortest_collision_squared(table_size: int, b: int, c: int) -> int:
    """Return the squared length of the shortest voxel offset that maps to the same row, by enumeration."""
    reach = math.ceil(math.sqrt(2.0) ** (1 / 3) * table_size ** (1 / 3)) + 1
    y, z = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1), indexing="ij")
    x = (b * y + c * z) % table_size
    x = np.minimum(x, table_size - x)
    x[(y == 0) & (z == 0)] = table_size
    return int((x * x + y * y + z * z).min())


@pytest.mark.parametrize("log2_table_size", sorted(MULTIPLIERS))
def test_colliding_voxels_are_as_far_apart_as_recorded(log2_table_size):
    found = shortest_collision_squared(2**log2_table_size, *MULTIPLIERS[log2_table_size])
    assert found == SHORTEST_SQUARED[log2_table_size]


@pytest.mark.parametrize("log2_table_size", sorted(MULTIPLIERS))
def test_collision_distance_is_within_two_percent_of_the_densest_packing(log2_table_size):
    bound = (math.sqrt(2.0) * 2**log2_table_size) ** (1 / 3)
    assert math.sqrt(SHORTEST_SQUARED[log2_table_size]) >= 0.98 * bound


def test_no_sum_of_coordinates_overflows_a_signed_32_bit_integer():
    largest = max(b + c for b, c in MULTIPLIERS.values())
    assert MAX_COORDINATE * (1 + largest) < 2**31
    assert all(0 < m < 2**k for k, pair in MULTIPLIERS.items() for m in pair)

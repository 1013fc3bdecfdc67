"""Levels of a grid and the rows of their voxels."""

import itertools

import pytest
from flashcache.errors import ConfigError
from flashcache.kernels.layout import build_layout, level_resolutions


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
    assert level.is_dense
    rows = {
        (x + level.multiplier_y * y + level.multiplier_z * z) % level.num_rows
        for x, y, z in itertools.product(range(5), repeat=3)
    }
    assert rows == set(range(125))


def test_levels_follow_each_other_without_gaps_and_are_hashed_above_the_table_size():
    layout = build_layout((16, 17, 64), num_features=4, log2_table_size=12, half_extent=2.0)
    assert [level.is_dense for level in layout.levels] == [True, False, False]
    assert [level.first_row for level in layout.levels] == [0, 4096, 8192]
    assert layout.num_rows == 3 * 4096
    assert layout.num_outputs == 12

import torch
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.losses.priors import grid_decay


def levels(made: HashGrid) -> list[torch.Tensor]:
    return [made.table[level.first_row :][: level.num_rows] for level in made.layout.levels]


def grid(finest: int = 64) -> HashGrid:
    torch.manual_seed(0)
    made = HashGrid(HashGridConfig(finest_resolution=finest, log2_table_size=13))
    with torch.no_grad():
        made.table.normal_()
    return made


def test_every_level_counts_by_its_own_mean():
    made = grid()
    expected = sum(0.5 * level.square().mean() for level in levels(made))
    torch.testing.assert_close(grid_decay([made]), expected)


def test_the_decay_of_several_grids_is_the_sum_of_theirs():
    one, two = grid(), grid(32)
    torch.testing.assert_close(grid_decay([one, two]), grid_decay([one]) + grid_decay([two]))


def test_the_gradient_of_an_entry_is_its_value_over_the_size_of_its_level():
    made = grid()
    grid_decay([made]).backward()
    for level, part in zip(made.layout.levels, levels(made), strict=True):
        rows = slice(level.first_row, level.first_row + level.num_rows)
        torch.testing.assert_close(made.table.grad[rows], part.detach() / part.numel())

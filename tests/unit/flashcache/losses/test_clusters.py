import math

import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.losses.clusters import ClusterConfig, gloss_differences, material_entropy
from flashcache.physical.brdf import Materials


def materials(rows: torch.Tensor) -> Materials:
    return Materials(rows[:, :3], rows[:, 3:4], rows[:, 4:5])


def test_one_material_has_no_entropy():
    same = torch.full((7, 5), 0.4)
    assert float(material_entropy(materials(same), torch.ones(7), 0.1)) == pytest.approx(0.0, abs=1e-5)


def test_two_far_clusters_of_equal_size_have_the_entropy_of_a_coin():
    rows = torch.full((8, 5), 0.1)
    rows[4:] = 0.9
    found = float(material_entropy(materials(rows), torch.ones(8), 0.05))
    assert found == pytest.approx(math.log(2.0), abs=1e-4)


def test_points_of_no_weight_do_not_count():
    rows = torch.full((8, 5), 0.1)
    rows[4:] = 0.9
    weight = torch.tensor([1.0] * 4 + [0.0] * 4)
    assert float(material_entropy(materials(rows), weight, 0.05)) == pytest.approx(0.0, abs=1e-3)


def test_a_stray_point_is_drawn_to_the_near_cluster_and_not_to_the_far_one():
    rows = torch.full((9, 5), 0.2)
    rows[4:8] = 0.8
    rows[8] = 0.27
    rows.requires_grad_()
    material_entropy(materials(rows), torch.ones(9), 0.1).backward()
    # Descent moves it down, towards 0.2.
    assert (rows.grad[8] > 0.0).all()


def test_without_gloss_widths_are_not_compared_and_not_drawn_together():
    rows = torch.full((8, 5), 0.3)
    rows[4:, 3] = 0.9
    rows[0, :3] += 0.05
    rows[1, 4] += 0.05
    rows.requires_grad_()
    weight = torch.ones(8)
    assert float(material_entropy(materials(rows.detach()), weight, 0.1)) > 0.3
    entropy = material_entropy(materials(rows), weight, 0.1, gloss=0.0)
    entropy.backward()
    assert float(entropy.detach()) < 0.1
    assert (rows.grad[:, 3] == 0.0).all()
    assert (rows.grad[0, :3] > 0.0).all()
    assert rows.grad[1, 4] > 0.0


def test_nothing_is_gained_by_making_all_albedo_darker():
    rows = torch.rand(9, 5, generator=torch.Generator().manual_seed(2))
    dark = rows * torch.tensor([0.3, 0.3, 0.3, 1.0, 1.0])
    weight = torch.linspace(0.5, 1.0, 9)
    bright, dim = (float(material_entropy(materials(values), weight, 0.1)) for values in (rows, dark))
    assert dim == pytest.approx(bright, rel=1e-4)


@pytest.mark.parametrize("name", ["width", "gloss_distance"])
def test_a_distance_of_zero_is_refused(name):
    with pytest.raises(ConfigError, match=name):
        ClusterConfig(**{name: 0.0})


GLOSS = ClusterConfig(width=0.1, gloss_distance=0.1)


def pair(albedo: float, distance: float) -> tuple[Materials, torch.Tensor]:
    """Return two points of unlike gloss, apart in albedo and in space, and their positions."""
    rows = torch.full((2, 5), 0.3)
    rows[1, :3] += albedo
    rows[1, 3:] = 0.8
    return materials(rows.requires_grad_()), torch.tensor([[0.0, 0.0, 0.0], [distance, 0.0, 0.0]])


def test_neighbours_of_one_albedo_share_their_width_and_others_do_not():
    """Without a neighbour a point differs from itself alone, by nothing."""
    near, unlike, far = (
        gloss_differences(*pair(albedo, distance), torch.ones(2), GLOSS).item()
        for albedo, distance in ((0.0, 0.02), (0.6, 0.02), (0.0, 1.0))
    )
    expected = 0.5 * (math.sqrt(0.8) - math.sqrt(0.3)) ** 2
    assert near == pytest.approx(expected, rel=0.05)
    assert max(unlike, far) < 0.01 * near


def test_shared_width_moves_widths_alone():
    rows = torch.rand(9, 5, generator=torch.Generator().manual_seed(2)).requires_grad_()
    positions = 0.05 * torch.rand(9, 3, generator=torch.Generator().manual_seed(3))
    gloss_differences(materials(rows), positions, torch.ones(9), GLOSS).backward()
    assert rows.grad[:, 3].any()
    assert not rows.grad[:, [0, 1, 2, 4]].any()


def test_neighbours_that_no_photograph_covers_do_not_count():
    found, positions = pair(0.0, 0.02)
    assert gloss_differences(found, positions, torch.tensor([1.0, 0.0]), GLOSS).item() == 0.0

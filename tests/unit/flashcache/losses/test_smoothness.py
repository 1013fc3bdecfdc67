import pytest
import torch
from flashcache.losses.smoothness import guide_weight, pseudo_albedo, smoothness
from flashcache.physical.brdf import Materials

GUESS = torch.full((2, 3), 0.4)
ONES = torch.ones(2)


def materials(level: float) -> Materials:
    return Materials(torch.full((2, 3), level), torch.full((2, 1), level), torch.full((2, 1), level))


def test_equal_materials_cost_nothing():
    assert smoothness(materials(0.3), materials(0.3), GUESS, GUESS, ONES) == 0.0


def test_the_cost_is_relative_to_the_larger_value():
    bright = smoothness(materials(0.8), materials(0.4), GUESS, GUESS, ONES)
    dark = smoothness(materials(0.1), materials(0.2), GUESS, GUESS, ONES)
    torch.testing.assert_close(bright, dark)


def test_a_change_of_material_is_cheap_where_the_pictures_change():
    edge = smoothness(materials(0.8), materials(0.4), GUESS, 0.2 * GUESS, ONES)
    flat = smoothness(materials(0.8), materials(0.4), GUESS, GUESS, ONES)
    assert edge < 0.2 * flat


def test_the_pseudo_albedo_is_the_albedo_of_a_matte_surface():
    albedo = torch.tensor([[0.2, 0.5, 0.9]])
    irradiance = torch.tensor([[1.5, 0.4, 3.0]])
    torch.testing.assert_close(pseudo_albedo(albedo * irradiance, irradiance), albedo)


def test_the_pseudo_albedo_carries_no_gradient_and_stays_in_range_in_the_dark():
    radiance = torch.ones(1, 3, requires_grad=True)
    found = pseudo_albedo(radiance, torch.zeros(1, 3))
    assert not found.requires_grad
    assert found.max() <= 1.0


@pytest.mark.parametrize(("guided", "flat", "edge"), [("decreasing", 1.1, 0.2), ("none", 1.0, 1.0)])
def test_the_weight_where_the_guess_stays_and_where_it_changes(guided, flat, edge):
    assert guide_weight(GUESS, GUESS, guided)[0] == pytest.approx(flat)
    assert guide_weight(GUESS, 0.2 * GUESS, guided)[0] == pytest.approx(edge, abs=0.1)


def test_the_printed_weight_is_the_change_itself():
    # Supplement Eq. 9.
    torch.testing.assert_close(guide_weight(GUESS, 0.5 * GUESS, "printed"), torch.full((2,), 0.2))
    assert smoothness(materials(0.8), materials(0.4), GUESS, GUESS, ONES, guided="printed") == 0.0

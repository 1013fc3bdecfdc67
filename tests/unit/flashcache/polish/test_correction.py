"""The albedo that rendered pixels ask for: up to noise, the one that photographs show."""

from dataclasses import replace

import pytest
import torch
from flashcache.polish.correction import MOST, corrected_albedo
from flashcache.polish.light import Reflectance
from flashcache.polish.neighbours import Neighbours
from support.polish_sphere import sphere_elements


@pytest.fixture(scope="module")
def elements():
    made = sphere_elements((0.5, 0.4, 0.3), 0.16, 0.0, count=160, views=12)
    return replace(made, pixel=torch.arange(len(made.colour)))


def corrected(elements, albedo, sent):
    """Return the correction of an even `albedo` where a model sends `sent(repeat, colours)`."""
    found = Reflectance(
        torch.full((len(elements), 3), albedo),
        torch.full((len(elements),), 0.3),
        torch.zeros(len(elements)),
        elements.normal,
    )

    def render(index, repeat):
        return sent(repeat, elements.colour[index])

    with torch.no_grad():
        return corrected_albedo(render, elements, found, Neighbours.of(elements), 0).albedo


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.2])
def test_albedo_follows_what_photographs_show_over_what_is_rendered(elements, factor):
    lit = replace(elements, colour=0.4 + 0.2 * torch.rand_like(elements.colour))
    found = corrected(lit, 0.4, lambda repeat, colour: colour * factor)
    torch.testing.assert_close(found, torch.full_like(found, 0.4 / factor), rtol=0.03, atol=0.0)


def test_noise_of_the_rendering_makes_nothing_darker(elements):
    """By the square of one estimate it would, by its variance: six per cent here."""
    lit = replace(elements, colour=torch.full_like(elements.colour, 0.4))

    def noisy(repeat, colour):
        generator = torch.Generator().manual_seed(repeat)
        return colour * (1.0 + 0.25 * torch.randn(colour.shape, generator=generator))

    found = corrected(lit, 0.4, noisy)
    assert float(found.mean()) == pytest.approx(0.4, rel=0.03)


def test_a_correction_has_a_limit_and_albedo_stays_below_one(elements):
    lit = replace(elements, colour=torch.full_like(elements.colour, 0.8))
    far = corrected(lit, 0.4, lambda repeat, colour: 0.1 * colour)
    assert float(far.max()) <= 0.4 * MOST + 1e-6
    assert float(far.min()) > 0.4
    bright = corrected(lit, 0.9, lambda repeat, colour: 0.7 * colour)
    assert float(bright.max()) <= 1.0


def test_a_clipped_channel_asks_for_no_darker_albedo(elements):
    white = replace(
        elements,
        colour=torch.ones_like(elements.colour),
        clipped=torch.ones_like(elements.clipped),
    )
    found = corrected(white, 0.5, lambda repeat, colour: 1.4 * colour)
    torch.testing.assert_close(found, torch.full_like(found, 0.5))


def test_where_nothing_is_bright_nothing_changes(elements):
    black = replace(elements, colour=torch.zeros_like(elements.colour))
    found = corrected(black, 0.02, lambda repeat, colour: colour)
    torch.testing.assert_close(found, torch.full_like(found, 0.02))

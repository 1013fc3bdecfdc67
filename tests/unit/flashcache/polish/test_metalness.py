"""Metal elements: by what fits, and by what stage two says where both fit nearly alike."""

import pytest
import torch
from flashcache.polish.materials import DIELECTRIC, SUSPECT, metalness


def of(apart: float, believed: float) -> float:
    return float(metalness(torch.tensor([apart]), torch.tensor([believed])))


@pytest.mark.parametrize("believed", [0.0, DIELECTRIC, SUSPECT, 1.0])
def test_what_fits_much_better_needs_no_second_opinion(believed: float):
    assert of(-0.3, believed) > 0.99
    assert of(0.7, believed) < 0.01


def test_stage_two_decides_where_metals_fit_a_little_worse():
    # On scenes with truth, metals with wrong normals fit up to 0.4 worse, and so do a few dielectrics, which
    # stage two calls metal by 0.25 or less.
    assert of(0.3, SUSPECT) > 0.9
    assert of(0.3, 1.0) == of(0.3, SUSPECT)
    assert of(0.6, 1.0) < 0.1
    assert of(0.12, DIELECTRIC) < 0.1
    assert of(0.35, 0.25) < 0.1
    assert 0.2 < of(0.2, 0.5 * (DIELECTRIC + SUSPECT)) < 0.8


def test_metalness_falls_evenly_where_both_fit_alike():
    apart = torch.linspace(-0.2, 0.2, 9)
    found = metalness(apart, torch.zeros(9))
    assert float(found[4]) == pytest.approx(0.5)
    assert bool((found.diff() < 0.0).all())

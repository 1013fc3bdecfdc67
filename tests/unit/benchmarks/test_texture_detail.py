"""How detail is measured."""

import numpy as np
import pytest
from scipy.special import erf

from benchmarks import printed_drum as drum
from benchmarks.texture_detail import edge_profile, ideal, modulation, modulations, pixel_on_wall

PIXEL = 0.001


def edge(blur: float, *, bend: float = 0.0, seed: int = 0):
    """Return places around an edge and values blurred by `blur` pixels; it bends by `bend` pixels."""
    generator = np.random.default_rng(seed)
    across, along = generator.uniform(-0.045, 0.045, 40000), generator.uniform(-0.1, 0.1, 40000)
    moved = across - bend * PIXEL * np.sin(along / 0.1 * np.pi)
    level = 0.5 + 0.5 * erf(moved / (np.sqrt(2.0) * max(blur, 1e-3) * PIXEL))
    return across, along, 0.1 + 0.5 * level


@pytest.mark.parametrize("blur", [0.5, 0.8, 1.2])
def test_the_modulation_of_a_blurred_edge_is_that_of_its_blur(blur):
    found = modulation(edge_profile(*edge(blur), PIXEL))
    expected = np.exp(-2.0 * np.pi**2 * blur**2 * 0.25**2)
    assert found == pytest.approx(expected, abs=0.05)


def test_an_edge_that_bends_is_not_a_blurred_one():
    straight, bent = (modulation(edge_profile(*edge(0.5, bend=bend), PIXEL)) for bend in (0.0, 4.0))
    assert bent > straight - 0.12


def test_too_few_texels_are_no_edge():
    across, along, values = (part[:30] for part in edge(0.5))
    assert edge_profile(across, along, values, PIXEL) is None


def test_the_print_s_own_edges_are_found_and_sharp():
    pixel = pixel_on_wall(800)
    positions, grey = ideal(pixel)
    found = modulations(positions, grey, pixel)
    assert len(found) == 4 * len(drum.SQUARES)
    # A pixel's mean leaves sinc(1/4) = 0.90, the finite print and the profile's steps a little less.
    assert 0.75 < min(found) <= max(found) < 0.97

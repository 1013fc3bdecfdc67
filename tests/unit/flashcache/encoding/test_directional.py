"""Encodings of directions."""

import math

import numpy as np
import pytest
import torch
from flashcache.encoding.directional import IntegratedDirectionalEncoding, positional_encoding
from scipy.special import sph_harm_y


def directions(count: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(4)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


def test_frequencies_double_and_the_identity_comes_first():
    values = torch.tensor([[0.3, -1.2]])
    encoded = positional_encoding(values, 2)
    expected = [
        *values[0],
        *values[0].sin(),
        *(2 * values[0]).sin(),
        *values[0].cos(),
        *(2 * values[0]).cos(),
    ]
    assert torch.allclose(encoded, torch.tensor([expected]))


def test_no_frequencies_leave_the_values():
    assert torch.equal(positional_encoding(torch.ones(2, 3), 0), torch.ones(2, 3))


def test_a_sharp_lobe_gives_the_spherical_harmonics():
    encoding = IntegratedDirectionalEncoding(5)
    unit = directions(500)
    exact = unit.double().numpy()
    polar, azimuth = np.arccos(exact[:, 2]), np.arctan2(exact[:, 1], exact[:, 0])
    terms = [(degree, order) for degree in (1, 2, 4, 8, 16) for order in range(degree + 1)]
    harmonics = np.stack([sph_harm_y(degree, order, polar, azimuth) for degree, order in terms], axis=-1)
    found = encoding(unit, torch.zeros(500, 1)).numpy()
    assert found.shape == (500, encoding.out_features) == (500, 72)
    assert np.abs(found - np.concatenate([harmonics.real, harmonics.imag], axis=-1)).max() < 1e-4


@pytest.mark.parametrize("inverse_concentration", [0.01, 0.5])
def test_a_wide_lobe_attenuates_by_degree(inverse_concentration):
    encoding = IntegratedDirectionalEncoding(3)
    unit = directions(10)
    sharp = encoding(unit, torch.zeros(10, 1))
    wide = encoding(unit, torch.full((10, 1), inverse_concentration))
    rates = [degree * (degree + 1) / 2 for degree in (1, 2, 4) for _ in range(degree + 1)] * 2
    factors = torch.tensor([math.exp(-rate * inverse_concentration) for rate in rates])
    assert torch.allclose(wide, sharp * factors, atol=1e-6)


@pytest.mark.parametrize("num_degrees", [1, 3, 5])
def test_the_written_out_derivatives_are_those_of_the_encoding(num_degrees):
    encoding = IntegratedDirectionalEncoding(num_degrees).double()
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(6, 3, generator=generator, dtype=torch.float64)
    directions = torch.nn.functional.normalize(directions, dim=-1).requires_grad_()
    blur = torch.rand(6, 1, generator=generator, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(encoding, (directions, blur))

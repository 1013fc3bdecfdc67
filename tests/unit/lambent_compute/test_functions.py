"""The errors of the polynomials, against double precision."""

import numba
import numpy as np
import pytest
from lambent_compute import functions


@numba.njit
def each(function, values, found):
    for i in range(len(values)):
        found[i] = function(values[i])


@numba.njit
def circle(values, sines, cosines):
    for i in range(len(values)):
        sines[i], cosines[i] = functions.sine_and_cosine(values[i])


def evaluated(function, values: np.ndarray) -> np.ndarray:
    found = np.empty_like(values)
    each(function, values, found)
    return found.astype(np.float64)


def exact(function, values: np.ndarray) -> np.ndarray:
    return function(values.astype(np.float64))


LINE = np.linspace(-80.0, 80.0, 200_001, dtype=np.float32)
POSITIVE = np.exp(np.linspace(-60.0, 60.0, 200_001)).astype(np.float32)


def test_exponentials_have_the_stated_relative_error_and_end_where_stated():
    np.testing.assert_allclose(evaluated(functions.exponential, LINE), exact(np.exp, LINE), rtol=2e-7)
    ends = np.array([-np.inf, -1e4, 1e4, np.inf], np.float32)
    np.testing.assert_allclose(
        evaluated(functions.exponential, ends), np.exp([-87.0, -87.0, 88.0, 88.0]), rtol=2e-7
    )


def test_logarithms_have_the_stated_error():
    found = evaluated(functions.logarithm, POSITIVE)
    np.testing.assert_allclose(found, exact(np.log, POSITIVE), rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("exponent", [-2.0 / 3.0, 0.4, 1.0])
def test_powers_have_the_stated_relative_error(exponent):
    values = POSITIVE[(POSITIVE > 1e-3) & (POSITIVE < 1e3)]
    found = np.empty_like(values)

    @numba.njit
    def powers(values, exponent, found):
        for i in range(len(values)):
            found[i] = functions.power(values[i], exponent)

    powers(values, np.float32(exponent), found)
    np.testing.assert_allclose(found, exact(lambda x: x ** float(np.float32(exponent)), values), rtol=1e-6)


def test_softplus_has_the_stated_error():
    wanted = exact(lambda x: np.logaddexp(0.0, x), LINE)
    np.testing.assert_allclose(evaluated(functions.softplus, LINE), wanted, rtol=1e-7, atol=2e-7)


def test_sigmoids_have_a_small_error():
    wanted = exact(lambda x: 1.0 / (1.0 + np.exp(-x)), LINE)
    np.testing.assert_allclose(evaluated(functions.sigmoid, LINE), wanted, rtol=4e-7)


def test_the_opaque_share_is_exact_for_small_depths_too():
    found = evaluated(functions.opaque_share, POSITIVE)
    np.testing.assert_allclose(found, exact(lambda x: -np.expm1(-x), POSITIVE), rtol=3e-7)
    assert evaluated(functions.opaque_share, np.zeros(1, np.float32)) == 0.0


def test_sines_and_cosines_have_the_stated_error():
    values = np.linspace(-1000.0, 1000.0, 200_001, dtype=np.float32)
    sines, cosines = np.empty_like(values), np.empty_like(values)
    circle(values, sines, cosines)
    np.testing.assert_allclose(sines, exact(np.sin, values), rtol=0.0, atol=2e-7)
    np.testing.assert_allclose(cosines, exact(np.cos, values), rtol=0.0, atol=2e-7)


@pytest.mark.parametrize("name", ["exponential", "softplus", "sigmoid", "opaque_share"])
def test_what_is_no_number_stays_none(name):
    assert np.isnan(evaluated(getattr(functions, name), np.array([np.nan], np.float32))).all()

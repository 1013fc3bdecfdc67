"""Primaries of files, and the matrices from them to linear Rec. 709."""

import numpy as np
import pytest
from lambent_core.colour import REC709_CHROMATICITIES, rec709_matrix, to_rec709
from support.environment_layouts import (
    ACESCG,
    ACESCG_FROM_REC709,
    RADIANCE_DEFAULT,
    REC2020,
    REC2020_FROM_REC709,
)


@pytest.mark.parametrize(
    ("stated", "published"), [(REC2020, REC2020_FROM_REC709), (ACESCG, ACESCG_FROM_REC709)]
)
def test_the_matrix_is_the_inverse_of_the_published_one(stated, published):
    np.testing.assert_allclose(rec709_matrix(stated) @ published, np.eye(3), atol=5e-4)


@pytest.mark.parametrize("stated", [REC2020, ACESCG, RADIANCE_DEFAULT])
def test_grey_stays_grey_whatever_the_white(stated):
    np.testing.assert_allclose(to_rec709(np.ones((1, 3), np.float32), rec709_matrix(stated)), 1.0, atol=1e-5)


def test_rounded_primaries_of_rec_709_change_nothing():
    assert rec709_matrix(REC709_CHROMATICITIES) is None
    assert rec709_matrix((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.313, 0.329)) is None
    colours = np.ones((2, 3), np.float32)
    assert to_rec709(colours, None) is colours


@pytest.mark.parametrize(
    "stated",
    [
        (0.3,) * 8,
        (0.0,) * 8,
        (*REC709_CHROMATICITIES[:6], 0.3, 0.0),
        (np.nan,) * 8,
        REC709_CHROMATICITIES[:6],
        (*REC709_CHROMATICITIES[:7], np.inf),
    ],
)
def test_numbers_that_are_no_primaries_are_an_error(stated):
    with pytest.raises(ValueError, match=r"."):
        rec709_matrix(stated)


def test_a_colour_outside_rec_709_loses_its_negative_channel_and_a_broken_one_stays_broken():
    matrix = rec709_matrix(REC2020)
    green = to_rec709(np.array([[0.0, 1.0, 0.0]], np.float32), matrix)
    assert green.min() == 0.0
    assert green[0, 1] > 1.0
    broken = np.array([[-1.0, 0.0, 0.0], [np.nan, 1.0, 1.0], [np.inf, 0.0, 0.0]], np.float32)
    found = to_rec709(broken, matrix)
    assert found[0].min() < 0.0
    assert not np.isfinite(found[1:]).all(axis=1).any()


def test_tristimulus_values_are_adapted_to_no_white():
    # Source: IEC 61966-2-1, the matrix from XYZ to linear sRGB.
    expected = [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    found = rec709_matrix((1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / 3.0, 1.0 / 3.0))
    np.testing.assert_allclose(found, expected, atol=1e-3)

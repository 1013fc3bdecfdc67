"""Tone curves: what each promises, and numbers worked out from their published definitions."""

import numpy as np
import pytest
from lambent_core.errors import SettingError
from lambent_relight.tone_mapping import NAMES, tone_mapped

GREYS = np.repeat(np.geomspace(1e-4, 1e3, 200), 3).reshape(-1, 3)


@pytest.mark.parametrize("name", NAMES)
def test_curves_rise_and_stay_in_range(name):
    shown = tone_mapped(GREYS, name)
    assert shown.dtype == np.float32
    assert shown.min() >= 0.0
    assert shown.max() <= 1.0
    assert (np.diff(shown.mean(axis=1)) >= -1e-6).all()
    assert shown[-1].min() > 0.98
    # Grey stays grey: the published matrices are rounded to four places.
    np.testing.assert_allclose(shown, shown[:, :1].repeat(3, axis=1), atol=2e-3)


def test_the_linear_curve_only_clips():
    values = np.array([[0.0, 0.25, 3.0], [-1.0, 1.0, 0.5]])
    np.testing.assert_array_equal(tone_mapped(values, "linear"), [[0.0, 0.25, 1.0], [0.0, 1.0, 0.5]])


@pytest.mark.parametrize(
    ("name", "colour", "expected"),
    [
        # Below the compression only the toe is taken off: 0.5 - 0.04; 0.04 - (0.04 - 6.25 * 0.04^2).
        ("neutral", (0.5, 0.5, 0.5), (0.46, 0.46, 0.46)),
        ("neutral", (0.04, 0.54, 0.04), (0.01, 0.51, 0.01)),
        # Peak 1.96 becomes 1 - 0.24^2 / (1.96 - 0.52) = 0.96; the rest follows the desaturation.
        ("neutral", (2.0, 2.0, 2.0), (0.96, 0.96, 0.96)),
        # 1.96 = peak; share 1 / (0.15 * (1.96 - 0.96) + 1) = 0.869565; 0 + 0.96 * 0.130435.
        ("neutral", (1.96, 0.0, 0.0), (0.96, 0.125217, 0.125217)),
        # v = 1: (1.0245786 - 0.000090537) / (1.41668 + 0.238081), and rows of the output matrix sum to one.
        ("aces", (0.6, 0.6, 0.6), (0.61912, 0.61912, 0.61912)),
        # Middle grey: (log2 0.18 + 12.47393) / 16.5 = 0.60606, contrast 0.496, to the power of 2.2.
        ("agx", (0.18, 0.18, 0.18), (0.2142, 0.2142, 0.2142)),
    ],
)
def test_curves_give_the_published_numbers(name, colour, expected):
    np.testing.assert_allclose(tone_mapped(np.array(colour), name), expected, atol=2e-3)


def test_saturated_highlights_turn_white_in_all_curves_but_the_linear_one():
    red = np.array([50.0, 0.5, 0.5])
    # How far the colour is from grey.
    spread = {name: np.ptp(tone_mapped(red, name)) for name in NAMES}
    assert spread["linear"] == pytest.approx(0.5)
    for name in NAMES[1:]:
        assert spread[name] < 0.5


def test_an_unknown_curve_is_refused():
    with pytest.raises(SettingError, match=r"relight\.tone_mapping.*neutral"):
        tone_mapped(GREYS, "filmic")

"""Settings as Python code gives them: what is changed, and what is refused with which code."""

from typing import get_args

import numpy as np
import pytest
from lambent_core.errors import SettingError, UnsupportedQuality
from lambent_core.pictures import Axes, RenderSettings
from lambent_relight.environment.axes import QUARTER_TURNS
from lambent_relight.settings import BACKGROUNDS, settled


def test_what_is_changed_is_changed_and_the_rest_kept():
    start = settled(seed=3, spp=8)
    assert settled(start) is start
    assert settled(start, spp=np.int64(9)) == RenderSettings(seed=3, spp=9)
    assert start.spp == 8


def test_the_renderer_knows_every_word():
    assert get_args(RenderSettings.model_fields["background"].annotation) == tuple(BACKGROUNDS)
    assert set(get_args(Axes)) == set(QUARTER_TURNS)


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"spp": 1}, SettingError, "relight.num_samples: spp: 1 is not from 2 to 65536; use a whole number"),
        ({"seed": 0.5}, SettingError, "relight.seed: seed: a whole number from 0 to 2147483647 is expected"),
        ({"exposure_ev": float("nan")}, SettingError, "a number from -64 to 64 is expected, not nan"),
        ({"indirect": 1}, SettingError, "relight.indirect: indirect: true or false is expected, not 1; use"),
        ({"quality": "best"}, UnsupportedQuality, "not 'best'; use one of preview, baked, refined"),
        ({"bouncs": "one"}, SettingError, "there is no 'bouncs' here; did you mean 'bounces'?; settings are"),
    ],
)
def test_what_cannot_be_used_is_refused_with_what_can(changes, error, text):
    with pytest.raises(error) as caught:
        settled(**changes)
    assert text in str(caught.value)


@pytest.mark.parametrize("value", [-0.02, -1e-9, 1.0, 2, float("nan"), float("inf"), "low"])
def test_a_noise_that_cannot_be_reached_is_refused_with_the_range(value):
    with pytest.raises(SettingError, match=r"relight\.until_stderr: .* from 0 to 0\.999"):
        settled(until_stderr=value)


@pytest.mark.parametrize("value", [0, -1, -64, 65537, 2.5])
def test_a_number_of_directions_that_there_cannot_be_is_refused_with_the_range(value):
    with pytest.raises(SettingError, match=r"relight\.num_samples: .* from 2 to 65536"):
        settled(spp=value)

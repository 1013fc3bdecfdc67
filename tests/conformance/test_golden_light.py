"""The golden numbers of lighting hold in Python; client/web/tests/light.test.ts reads the same files."""

import json

import golden_light
import pytest


@pytest.mark.parametrize("name", ["harmonics", "prefilter", "split_sum", "dominant", "axes"])
def test_the_stored_numbers_are_reproduced(name):
    stored = json.loads((golden_light.GOLDEN / f"light_{name}.json").read_text(encoding="utf-8"))
    numbers = {
        "harmonics": golden_light.harmonics_numbers,
        "prefilter": golden_light.prefilter_numbers,
        "split_sum": golden_light.split_sum_numbers,
        "dominant": golden_light.dominant_numbers,
        "axes": golden_light.axes_numbers,
    }[name]()
    assert golden_light.equal(stored, numbers)


def test_another_number_is_noticed():
    assert golden_light.equal({"a": [1.0, 2.0]}, {"a": [1.0, 2.0]})
    assert not golden_light.equal({"a": [1.0, 2.00001]}, {"a": [1.0, 2.0]})
    assert not golden_light.equal({"a": [1.0]}, {"a": [1.0, 2.0]})
    assert not golden_light.equal({"b": 1.0}, {"a": 1.0})

"""Environments given with --known-light: whose they are, that the run keeps them, and what the model sees."""

import numpy as np
import pytest
import torch
from flashcache.physical.model import Domain, InverseModel
from flashcache.presets import tiny
from lambent_core.errors import UsageError
from lambent_relight.environment.maps import write_environment
from lambent_run.run.known_lights import (
    give_known_lights,
    known_names,
    parse_known_lights,
)
from lambent_run.run.spec import RunSpec, keep_run


@pytest.fixture
def sky(tmp_path):
    """Return the path of a map whose upper half is three times as bright as its lower half."""
    image = np.ones((8, 16, 3), np.float32)
    image[:4] *= 3.0
    write_environment(tmp_path / "sky.exr", image)
    return tmp_path / "sky.exr"


def test_a_bare_file_is_the_only_light_and_a_named_one_its_lights(sky):
    assert parse_known_lights([str(sky)]) == {"": sky}
    assert parse_known_lights([f"a={sky}", f"b={sky}"]) == {"a": sky, "b": sky}


def test_a_light_given_twice_and_a_file_that_is_no_map_are_refused(sky, tmp_path):
    with pytest.raises(UsageError, match=r"light\.known_twice"):
        parse_known_lights([f"a={sky}", f"a={sky}"])
    with pytest.raises(UsageError, match=r"environment\.missing"):
        parse_known_lights([str(tmp_path / "none.hdr")])
    (tmp_path / "picture.png").write_bytes(b"")
    with pytest.raises(UsageError, match=r"environment\.unknown_format"):
        parse_known_lights([str(tmp_path / "picture.png")])


def test_which_light_a_file_belongs_to():
    assert known_names({"": "x"}, ("sun",), rotated=False) == ("sun",)
    assert known_names({"": "x"}, ("sun_000", "sun_120"), rotated=True) == ("sun_000",)
    assert known_names({"b": "x"}, ("a", "b"), rotated=False) == ("b",)
    with pytest.raises(UsageError, match=r"light\.known_unnamed.*LIGHT=FILE"):
        known_names({"": "x"}, ("a", "b"), rotated=False)
    with pytest.raises(UsageError, match=r"light\.known_unknown.*a, b"):
        known_names({"c": "x"}, ("a", "b"), rotated=False)


def test_the_run_keeps_the_file_and_the_model_sees_it(sky, tmp_path):
    run = tmp_path / "run"
    spec = RunSpec.from_options(tmp_path, preset="tiny", known_lights=[f"b={sky}"])
    keep_run(run, spec, "cpu")
    sky.unlink()
    corner = (1.0, 1.0, 1.0)
    domain = Domain(
        bounds_min=(-1.0, -1.0, -1.0),
        bounds_max=corner,
        primary=(1.0, 4.0),
        secondary=(0.05, 2.0),
        contraction_radius=1.0,
        lights=("a", "b"),
        known_lights=("b",),
    )
    model = InverseModel(tiny().model, domain)
    give_known_lights(model, run, spec.known_lights)
    up_and_down = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    found = model.environment(up_and_down, torch.ones(2, dtype=torch.long))
    torch.testing.assert_close(found, torch.tensor([[3.0] * 3, [1.0] * 3]))

"""A user hears of the factor between albedo and light where nothing settles it, with the light's colour."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from lambent_run.report.common_factor import ROWS, common_factor_note, light_colour
from support.evaluation_subject import subject_of
from support.lit_sphere import lit_domain, lit_sphere


def lit(lights=("sky",), **domain) -> SimpleNamespace:
    """Return a model whose light `n` is (n + 2) : 1 : 0.5 everywhere but brighter and blue at the zenith."""

    def image(height, light):
        found = torch.tensor([light + 2.0, 1.0, 0.5]).expand(height, 2 * height, 3).clone()
        found[0] = torch.tensor([0.0, 0.0, 50.0])
        return found

    scene = replace(lit_sphere(2, side=4), lights=lights)
    return SimpleNamespace(
        domain=replace(lit_domain(scene), **domain), environment=SimpleNamespace(image=image)
    )


def note(lights=("sky",), *, grey_card=False, **domain) -> str | None:
    scene = replace(lit_sphere(2, side=4), lights=lights)
    return common_factor_note(subject_of(lit(lights, **domain), scene, grey_card=grey_card))


def test_the_colour_of_a_light_is_its_mean_over_solid_angle():
    zenith = 0.5 * (1.0 - torch.cos(torch.tensor(torch.pi / ROWS)).item())
    rest = 1.0 - zenith
    red, green, blue = light_colour(lit(), 0)  # type: ignore[arg-type]
    assert (red, green) == (pytest.approx(2.0), 1.0)
    assert blue == pytest.approx((0.5 * rest + 50.0 * zenith) / rest, rel=1e-4)


def test_one_learned_light_is_told_with_its_colour_and_what_settles_it():
    told = note()
    assert told is not None
    for part in ("sky 2.00 : 1 : 0.62", "--grey-card", "--known-light", "matters"):
        assert part in told
    assert "Several" not in told


def test_learned_lights_do_not_settle_each_other_and_turned_ones_are_one():
    told = note(("a", "b"))
    assert told is not None
    assert "a 2.00 : 1 : 0.62, b 3.00 : 1 : 0.62" in told
    assert "Several lights that are learned do not settle it" in told
    turned = note(("a", "b"), rotations_deg=(0.0, 90.0))
    assert turned is not None
    assert "b 3.00" not in turned


def test_a_card_or_a_known_light_settles_it():
    assert note(grey_card=True) is None
    assert note(("a", "b"), known_lights=("b",)) is None

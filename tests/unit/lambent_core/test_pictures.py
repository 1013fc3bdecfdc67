"""Orders of pictures: their settings, and what gives two pictures one name."""

import pytest
from lambent_core import pictures


def test_every_setting_says_what_it_does():
    """The options of commands and the description of the interface show it."""
    for model in (pictures.RenderSettings, pictures.EnvironmentInput):
        for name, field in model.model_fields.items():
            assert field.description, name
            assert field.description.endswith("."), name


def test_whole_numbers_may_come_from_json_and_from_arrays():
    class Number:
        def __index__(self):
            return 3

    assert pictures.RenderSettings(spp=4.0, seed=Number()).model_dump(include={"spp", "seed"}) == {
        "spp": 4,
        "seed": 3,
    }


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({}, None),
        ({"assets": [{"bundle_id": "a"}, {"bundle_id": "b", "name": "A"}]}, "/assets/1/name"),
        ({"qualities": [{}, {"name": "refined", "spp": 9}]}, "/qualities/1/name"),
        ({"qualities": [{}, {"spp": 9, "name": "b"}], "output": {"path": "{camera}"}}, "/output/path"),
    ],
)
def test_what_gives_two_pictures_one_name_is_pointed_at(changes, place):
    body = {
        "assets": [{"bundle_id": "a"}],
        "environments": [{"environment_id": "e"}],
        "cameras": [{"all_views": True}],
    }
    spec = pictures.RenderSpec.model_validate(body | changes)
    assert [pointer for pointer, _ in pictures.clashes(spec)] == ([place] if place else [])


def test_an_order_is_the_same_after_its_json():
    body = {
        "assets": [{"bundle_id": "a"}],
        "environments": [{"environment_id": "e", "rotate_deg": 4.0}],
        "cameras": [{"turntable": 2, "elevation_deg": 0.0}, {"views": ["x"]}],
    }
    spec = pictures.RenderSpec.model_validate(body)
    assert pictures.RenderSpec.model_validate_json(spec.model_dump_json()) == spec

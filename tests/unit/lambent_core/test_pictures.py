"""What pictures are to be made, against the messages that carry it."""

import pytest
from lambent_core import pictures
from lambent_proto.v1 import render_pb2

MESSAGES = render_pb2.DESCRIPTOR.message_types_by_name
NOT_ORDERED = {"RenderTask", "RenderFailure"}


@pytest.mark.parametrize("name", sorted(set(MESSAGES) - NOT_ORDERED))
def test_a_model_and_its_message_have_the_same_fields(name):
    assert set(getattr(pictures, name).model_fields) == set(MESSAGES[name].fields_by_name)


def test_the_settings_of_a_picture_are_those_of_the_message_but_for_their_name():
    fields = set(pictures.RenderSettings.model_fields)
    assert fields == set(MESSAGES["RenderQuality"].fields_by_name) - {"name"}


def test_every_setting_says_what_it_does():
    """The options of commands and the description of the interface show it."""
    for name, field in pictures.RenderSettings.model_fields.items():
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

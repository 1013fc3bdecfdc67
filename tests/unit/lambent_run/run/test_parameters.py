"""The parameters of an order are read once; what is not one of them is a setting of the method."""

import json
import subprocess
import sys

import pytest
from lambent_core.errors import UsageError
from lambent_run.run.parameters import JobParameters

CORRECTIONS = {"version": 1, "corrections": [{"frame": "a", "label": "object", "box": [1, 2, 3, 4]}]}


def test_every_parameter_has_its_type_and_the_rest_are_settings():
    found = JobParameters.of(
        {
            "lights": "sun, moon,",
            "known_lights": "sun=a.hdr,b.exr",
            "layout": "colmap",
            "masks": "none",
            "light_fixed_to": "camera",
            "corrections": json.dumps(CORRECTIONS),
            "grey_card": "a.png:3,4,10,8:0.5",
            "stage_one.num_rays": "64",
            "settings": "x",
        }
    )
    assert found.lights == ("sun", "moon")
    assert found.known_lights == ("sun=a.hdr", "b.exr")
    assert (found.layout, found.masks, found.light_fixed_to) == ("colmap", "none", "camera")
    assert [each.points for each in found.corrections] == [((1.0, 2.0), (3.0, 4.0))]
    assert found.grey_card is not None
    assert found.grey_card.reflectance == 0.5
    assert found.settings == {"stage_one.num_rays": "64", "settings": "x"}


def test_an_empty_text_is_a_parameter_that_was_left_out():
    names = ("lights", "known_lights", "layout", "masks", "light_fixed_to", "corrections", "grey_card")
    assert JobParameters.of(dict.fromkeys(names, "")) == JobParameters()


@pytest.mark.parametrize(
    ("name", "text", "code"),
    [
        ("light_fixed_to", "flash", r"light\.fixed_to_unknown"),
        ("corrections", "{", r"config\.corrections_invalid"),
        ("corrections", "[]", r"config\.corrections_invalid"),
        ("grey_card", "a.png", r"grey_card\.syntax"),
    ],
)
def test_a_parameter_that_cannot_be_read_is_refused(name, text, code):
    with pytest.raises(UsageError, match=code):
        JobParameters.of({name: text})


def test_parameters_of_a_preparation_are_read_without_torch_and_pictures():
    program = (
        "import sys; from lambent_run.run.parameters import JobParameters; "
        "JobParameters.of({'lights': 'a', 'masks': 'none'}); "
        "sys.exit(bool({'torch', 'cv2'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0

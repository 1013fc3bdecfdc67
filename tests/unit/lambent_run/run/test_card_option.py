"""The option for a grey card is read, and mistakes are named before anything is trained."""

import numpy as np
import pytest
from lambent_core.errors import UsageError
from lambent_run.run.card_option import REFLECTANCE, GreyCard, look_for_photograph, parse_grey_card
from PIL import Image


def refusal(code: str, text: str = "") -> object:
    return pytest.raises(UsageError, match=rf"(?s)grey_card\.{code}: .*{text}")


def test_a_card_is_a_photograph_a_box_and_perhaps_a_reflectance():
    assert parse_grey_card("IMG_0012.jpg:820,1140,160,90") == GreyCard(
        "IMG_0012.jpg", (820.0, 1140.0, 160.0, 90.0), REFLECTANCE
    )
    assert parse_grey_card(" a b:c/x.png:1.5,0,2,3.25:0.5 ") == GreyCard(
        "a b:c/x.png", (1.5, 0.0, 2.0, 3.25), 0.5
    )
    assert REFLECTANCE == 0.18


@pytest.mark.parametrize("text", ["x.jpg:10,20,30,40:0.9", "a/b.jpg:0.5,1.25,3,4"])
def test_what_is_written_down_is_read_as_the_same_card(text):
    assert parse_grey_card(str(parse_grey_card(text))) == parse_grey_card(text)
    assert str(GreyCard("x.jpg", (1234567.0, 1.0, 2.0, 3.0))) == "x.jpg:1234567,1,2,3:0.18"


@pytest.mark.parametrize(
    "text",
    [
        "x.jpg",
        "x.jpg:1,2,3",
        "x.jpg:1,2,3,4,5",
        "x.jpg:-1,2,3,4",
        "x.jpg:1,2,3,4:",
        ":1,2,3,4",
        "x:a,b,c,d",
        "",
    ],
)
def test_other_text_is_refused_with_an_example(text):
    with refusal("syntax", "IMG_0012.jpg:820,1140,160,90:0.18"):
        parse_grey_card(text)


@pytest.mark.parametrize("box", ["1,2,0,4", "1,2,3,0", "1,2,0.0,4"])
def test_a_box_without_area_is_refused(box):
    with refusal("box_empty"):
        parse_grey_card(f"x.jpg:{box}")


@pytest.mark.parametrize("reflectance", ["0", "0.01", "1.01", "18"])
def test_a_reflectance_that_no_card_has_is_refused(reflectance):
    with refusal("reflectance", "0.18"):
        parse_grey_card(f"x.jpg:1,2,3,4:{reflectance}")


@pytest.fixture
def scene(tmp_path):
    for name, size in (("images/a.png", (40, 30)), ("other/b.png", (40, 30))):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        Image.fromarray(np.zeros((size[1], size[0], 3), np.uint8)).save(tmp_path / name)
    return tmp_path


def test_a_photograph_is_found_by_its_path_or_its_name(scene):
    for name in ("a.png", "images/a.png", "b.png"):
        look_for_photograph(scene, parse_grey_card(f"{name}:0,0,40,30"))
    for name in ("c.png", "mages/a.png", "other/a.png"):
        with refusal("photograph_missing", name):
            look_for_photograph(scene, parse_grey_card(f"{name}:0,0,40,30"))
    with refusal("photograph_missing"):
        look_for_photograph(scene / "nowhere", parse_grey_card("a.png:0,0,4,3"))


def test_a_box_that_fits_neither_lying_nor_upright_is_refused_with_the_size(scene):
    look_for_photograph(scene, parse_grey_card("a.png:0,35,30,5"))
    for box in ("0,0,41,30", "35,35,1,1", "31,20,9,11"):
        with refusal("box_outside", "40 x 30"):
            look_for_photograph(scene, parse_grey_card(f"a.png:{box}"))


def test_a_damaged_photograph_is_left_to_the_check_of_the_capture(scene):
    (scene / "images" / "a.png").write_bytes(b"no picture")
    look_for_photograph(scene, parse_grey_card("a.png:0,0,4,3"))

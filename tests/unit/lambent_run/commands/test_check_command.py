"""`lambent check` looks at a grey card too, before anything is trained."""

import pytest
import typer
from lambent_capture.checks import check as capture_check
from lambent_capture.checks.check_result import CaptureCheck
from lambent_proto.v1 import scene_pb2
from lambent_run.commands.check import check
from support.captures import REFERENCES

SCENE = REFERENCES / "scenes" / "tensoir_synthetic"
PHOTOGRAPH = "train_000/rgba_venice_sunset_120.png"


@pytest.fixture(autouse=True)
def looked_at(monkeypatch):
    """Return a report on a capture that can be used, without looking at it; the test may change it."""
    report = scene_pb2.SceneReport(usable=True, layout="tensoir_synthetic")
    monkeypatch.setattr(capture_check, "check_capture", lambda *given: CaptureCheck(report=report))
    return report


def test_a_card_on_the_object_is_fine_under_any_of_the_captures_lights(capsys):
    check(SCENE, grey_card=f"{PHOTOGRAPH}:52,62,24,20")
    assert "can be used" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("card", "code"),
    [
        (f"{PHOTOGRAPH}:0,0,20,20", "outside_mask"),
        (f"{PHOTOGRAPH}:120,120,20,20", "box_outside"),
        ("train_000/rgba_moon.png:1,1,2,2", "photograph_missing"),
        ("train_000", "syntax"),
    ],
)
def test_a_card_that_cannot_be_used_is_a_usage_error_that_names_it(capsys, card, code):
    with pytest.raises(typer.Exit) as caught:
        check(SCENE, grey_card=card)
    assert caught.value.exit_code == 2
    assert f"grey_card.{code}" in capsys.readouterr().err


def test_of_photographs_without_cameras_only_the_file_is_looked_for(looked_at):
    looked_at.layout = "photographs"
    check(SCENE, grey_card=f"{PHOTOGRAPH}:0,0,20,20")
    with pytest.raises(typer.Exit):
        check(SCENE, grey_card="train_000/rgba_moon.png:1,1,2,2")


def test_a_card_in_a_capture_with_cameras_needs_torch_and_says_so_after_the_check(capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(typer.Exit) as caught:
        check(SCENE, grey_card=f"{PHOTOGRAPH}:52,62,24,20")
    assert caught.value.exit_code == 2
    told = capsys.readouterr()
    assert "can be used" in told.out
    assert "cli.missing_extra" in told.err
    assert "lambent[worker]" in told.err

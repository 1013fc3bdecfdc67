"""view: which viewer it starts, and what it says where there is none."""

import sys

import numpy as np
import pytest
from lambent.cli import app
from lambent.desktop import opengl
from lambent.errors import LambentError
from lambent_relight import write_environment
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere


@pytest.fixture
def bundle(tmp_path):
    return write_analytic_bundle(tmp_path / "ball", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))


@pytest.fixture
def sky(tmp_path):
    write_environment(tmp_path / "sky.exr", np.ones((4, 8, 3), np.float32))
    return tmp_path / "sky.exr"


def test_the_web_viewer_gets_its_input_and_what_has_no_effect_there_is_named(monkeypatch, tmp_path, capsys):
    calls = []
    monkeypatch.setattr("lambent.cli.web_view.view_in_browser", lambda *given: calls.append(given))
    words = ["view", str(tmp_path), "--env", "a.exr", "--channel", "albedo", "--env-axes", "mitsuba"]
    assert app.run(words) == 0
    ((bundle, environments, light, _),) = calls
    assert (bundle, [path.name for path in environments], light.axes) == (tmp_path, ["a.exr"], "mitsuba")
    error = capsys.readouterr().err
    assert "--channel has no effect without --desktop" in error
    assert "--split" not in error
    assert "--env-axes" not in error


def test_a_trial_that_is_killed_is_a_failure_too():
    trial = opengl.Trial([sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"])
    with pytest.raises(LambentError, match="exit status -11"):
        trial.require_success()


def test_without_a_display_or_the_package_the_command_says_what_to_do(monkeypatch, bundle, sky, capsys):
    words = ["view", str(bundle), "--desktop", "--env", str(sky)]
    monkeypatch.setattr(opengl.platform, "system", lambda: "Linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert app.run(words) == 2
    assert "view.no_display" in capsys.readouterr().err
    monkeypatch.setattr(opengl, "find_spec", lambda name: None)
    assert app.run(words) == 2
    assert "lambent[viewer]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--channel", "warmth"), "cli.bad_choice"),
        (("--tone-mapping", "filmic"), "cli.bad_choice"),
        (("--background", "pink"), "cli.bad_choice"),
        (("--photograph", "x"), "view.no_photographs"),
        (("--env", "gone.hdr", "--env", "gone.hdr"), "environment.missing"),
    ],
)
def test_what_cannot_be_shown_exits_with_two_and_a_code(bundle, sky, tmp_path, capsys, words, code):
    command = ["view", str(bundle), "--desktop", "--screenshot", str(tmp_path / "x.png"), *words]
    assert app.run(command + ([] if "--env" in words else ["--env", str(sky)])) == 2
    assert code in capsys.readouterr().err

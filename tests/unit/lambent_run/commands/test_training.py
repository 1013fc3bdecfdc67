"""Commands end with the documented exit codes and a message, not a traceback."""

import json
import os
import signal
import subprocess
import sys

import pytest
import typer
from flashcache.config import with_overrides
from flashcache.errors import ConfigError, TrainingError
from flashcache.presets import quick
from lambent_core.errors import SceneRefusedError, Stopped, UsageError, WorkerError
from lambent_proto.v1 import scene_pb2
from lambent_run.commands import check as check_cli
from lambent_run.commands import training as cli
from lambent_run.run import pipeline
from lambent_run.run.prepare import preparation_of
from lambent_run.run.spec import keep_run
from support.captures import write_tensoir
from typer.testing import CliRunner

RUNNER = CliRunner()


def call(command, *arguments):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(command)
    return RUNNER.invoke(app, [str(argument) for argument in arguments])


def test_check_of_a_good_scene_ends_with_zero(tmp_path):
    result = call(check_cli.check, write_tensoir(tmp_path))
    assert result.exit_code == 0
    assert "can be used: tensoir_synthetic, 5 training and 2 test views" in result.stdout


def test_check_of_a_bad_scene_ends_with_four_and_says_why(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "train_000" / "metadata.json").unlink()
    result = call(check_cli.check, folder)
    assert result.exit_code == 4
    assert "error: scene.camera_missing" in result.stdout
    assert "Traceback" not in result.output


def test_check_writes_the_report_as_json(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "train_000" / "metadata.json").unlink()
    result = call(check_cli.check, folder, "--json")
    report = json.loads(result.stdout)
    assert result.exit_code == 4
    assert report["usable"] is False
    assert report["findings"][0]["subject"] == "train_000"
    assert report["figures"] is None


def test_check_writes_figures_and_a_page_where_it_is_told_to(tmp_path):
    result = call(check_cli.check, write_tensoir(tmp_path / "scene"), "-o", tmp_path / "out")
    assert result.exit_code == 0
    record = json.loads((tmp_path / "out" / "capture.json").read_text())
    assert [view["name"] for view in record["figures"]["views"]][:2] == ["test_000", "test_001"]
    page = (tmp_path / "out" / "capture.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 7
    assert "scene.views_few" in page


def test_an_unknown_layout_ends_with_two(tmp_path):
    result = call(check_cli.check, write_tensoir(tmp_path), "--layout", "polaroids")
    assert result.exit_code == 2
    assert "scene.layout_unknown" in result.stderr


REFUSED = scene_pb2.SceneReport(
    findings=[
        scene_pb2.Finding(code="scene.x", message="fix it", severity=scene_pb2.SEVERITY_ERROR),
        scene_pb2.Finding(code="scene.y", message="a note", severity=scene_pb2.SEVERITY_WARNING),
    ]
)


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (WorkerError("run.busy", "wait"), 1, "run.busy: wait"),
        (UsageError("run.x", "no"), 2, "run.x: no"),
        (Stopped(), 130, "the same command continues"),
        (SceneRefusedError(REFUSED), 4, "1 problem(s) to fix first:\n  scene.x: fix it"),
        (ConfigError("too small"), 2, "config.invalid: too small"),
        (TrainingError("diverged"), 1, "training.failed: diverged"),
    ],
)
def test_each_kind_of_error_has_its_exit_code(error, code, text):
    def command() -> None:
        raise error

    result = call(cli.reporting_errors(command))
    assert result.exit_code == code
    assert text in result.stderr


def test_errors_are_json_objects_where_json_was_asked_for():
    def command(as_json: cli.Json = False) -> None:
        raise SceneRefusedError(REFUSED)

    result = call(cli.reporting_errors(command), "--json")
    fault = json.loads(result.stdout)["error"]
    assert result.exit_code == 4
    assert fault["code"] == "scene.refused"
    assert [problem["message"] for problem in fault["errors"]] == ["scene.x: fix it", "scene.y: a note"]


def test_a_mistake_of_ours_keeps_its_traceback():
    def command() -> None:
        raise ZeroDivisionError

    result = call(cli.reporting_errors(command))
    assert isinstance(result.exception, ZeroDivisionError)


def test_settings_are_split_at_the_first_equals_sign():
    assert cli.parse_settings(["a.b=1", "c=x=y"]) == {"a.b": "1", "c": "x=y"}


@pytest.mark.parametrize("item", ["a", "=1", ""])
def test_a_setting_without_key_or_value_is_a_usage_error(item):
    with pytest.raises(UsageError, match=r"config\.setting_syntax"):
        cli.parse_settings([item])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_asks_to_stop_and_the_second_ends_at_once(number):
    asked = []
    before = signal.getsignal(number)
    with cli.stopping_on_signals(lambda: asked.append(True)):
        os.kill(os.getpid(), number)
        assert asked == [True]
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) == before


def test_loading_the_commands_imports_no_torch():
    script = (
        "import sys, lambent_run.commands.training, lambent_run.commands.check; "
        "print([m for m in ('torch', 'numpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_photographs_that_are_only_prepared_are_trained_with_the_options_preset_on_resume(
    tmp_path, monkeypatch
):
    scene, run = write_tensoir(tmp_path / "scene"), tmp_path / "run"
    keep_run(run, preparation_of(scene, run), "cpu")
    begun = []
    monkeypatch.setattr(pipeline, "run_pipeline", lambda spec, *rest, **options: begun.append(spec))
    options = ("--preset", "quick", "--set", "stage_one.num_steps=7")
    result = call(cli.train, scene, "-o", run, "--resume", "--json", *options)
    assert result.exit_code == 0, result.output
    (spec,) = begun
    assert spec.preset == "quick"
    assert spec.config == with_overrides(quick(), {"stage_one.num_steps": "7"})

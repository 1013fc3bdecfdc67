"""The terminal tells stage, step, time to go and PSNR; scripts get JSON lines."""

import io
import json

import pytest
from lambent_proto.v1.job_pb2 import Progress
from lambent_run.console_reporter import ConsoleReporter, describe_progress, format_duration


def progress(stage="cache", step=300):
    return Progress(
        stage=stage,
        step=step,
        num_steps=3000,
        fraction=0.04,
        eta_s=205.0,
        steps_per_s=25.0,
        loss=0.01,
        psnr=24.12,
    )


def test_plain_lines_are_written_when_nobody_watches(tmp_path):
    error = io.StringIO()
    with ConsoleReporter(tmp_path, error=error) as reporter:
        reporter.progress(progress())
    line = error.getvalue()
    assert line == (
        "training the radiance cache: 4 % of the job, step 300/3000, 3 min 25 s to go, PSNR 24.1 dB\n"
    )


def test_plain_lines_are_thinned_but_stages_begin_and_end_visibly(tmp_path):
    error = io.StringIO()
    with ConsoleReporter(tmp_path, error=error) as reporter:
        for step in (1, 2, 3, 3000):
            reporter.progress(progress(step=step))
        reporter.progress(progress("joint", 1))
    lines = error.getvalue().splitlines()
    assert [line.split("step ")[1].split("/")[0] for line in lines] == ["1", "3000", "1"]


def test_json_lines_go_to_standard_output_and_nothing_else_does(tmp_path, capsys):
    error = io.StringIO()
    with ConsoleReporter(tmp_path, as_json=True, error=error) as reporter:
        reporter.progress(progress())
        reporter.finding("scene.no_mask", "cut it out")
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["event"] for line in lines] == ["progress", "finding"]
    assert lines[0]["psnr"] == 24.12
    assert error.getvalue() == ""


def test_a_terminal_gets_a_bar(tmp_path):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    error = Terminal()
    with ConsoleReporter(tmp_path, error=error) as reporter:
        reporter.progress(progress())
        reporter.finding("scene.no_mask", "[bold]cut[/bold] it out")
    assert "training the radiance cache" in error.getvalue()
    assert "[bold]cut[/bold] it out" in error.getvalue()


def test_everything_is_kept_in_the_run_folder(tmp_path):
    with ConsoleReporter(tmp_path, error=io.StringIO()) as reporter:
        reporter.progress(progress())
        reporter.preview("joint", b"png")
        reporter.checkpoint("joint", 5, tmp_path)
        reporter.artifact("report.html", tmp_path / "report.html")
        reporter.log("step.started", stage="joint")
    events = [json.loads(line)["event"] for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert events == ["progress", "preview", "checkpoint", "artifact", "step.started"]
    assert (tmp_path / "previews" / "joint.png").read_bytes() == b"png"


def test_without_a_run_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with ConsoleReporter(error=io.StringIO()) as reporter:
        reporter.preview("joint", b"png")
        reporter.log("step.started")
    assert not list(tmp_path.iterdir())


def test_a_stop_can_be_asked_for():
    reporter = ConsoleReporter(error=io.StringIO())
    assert not reporter.should_stop()
    reporter.request_stop()
    assert reporter.should_stop()


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min 0 s"),
        (205, "3 min 25 s"),
        (7500, "2 h 5 min"),
        (-1, "0 s"),
    ],
)
def test_durations_are_as_coarse_as_useful(seconds, words):
    assert format_duration(seconds) == words


def test_what_is_unknown_is_left_out():
    assert describe_progress(Progress(num_steps=1)) == "started"
    assert describe_progress(Progress(step=3, num_steps=10)) == "step 3/10"

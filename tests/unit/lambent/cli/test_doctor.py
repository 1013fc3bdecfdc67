"""doctor: every verdict with advice where there is something to do."""

import json

import pytest
from lambent.cli import app, doctor
from lambent.cli.doctor import GIB


def test_the_report_has_one_line_per_check_and_machine_readable_rows(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(doctor, "check_gpu", lambda: doctor.Check(name="gpu", verdict="ok", shows="none"))
    monkeypatch.delenv("LAMBENT_URL", raising=False)
    assert app.run(["doctor", "--data", str(tmp_path), "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    names = [row["name"] for row in rows]
    assert names[0] == "python"
    assert names[-1] == "server"
    assert rows[-1]["verdict"] == "warn"
    assert "lambent serve" in rows[-1]["advice"]
    assert all(row["advice"] for row in rows if row["verdict"] != "ok")


def test_something_that_must_be_fixed_exits_with_one(monkeypatch, capsys, tmp_path):
    bad = doctor.Check(name="disk", verdict="fail", shows="full", advice="free some")
    monkeypatch.setattr(doctor, "examine", lambda url, data: iter([bad]))
    assert app.run(["doctor", "--data", str(tmp_path)]) == 1
    assert "-> free some" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("check", "verdict"),
    [
        (doctor.check_python((3, 10, 9)), "fail"),
        (doctor.check_python((3, 12, 0)), "ok"),
        (doctor.check_cores(1), "warn"),
        (doctor.check_cores(2), "ok"),
        (doctor.check_memory(2 * GIB), "warn"),
        (doctor.check_memory(8 * GIB), "ok"),
        (doctor.check_ffmpeg(None), "warn"),
        (doctor.check_ffmpeg("/usr/bin/ffmpeg"), "ok"),
        (doctor.check_gl(lambda name: "libGL.so.1" if name == "GL" else None), "ok"),
    ],
)
def test_verdicts_follow_what_was_found(check, verdict):
    assert check.verdict == verdict
    assert bool(check.advice) == (verdict != "ok")


def test_a_full_disk_fails(monkeypatch, tmp_path):
    monkeypatch.setattr("shutil.disk_usage", lambda path: type("Usage", (), {"free": GIB // 2}))
    assert doctor.check_disk(tmp_path / "not" / "there").verdict == "fail"


def test_a_torch_that_crashes_is_reported_and_not_fatal():
    check = doctor.check_gpu("import os; os.abort()")
    assert check.verdict == "fail"
    assert "does not start" in check.shows


def test_the_gpu_answer_is_read():
    check = doctor.check_gpu("print('cuda|12.8|NVIDIA X|25769803776')")
    assert check.verdict == "ok"
    assert "NVIDIA X, 24.0 GiB, CUDA 12.8" in check.shows


def test_the_packages_of_the_client_are_all_named_in_its_extra():
    assert doctor.missing_packages("client") == []
    assert doctor.missing_packages("no_such_extra") == []


def test_a_missing_package_is_named(monkeypatch):
    from importlib.metadata import PackageNotFoundError

    def nothing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(doctor, "version", nothing)
    check = doctor.check_packages("worker")
    assert check.verdict == "warn"
    assert "torch" in check.shows
    assert "pictures from bundles" in doctor.check_packages("client").advice

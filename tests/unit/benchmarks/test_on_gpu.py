"""The order of what is measured on a GPU, and what is left for another call."""

import argparse
import json
import subprocess
from pathlib import Path

import pytest

from benchmarks import on_gpu


def options(out: Path, *words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--out", type=Path)
    on_gpu.add_options(parser)
    return parser.parse_args(["SUITE/cowcrate", "--device", "cpu", "-o", str(out), *words])


def keep(out: Path, name: str, **result: object) -> None:
    (out / "pieces").mkdir(parents=True, exist_ok=True)
    made = {"kind": "tests", "machine": {}, "seconds": 1.0}
    tests = {"command": "pytest", "code": 0, "summary": "passed", "tail": ""}
    (out / "pieces" / f"{name}.json").write_text(json.dumps(made | {"result": tests | result}))


@pytest.fixture
def started(monkeypatch) -> list[str]:
    """Return the pieces that are started in the test; each is finished at once, only `steps` fails."""
    names: list[str] = []

    def run(command, **_):
        name, out = command[command.index("--only") + 1], Path(command[command.index("-o") + 1])
        names.append(name)
        if name != "steps":
            keep(out, name)
        return subprocess.CompletedProcess(command, int(name == "steps"))

    monkeypatch.setattr(on_gpu.subprocess, "run", run)
    return names


def test_pieces_come_in_the_order_of_worth(tmp_path):
    names = [piece.name for piece in on_gpu.pieces_of(options(tmp_path, "--large", "SUITE/bunny"))]
    assert names == [
        *("tests", "kernels", "steps", "rays"),
        *("1_standard_cowcrate", "2_standard_bunny", "3_paper_tensoir_cowcrate"),
    ]


def test_what_is_measured_is_left_out_and_what_fails_stops_nothing(tmp_path, started):
    keep(tmp_path, "kernels")
    keep(tmp_path, "1_standard_cowcrate", finished=False)
    result = on_gpu.main(options(tmp_path))
    assert started == ["tests", "steps", "rays", "1_standard_cowcrate", "3_paper_tensoir_cowcrate"]
    assert result == {"left": ["steps"], "failed": ["steps"]}
    assert "Not measured, or not to the end: steps." in (tmp_path / "page.md").read_text()


def test_without_time_nothing_is_begun(tmp_path, started):
    result = on_gpu.main(options(tmp_path, "--seconds", "10", "--pieces", "tests", "rays"))
    assert started == []
    assert result == {"left": ["tests", "rays"], "failed": []}


def test_a_piece_is_measured_and_its_seconds_add_up(tmp_path):
    piece = on_gpu.Piece("made_up", "tests", 0.0, lambda arguments, seconds: {"seconds": seconds})
    keep(tmp_path, "made_up", finished=False)
    on_gpu.measure_one(piece, options(tmp_path, "--seconds", "25"))
    record = on_gpu.record_of(tmp_path, "made_up")
    assert record["result"] == {"seconds": 25.0}
    assert record["seconds"] >= 1.0
    assert on_gpu.is_done(record)


@pytest.mark.slow
def test_tests_are_run_and_their_outcome_is_kept(tmp_path):
    file = "tests/unit/flashcache/kernels/test_gpu_march.py"
    found = on_gpu.run_tests(options(tmp_path, "--tests", file), 60.0)
    assert found["code"] in (0, 5)
    assert found["command"].endswith(file)
    assert any(word in found["summary"] for word in ("skipped", "passed", "deselected"))

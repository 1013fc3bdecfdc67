"""A benchmark with real training, killed in the middle and run again."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import pytest
from lambent.cli import app
from lambent_relight.environment.maps import write_environment
from support.captures import REFERENCES

pytestmark = [pytest.mark.slow, pytest.mark.long, pytest.mark.timeout(900)]

SCENE = REFERENCES / "scenes" / "tensoir_synthetic"
SMALL = {
    "max_side": "16",
    "stage_one.num_steps": "6",
    "stage_one.num_rays": "64",
    "stage_two.num_steps": "4",
    "stage_two.num_rays": "32",
    "stage_two.warmup_steps": "2",
    "stage_two.distil.num_steps": "1",
}


@dataclass
class Made:
    """The results of starting the same benchmark twice."""

    out: Path
    first_results: dict[str, int]
    """Time of every result that existed when the first start was killed."""
    second: subprocess.CompletedProcess[str]

    def results(self) -> list[Path]:
        return sorted(self.out.glob("cells/*/result.json"))


def command(out: Path, maps: Path) -> list[str]:
    settings = [part for key, value in SMALL.items() for part in ("--set", f"{key}={value}")]
    return [
        *(sys.executable, "-m", "lambent", "benchmark", str(SCENE), "-o", str(out), "--preset", "tiny"),
        *("--ablations", "depth", "--environments", str(maps), "--repeats", "1"),
        *("--directions", "8", "--max-side", "16", "--views", "1", *settings),
    ]


def wait_for(condition, process: subprocess.Popen, seconds: float = 400.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, "the benchmark ended before it could be killed"
        assert time.monotonic() < deadline, "the benchmark took too long"
        time.sleep(0.05)


def children_of(out: Path) -> list[psutil.Process]:
    found = []
    for process in psutil.process_iter(["cmdline"]):
        line = process.info["cmdline"] or []
        if any(str(out) in part for part in line) and "lambent_run.benchmark.cell" in line:
            found.append(process)
    return found


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Kill a benchmark after its first result, wait until its processes have ended, and run it again."""
    folder = tmp_path_factory.mktemp("benchmark")
    out, maps = folder / "out", folder / "maps"
    maps.mkdir()
    write_environment(maps / "studio_small_05.exr", np.full((8, 16, 3), 0.5, dtype=np.float32))
    process = subprocess.Popen(command(out, maps), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(lambda: list(out.glob("cells/*/result.json")) and children_of(out), process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    psutil.wait_procs(children_of(out), timeout=120)
    assert not children_of(out), "a process outlived the benchmark that started it"
    first = {str(path): path.stat().st_mtime_ns for path in out.glob("cells/*/result.json")}
    second = subprocess.run(command(out, maps), capture_output=True, text=True, timeout=600, check=False)
    return Made(out, first, second)


def test_the_second_start_finishes_what_the_first_began(made):
    assert made.second.returncode == 0, made.second.stderr
    assert len(made.results()) == 2
    assert len(made.first_results) == 1


def test_what_the_first_start_finished_is_not_computed_again(made):
    for path, time_ns in made.first_results.items():
        assert Path(path).stat().st_mtime_ns == time_ns
    assert made.second.stderr.count(": reused") == 1 + len(made.first_results)


def test_all_ablations_start_from_the_same_stage_one(made):
    (shared,) = made.out.glob("stage_one/*/run/cache/step_0000006/model.safetensors")
    copies = list(made.out.glob("cells/*/run/cache/step_0000006/model.safetensors"))
    assert len(copies) == 2
    assert {path.stat().st_ino for path in copies} == {shared.stat().st_ino}
    logs = [path.read_text() for path in made.out.glob("cells/*/log.jsonl")]
    assert all('"step.reused"' in log for log in logs)
    assert not any('"stage": "cache", "step"' in log for log in logs)


def test_ablations_are_trained_and_rendered_differently(made):
    scores = {}
    for path in made.results():
        record = json.loads(path.read_text())
        rows = {row["name"]: row["value"] for row in record["report"]["metrics"]}
        scores[path.parent.name.split("-s0-")[1].split("-")[0]] = rows
    assert set(scores) == {"full", "depth"}
    assert len({rows["nvs/psnr"] for rows in scores.values()}) == 2
    assert all(np.isfinite(rows["relight_direct/psnr"]) for rows in scores.values())


def test_the_tables_are_written_and_printed(made):
    text = (made.out / "table.md").read_text()
    assert text.strip() in made.second.stdout
    assert "and one point at the median depth" in text
    assert "| k8 | supplement table 1 (d) | 34.778 | 30.059 | 3.355 |" in text
    record = json.loads((made.out / "table.json").read_text())
    assert {row["ablation"] for row in record["scenes"]} == {"full", "depth"}
    assert record["differences_to_full"]["depth"]["nvs/psnr"]["count"] == 1
    assert (made.out / "table.csv").read_text().startswith("scene,group,layout,lights,ablation,figure")


def test_a_folder_with_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("mine")
    write_environment(tmp_path / "maps" / "flat.exr", np.ones((2, 4, 3), dtype=np.float32))
    again = command(tmp_path, tmp_path / "maps")
    assert app.run(again[again.index("benchmark") :]) == 2
    assert "benchmark.folder_not_empty" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["maps", "notes.txt"]

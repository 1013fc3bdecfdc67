"""The page of measurements on a GPU."""

import math

from benchmarks.gpu_page import page
from benchmarks.gpu_timing import Spread

TIMES = Spread(median=2.0, least=1.5, largest=4.0, repeats=5)
MARK = {"stage": "cache", "step": 100, "seconds": 12.0, "psnr": 30.125, "normals": math.nan}


def record(kind: str, result: dict, **machine: str) -> dict:
    return {"kind": kind, "machine": {"gpu": "H200", **machine}, "seconds": 30.0, "result": result}


def lines_of(kind: str, result: dict) -> list[str]:
    return page({"piece": record(kind, result)}, "command").splitlines()


def test_a_page_of_a_processor_says_so():
    tests = {"command": "python -m pytest", "code": 0, "summary": "3 passed", "tail": "..."}
    made = record("tests", tests)
    assert page({"tests": made}, "command").startswith("# Measured on a GPU")
    del made["machine"]["gpu"]
    assert "nothing here is of a GPU" in page({"tests": made}, "command").splitlines()[0]


def test_failed_tests_stand_out():
    tests = {"command": "python -m pytest", "code": 1, "summary": "1 failed", "tail": "AssertionError"}
    assert any("**failed with status 1**; 1 failed" in line for line in lines_of("tests", tests))


def test_operations_are_compared_with_plain_torch_and_their_limit():
    row = {"name": "features", "bytes": 2**20, "row_bytes": 4e9, "limit_ms": 0.5, "kernel": TIMES}
    result = {"bytes_per_s": 4e12, "share": 1, "rows": [row | {"plain": TIMES | {"median": 10.0}}]}
    (found,) = [line for line in lines_of("kernels", result) if line.startswith("| features")]
    expected = "| features | 2 (1.5 to 4) | 10 (1.5 to 4) | 5.0 | 1 | 0.5 | 25 % | 2000 |"
    assert found == expected


def test_seconds_per_million_rays_stand_beside_the_papers():
    cache = {"rays": 2000, "forward": TIMES, "with gradient": TIMES, "paper_s": 0.128}
    lines = lines_of("rays", {"preset": "paper_tensoir", "fast cache": cache, "NeRF cache": cache})
    assert "| fast cache | 2000 | 1 (0.75 to 2) | 1 (0.75 to 2) | 0.128 |" in lines


def test_steps_are_shown_for_both_stages_with_what_takes_longest():
    profile = {"busy_ms": 1.5, "calls": 300.0, "largest": [{"name": "mm", "ms": 1.25, "calls": 40.0}]}
    found = {"rays": 16384, "times": TIMES, "peak_bytes": 2**31, "skipped": 0, "profile": profile}
    found |= {"problem": None}
    both = {"graphs": found | {"problem": "no capture"}, "eager": found, "plain torch": found}
    lines = lines_of("steps", {"preset": "p", "share": 1, "progress": 0.5, "one": both, "two": both})
    for way in both:
        assert f"| two | 16384 | {way} | 2 (1.5 to 4) | 1.5 | 300 | 2.00 | 0 |" in lines
    assert "Stage one gave its graphs up: no capture" in lines
    assert lines.count("| `mm` | 1.25 | 40 |") == 2


def test_a_training_shows_its_curve_and_once_finished_its_figures():
    result = {"preset": "standard", "scene": "cowcrate", "steps": {"cache": 100, "joint": 50}}
    result |= {"seconds": {"cache": 12.0}, "marks": [MARK], "finished": False, "figures": {}}
    lines = lines_of("training", result)
    assert "| cache | 100 | 12 | 30.12 |  |" in lines
    assert any("not finished" in line for line in lines)
    lines = lines_of("training", result | {"finished": True, "figures": {"albedo [dB]": 24.5}})
    assert "| albedo [dB] | 24.50 |" in lines

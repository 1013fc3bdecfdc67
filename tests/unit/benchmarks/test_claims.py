"""Claims of speed: medians, ratios, and what counts as worse."""

import json

import pytest

from benchmarks import __main__ as entry
from benchmarks.claims import claim, in_turns, table, worse


def claims_of(**ratios: float) -> list:
    return [claim(name, "ms", [1.0], [ratio]) for name, ratio in ratios.items()]


def test_a_claim_is_the_ratio_of_medians_with_the_spread_of_both():
    found = claim("grid", "ms", [1.0, 9.0, 2.0], [4.0, 3.0, 50.0])
    assert found["ratio"] == 2.0
    assert found["ours"] == {"median": 2.0, "low": 1.0, "high": 9.0, "count": 3}
    assert "| grid | 2 ms (1 to 9) | 4 ms (3 to 50) | 2.00 |" in table([found])


def test_turns_alternate_after_one_call_that_is_not_counted():
    calls = []
    ways = {name: lambda name=name: calls.append(name) for name in "ab"}
    found = in_turns(ways, 2, clock=lambda: float(len(calls)))
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert found == {"a": [1.0, 1.0], "b": [1.0, 1.0]}


@pytest.mark.parametrize(("now", "is_worse"), [(2.0, False), (1.75, False), (1.73, True), (9.0, False)])
def test_a_ratio_that_falls_by_more_than_fifteen_percent_is_worse(now, is_worse):
    assert bool(worse(claims_of(grid=2.0), claims_of(grid=now))) is is_worse


def test_a_claim_that_is_no_longer_measured_is_worse_and_a_new_one_is_not():
    assert worse(claims_of(grid=2.0), claims_of(march=2.0)) == ["grid: no longer measured"]
    assert worse([], claims_of(march=0.1)) == []


def test_the_comparison_of_two_files_fails_where_something_is_worse(tmp_path, capsys):
    files = []
    for name, ratio in (("old", 3.0), ("new", 1.0)):
        files.append(tmp_path / f"{name}.json")
        files[-1].write_text(json.dumps({"claims": claims_of(grid=ratio)}))
    assert entry.compare(files[1], files[0]) == 0
    assert "no ratio fell by more than 15 %" in capsys.readouterr().out
    assert entry.compare(*files) == 1
    assert "worse: grid: ratio 1.00, before 3.00" in capsys.readouterr().out

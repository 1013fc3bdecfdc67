"""The list of mistakes fits the sources, and the program that makes them tells what happened."""

from dataclasses import replace
from pathlib import Path

import mutants
import pytest
from support import passages

EVERYTHING = mutants.read_mutants()


def test_every_mutant_still_fits_its_file_and_its_nearest_tests_are_there():
    problems = []
    for mutant in EVERYTHING:
        try:
            assert mutant.text() != mutant.old
            assert mutant.targets()
        except ValueError as error:
            problems.append(str(error))
    assert problems == []


LIMIT = """
def limit(values):
    return [value for value in values if value < 3]


class Queue:
    def take(self, count):
        if self.ready and count > 0:
            return self.first(count, self.ready)
        return limit(self.values)
"""
WRAPPED = """
class Queue:
    def take(self, count):
        # Nothing is taken before it is ready.
        if self.ready and count > 0:
            return self.first(
                count,
                self.ready,  # which are all
            )
        return limit(self.values)
"""


def _placed(folder: Path, name: str, text: str) -> tuple[Path, ...]:
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_text(text)
    return (folder,)


@pytest.mark.parametrize(("name", "text"), [("old/queue.py", LIMIT), ("new/room/queue.py", WRAPPED)])
def test_a_passage_is_found_wherever_its_module_is_and_however_it_is_wrapped(
    tmp_path: Path, name: str, text: str
):
    path, *lines = passages.place_of("queue.Queue.take", _placed(tmp_path, name, text))
    changed = passages.replaced(
        path.read_text(), (lines[0], lines[1]), "self.first(count, self.ready)", "self.first(\n    0\n)"
    )
    assert "            return self.first(\n                0\n            )\n" in changed
    assert changed.endswith("        return limit(self.values)\n")


@pytest.mark.parametrize(
    ("symbol", "old", "said"),
    [
        ("queue.Queue.give", "count", "0 symbols are called"),
        ("queue.limit", "self.ready", "0 times"),
        ("queue.limit", "value", "3 times"),
        ("queue.Queue.take", "return 3", "0 times"),
    ],
)
def test_a_passage_that_is_gone_or_not_the_only_one_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, symbol: str, old: str, said: str
):
    mutant = replace(EVERYTHING[0], symbol=symbol, old=old, new="0")
    _placed(tmp_path, "a/queue.py", LIMIT)
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    monkeypatch.setattr(mutants, "SOURCES", ("",))
    with pytest.raises(ValueError, match=f"{said}.*name it anew"):
        mutant.text()


def test_a_name_that_two_modules_have_is_an_error(tmp_path: Path):
    _placed(tmp_path, "a/queue.py", LIMIT)
    with pytest.raises(ValueError, match=r"2 symbols are called queue\.limit"):
        passages.place_of("queue.limit", _placed(tmp_path, "b/queue.py", LIMIT))


def test_mutants_have_names_of_their_own_and_every_group_has_some():
    names = [mutant.name for mutant in EVERYTHING]
    assert len(set(names)) == len(names) >= 60
    assert {mutant.group for mutant in EVERYTHING} == set(mutants.GROUPS)


@pytest.mark.parametrize(
    ("code", "said", "outcome", "by"),
    [
        (0, "3 passed", mutants.SURVIVED, ""),
        (
            1,
            "FAILED tests/unit/test_a.py::test_b[1 2] - assert 0\n1 failed",
            mutants.CAUGHT,
            "test_b[1 2]",
        ),
        (1, "ERROR tests/unit/test_a.py::test_b - boom\n1 error", mutants.CAUGHT, "test_b"),
        (2, "ERROR tests/unit/test_a.py - ImportError\n1 error", mutants.UNDECIDED, "1 error"),
        (-1, "not finished after 5 s", mutants.UNDECIDED, "not finished after 5 s"),
    ],
)
def test_a_mutant_is_made_in_a_copy_only_and_judged_by_what_pytest_says(
    tmp_path, monkeypatch, code, said, outcome, by
):
    mutant = EVERYTHING[0]
    right = (mutants.ROOT / mutant.place).read_text()
    seen = []

    def run(self, targets, timeout_s, environment):
        seen.append((self.folder / mutant.place).read_text())
        return code, said

    monkeypatch.setattr(mutants, "SOURCES", ("worker",))
    monkeypatch.setattr(mutants.Copy, "run", run)
    copy = mutants.Copy(tmp_path / "copy")
    verdict = copy.judge(mutant, 5.0)
    assert (verdict.outcome, verdict.by.rpartition("::")[2]) == (outcome, by)
    assert seen == [mutant.text()]
    assert (copy.folder / mutant.place).read_text() == right == (mutants.ROOT / mutant.place).read_text()
    assert (copy.folder / "tests").resolve() == mutants.TESTS


def test_a_test_that_fails_without_a_mutant_too_has_noticed_nothing(monkeypatch):
    caught = mutants.Verdict(name="a", outcome=mutants.CAUGHT, by="tests/test_a.py::test_b", seconds=1.0)
    monkeypatch.setattr(mutants, "SOURCES", ("proto",))
    monkeypatch.setattr(mutants.Copy, "judge", lambda self, mutant, timeout_s: caught)
    for code, outcome in ((0, mutants.CAUGHT), (1, mutants.UNDECIDED)):
        monkeypatch.setattr(mutants.Copy, "run", lambda *given, code=code: (code, ""))
        (found,) = mutants.judge_all(EVERYTHING[:1], jobs=1, timeout_s=5.0)
        assert found.outcome == outcome


def test_the_table_of_a_page_keeps_what_was_not_made_again():
    first, second, third = EVERYTHING[:3]
    page = f"before\n{mutants.BEGIN}\n{mutants.END}\nafter\n"
    by = "tests/unit/test_a.py::test_the_sky_is_blue[1]"
    caught = [mutants.Verdict(name=first.name, outcome=mutants.CAUGHT, by=by, seconds=1.0)]
    survived = [mutants.Verdict(name=second.name, outcome=mutants.SURVIVED, by="", seconds=1.0)]
    once = mutants.updated(page, [first, second, third], caught)
    twice = mutants.updated(once, [first, second, third], survived)
    assert twice.startswith("before\n")
    assert twice.endswith("\nafter\n")
    rows = [line.split(" | ") for line in twice.splitlines() if line.startswith(f"| {first.group}")]
    assert [row[-1].strip(" |") for row in rows] == [
        "`test_a.py`: the sky is blue",
        "SURVIVED",
        "not run yet",
    ]
    with pytest.raises(ValueError, match="to write between"):
        mutants.updated("a page without markers", [first], [])

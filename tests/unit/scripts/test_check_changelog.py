from pathlib import Path

from check_changelog import faults


def test_a_fragment_that_towncrier_would_ignore_is_reported(tmp_path: Path):
    (tmp_path / "news.md").write_text("Something new.", encoding="utf-8")
    (problem,) = faults(tmp_path)
    assert "+topic.kind.md" in problem


def test_a_fragment_without_a_sentence_is_reported(tmp_path: Path):
    (tmp_path / "+relight.added.md").write_text("relight", encoding="utf-8")
    assert faults(tmp_path)


def test_a_well_named_sentence_is_accepted(tmp_path: Path):
    (tmp_path / "+relight.added.md").write_text("Bundles can be relit.\n", encoding="utf-8")
    assert faults(tmp_path) == []

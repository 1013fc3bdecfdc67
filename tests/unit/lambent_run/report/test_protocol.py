"""The protocol that a report prints is the one that the documentation explains."""

import re
from pathlib import Path

import pytest
from lambent_run.report import protocol

PAGE = Path(__file__).parents[4] / "docs" / "reference" / "protocol.md"
TEXT = re.sub(r"\s+", " ", PAGE.read_text(encoding="utf-8"))


@pytest.mark.parametrize("rule", protocol.SUMMARY)
def test_every_rule_of_the_summary_is_in_the_document_word_for_word(rule):
    assert rule in TEXT.replace("`", "")


def test_the_document_has_the_version_and_a_line_in_its_history():
    assert f"# The evaluation protocol, version {protocol.VERSION} " in TEXT
    assert f"- **{protocol.VERSION}**:" in TEXT

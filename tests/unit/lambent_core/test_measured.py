"""Measured figures in words, and that nothing else formats them in findings, reports and pages."""

import ast
import math
import re
from pathlib import Path

import lambent_run
import pytest
from lambent_core.measured import NOT_USABLE, is_usable, measured, significant

WORKER = Path(lambent_run.__file__).parents[1]
SAYING = sorted(
    path
    for room in ("capture/checks", "capture/poses", "capture/masks", "run/report", "run/run/tasks")
    for path in (WORKER / f"lambent_{room}").rglob("*.py")
    # Places in a drawing are not figures.
    if path.name != "plot.py"
)

assert {path.relative_to(WORKER).parts[1] for path in SAYING} == {"checks", "poses", "masks", "report", "run"}


def test_figures_are_rounded_as_asked():
    assert measured(0.4567, 2) == "0.46"
    assert measured(12.6) == "13"
    assert measured(0.25, 1, signed=True) == "+0.2"
    assert measured(-3.0, 1, signed=True) == "-3.0"
    assert significant(12.345, 3) == "12.3"
    assert measured(9.9e6) == "9900000"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 2.6e156, -1e8])
def test_what_nobody_can_have_measured_is_never_printed(value):
    assert not is_usable(value)
    assert measured(value, 2) == significant(value, 3) == NOT_USABLE


def raw_formats(source: str) -> list[str]:
    """Return the places of formatted fields whose format rounds a number."""
    fields = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FormattedValue)]
    found = []
    for field in fields:
        parts = field.format_spec.values if isinstance(field.format_spec, ast.JoinedStr) else []
        text = "".join(str(part.value) if isinstance(part, ast.Constant) else "0" for part in parts)
        if re.search(r"[feg%]$", text):
            found.append(f"{ast.unparse(field.value)}:{text} in line {field.lineno}")
    return found


def test_a_raw_format_would_be_found():
    assert raw_formats('f"{error:.1f} pixels"') == ["error:.1f in line 1"]
    assert raw_formats('f"{error:{width}.2e} and {name:8s} {count:d} {other}"') == ["error:0.2e in line 1"]


@pytest.mark.parametrize("path", SAYING, ids=lambda path: str(path.relative_to(WORKER)))
def test_every_figure_goes_through_the_formatter(path):
    assert raw_formats(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("path", sorted(WORKER.rglob("*.j2")), ids=lambda path: path.name)
def test_pages_format_figures_by_the_formatter_only(path):
    assert not re.findall(r"\|\s*format\(|\bround\b", path.read_text(encoding="utf-8"))

"""docs/method.md names functions and tests that exist."""

import importlib
import operator
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_ROW = re.compile(
    r"^\| (?P<equation>[^|]+) \| [^|]+ \| `(?P<code>[^`|]+)` \| `(?P<test>[^`|]+)` \|$", re.MULTILINE
)


def rows() -> list[tuple[str, str, str]]:
    text = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    return [(row["equation"], row["code"], row["test"]) for row in _ROW.finditer(text)]


def test_every_line_of_the_tables_is_understood():
    lines = (ROOT / "docs" / "method.md").read_text(encoding="utf-8").splitlines()
    wanted = [
        line for line in lines if line.startswith("| ") and not line.startswith(("| equation", "| ---"))
    ]
    assert len(wanted) == len(rows()) > 30


@pytest.mark.parametrize(("equation", "code"), [row[:2] for row in rows()])
def test_the_code_of_an_equation_exists(equation: str, code: str):
    file, name = code.split(":")
    module = importlib.import_module(file.removesuffix(".py").replace("/", "."))
    operator.attrgetter(name)(module)


@pytest.mark.parametrize("test", sorted({row[2] for row in rows()}))
def test_the_test_of_an_equation_exists(test: str):
    file, _, name = test.partition("::")
    assert f"\ndef {name}(" in (ROOT / file).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "named",
    [
        *(f"paper Eq. {number}" for number in (3, 5, 9, 11)),
        *(f"supplement Eq. {number}" for number in range(1, 11)),
        "supplement proof 3.1",
        "supplement proof 3.2",
    ],
)
def test_the_equations_and_proofs_of_the_paper_have_a_row(named: str):
    assert named in {equation for equation, _, _ in rows()}

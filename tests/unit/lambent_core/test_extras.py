"""The command that installs extras, wherever it is named."""

import re
import tomllib
from pathlib import Path

import pytest
from lambent_core.errors import pip_install

ROOT = Path(__file__).parents[3]
SOURCES = sorted(
    path
    for folder in ("client/python", "proto", "server", "worker")
    for path in (ROOT / folder).rglob("*.py")
    if path.parts[-2:] != ("lambent_core", "errors.py")
)
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").glob("*.ipynb")),
]
EXTRAS = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])


def test_the_command_names_the_extras_and_needs_no_escape_in_a_shell():
    assert pip_install("raw") == "pip install 'lambent[raw]'"
    assert pip_install("server", "worker") == "pip install 'lambent[server,worker]'"
    assert pip_install() == "pip install lambent"


def test_all_messages_name_the_same_command():
    other = [path.name for path in SOURCES if re.search(r"pip\s+install", path.read_text())]
    assert other == []


def test_messages_name_extras_that_exist():
    named = {
        extra
        for path in SOURCES
        for call in re.findall(r"pip_install\(([^()]*)\)", path.read_text())
        for extra in re.findall(r"[\"'](\w+)[\"']", call)
    }
    assert {"client", "raw", "rembg", "server", "worker"} <= named <= EXTRAS


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_no_page_takes_lambent_from_an_index_that_does_not_have_it(page):
    """Only extras of an installed Lambent are named without the wheel."""
    text = page.read_text()
    assert not re.search(r"pip install (?:-\S+ )*[\"']?lambent(?![\w\[-])", text)
    for extras in re.findall(r"pip install (?:-\S+ )*[\"']lambent\[([\w,]+)\]", text):
        assert set(extras.split(",")) <= EXTRAS


def test_pages_name_the_wheel_that_is_built():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    named = {name for page in PAGES for name in re.findall(r"lambent-([\d.]+)-py3", page.read_text())}
    assert named == {version}

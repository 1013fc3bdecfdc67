"""Every Python that our programs start looks for modules where they are installed, and nowhere else."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("server", "worker", "client/python")


def commands(source: str) -> list[list[str]]:
    """Return the words after the interpreter of each command in a module."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.List, ast.Tuple)) and node.elts:
            first, *rest = (ast.unparse(each).strip("'\"") for each in node.elts)
            if first == "sys.executable":
                found.append(rest)
    return found


def modules() -> list[str]:
    paths = (path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))
    return sorted(str(path.relative_to(ROOT)) for path in paths if "sys.executable" in path.read_text())


@pytest.mark.parametrize("module", modules())
def test_a_file_in_the_current_folder_is_no_module_of_a_child(module: str):
    """Without -P, `json.py` beside the photographs of a capture would run in place of the library's."""
    found = commands((ROOT / module).read_text())
    assert found
    assert [words[0] for words in found] == ["-P"] * len(found)


def test_a_command_without_it_would_be_found():
    assert commands('run([sys.executable, "-m", "x"], (sys.executable, "-P", *y))') == [
        ["-m", "x"],
        ["-P", "*y"],
    ]

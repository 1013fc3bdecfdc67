from itertools import pairwise
from pathlib import Path

import pytest
from check_functions import circle, imports, problems, tracked

PADDING = "\n" * 25


def function(lines: int = 3, parameters: int = 1, docstring: str = "") -> str:
    """Return a function of so many lines without its docstring, in a module that is not too small."""
    given = ", ".join(f"p{number}" for number in range(parameters))
    body = "".join(f"    x{number} = {number}\n" for number in range(lines - 1))
    return f"def f({given}):\n{docstring}{body}{PADDING}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (function(60, 8), ""),
        (function(61), "61 lines"),
        (function(60, docstring='    """One.\n\n    Two.\n    """\n'), ""),
        (function(parameters=9), "9 parameters"),
        ("class C:\n    def f(self, a, b, c, d, *, e, f, g, h):\n        pass\n" + PADDING, ""),
        ("x = 1\n", "1 lines, at least"),
    ],
)
def test_functions_are_short_and_take_little_and_modules_are_not_splinters(text: str, said: str):
    found = list(problems({"server/a/b.py": text}).values())
    assert bool(found) == bool(said)
    assert all(said in each for each in found)


def test_kernels_may_be_long_and_commands_have_many_options():
    assert problems({"worker/flashcache/kernels/cpu.py": function(90, 20)}) == {}
    assert problems({"client/python/lambent/cli/view.py": function(parameters=20)}) == {}
    assert problems({"client/python/lambent/cli/view.py": function(61)})


def test_this_file_is_among_the_tracked_ones():
    assert Path(__file__).resolve() in tracked("*.py")


def test_a_circle_of_imports_is_found_also_inside_of_functions():
    sources = {
        "worker/a/__init__.py": "from .b import f",
        "worker/a/b.py": "def f():\n    from a import c",
        "worker/a/c.py": "import a.d",
        "worker/a/d.py": "from a.b import f",
        "server/e.py": "import a.c, os",
    }
    graph = imports(sources)
    assert graph == {"a": {"a.b"}, "a.b": {"a.c"}, "a.c": {"a.d"}, "a.d": {"a.b"}, "e": {"a.c"}}
    ring = circle(graph)
    assert ring[0] == ring[-1]
    assert set(ring) == {"a.b", "a.c", "a.d"}
    assert all(other in graph[one] for one, other in pairwise(ring))
    assert circle(graph | {"a.d": set()}) == []

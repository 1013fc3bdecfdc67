"""Public names of the packages that programs import: all there, all typed."""

import ast
import importlib
import inspect
import re
import typing
from pathlib import Path

import lambent
import lambent_relight
import pytest
from lambent.client import Client

PACKAGES = [lambent, lambent_relight]


@pytest.mark.parametrize("package", PACKAGES)
def test_type_checkers_see_what_programs_get(package):
    """The imports for type checkers, the table by which names are found, and `__all__` are the same names."""
    tree = ast.parse(Path(package.__file__).read_text())
    (block,) = [
        node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    shown = {alias.name: statement.module for statement in block.body for alias in statement.names}
    homes = package._HOMES.items()
    own = package.__name__
    assert shown == {name: home if home.startswith("lambent") else f"{own}.{home}" for name, home in homes}
    assert set(package.__all__) - {"__version__"} == set(shown)
    for name in shown:
        assert getattr(package, name).__module__.startswith(("lambent.", "lambent_relight.", "lambent_core."))
    with pytest.raises(AttributeError):
        _ = package.nothing


@pytest.mark.parametrize(
    "name", ["lambent", "lambent_relight", "lambent_compute", "lambent_proto", "flashcache", "lambent_server"]
)
def test_packages_that_programs_import_say_that_they_have_types(name):
    package = importlib.import_module(name)
    assert (Path(package.__file__).parent / "py.typed").is_file()


def test_whatever_a_client_returns_has_a_public_name():
    given = [inspect.getsource(method) for _, method in inspect.getmembers(Client, inspect.isfunction)]
    returned = {
        word
        for source in given
        for answer in re.findall(r"\) -> ([^:]+):\n", source)
        for word in re.findall(r"\b[A-Z]\w+", answer)
    }
    assert {"Job", "Scene", "Share", "FetchedBundle"} <= returned
    known = {*dir(typing), "Path", "Iterator", "Mapping", "Sequence", "WebhookCalls", "T", "None"}
    assert returned - known <= set(lambent.__all__)

"""Fail for functions that are hard to read: more than 60 lines, or more than 8 parameters.

Decorators and docstrings do not count, nor do `self` and `cls`. A module of under 25 lines belongs to its
neighbour, unless it is a registry. Modules that import each other in a circle fail too, wherever in a module
the import is.
"""

import ast
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAX_LINES, MAX_PARAMETERS, MIN_MODULE = 60, 8, 25
FOLDERS = ("proto", "server", "worker", "client/python", "scripts", "benchmarks")
GENERATED = ("*_pb2.py", "*_pb2_grpc.py", "*/migrations/*")
REGISTRIES = ("__init__.py", "__main__.py")
KERNELS = {
    "worker/flashcache/kernels/*": "numba and Triton compile functions of arrays and numbers, not of objects",
    "worker/flashcache/polish/compiled_fit.py:*": "numba",
    "worker/lambent_asset/transport/transport_specular.py:_mirror": "numba",
    "client/python/lambent_compute/*": "numba; small matrix products are written out",
    "client/python/lambent_relight/*kernels.py:*": "numba",
    "client/python/lambent_relight/fused/*": "numba",
    "client/python/lambent_relight/baked/dominant_highlights.py:_glints": "numba",
}
COMMANDS = ("*/cli/*", "*/commands/*", "*/admin/*")
"""Where an option of a command is a parameter, as Typer has it."""


def problems_of(path: str, text: str) -> Iterator[tuple[str, str]]:
    """Yield the place of each function of a module that is too long or takes too much, and what is wrong."""
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        place = f"{path}:{node.name}"
        if any(fnmatch(place, pattern) for pattern in KERNELS):
            continue
        lines, parameters = length(node), count_parameters(node)
        if lines > MAX_LINES:
            yield place, f"{lines} lines, at most {MAX_LINES} are allowed; give its steps names"
        if parameters > MAX_PARAMETERS and not any(fnmatch(place, pattern) for pattern in COMMANDS):
            yield (
                place,
                f"{parameters} parameters, at most {MAX_PARAMETERS} are allowed; group those that belong",
            )


def length(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the lines of a function from its `def` on, without its docstring."""
    first, has_docstring = node.body[0], ast.get_docstring(node) is not None
    docstring = (first.end_lineno or 0) - first.lineno + 1 if has_docstring else 0
    return (node.end_lineno or 0) - node.lineno + 1 - docstring


def count_parameters(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of parameters, but for `self` and `cls`."""
    given = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
    return sum(each.arg not in ("self", "cls") for each in given)


def problems(sources: dict[str, str]) -> dict[str, str]:
    """Return what is wrong with modules, by the place of it."""
    wrong = {}
    for path, text in sources.items():
        wrong |= dict(problems_of(path, text))
        lines = len(text.splitlines())
        if lines < MIN_MODULE and not path.endswith(REGISTRIES):
            wrong[path] = f"{lines} lines, at least {MIN_MODULE} are expected; join it with its subject"
    return wrong


def imports(sources: dict[str, str]) -> dict[str, set[str]]:
    """Return the modules that each module imports, of these alone, by dotted names."""
    names = {}
    for path in sources:
        folder = next(each for each in FOLDERS if path.startswith(f"{each}/"))
        dotted = path.removeprefix(f"{folder}/").removesuffix(".py").replace("/", ".")
        names[path] = dotted.removesuffix(".__init__")
    known, graph = set(names.values()), {}
    for path, text in sources.items():
        name, wanted = names[path], set()
        package = name.split(".") if path.endswith("__init__.py") else name.split(".")[:-1]
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                wanted |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                above = package[: len(package) - node.level + 1] if node.level else []
                origin = ".".join([*above, *filter(None, [node.module])])
                parts = {f"{origin}.{alias.name}" for alias in node.names}
                wanted |= parts & known or {origin}
        graph[name] = (wanted & known) - {name}
    return graph


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Return modules of which each imports the next one, and the first is the last; none without a circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))
    return []


def tracked(*patterns: str) -> list[Path]:
    """Return the files matching these patterns that git tracks or does not ignore."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    listing = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [ROOT / line for line in listing.splitlines() if (ROOT / line).is_file()]


def main() -> int:
    """Print what is wrong; return the exit status."""
    paths = tracked(*(f"{folder}/*.py" for folder in FOLDERS))
    sources = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in paths}
    wrong = problems({p: t for p, t in sources.items() if not any(fnmatch(p, each) for each in GENERATED)})
    lines = [f"{place}: {wrong[place]}" for place in sorted(wrong)]
    if ring := circle(imports(sources)):
        lines.append(f"modules import each other in a circle: {' -> '.join(ring)}")
    print("\n".join(lines) or f"functions of {len(sources)} modules")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())

"""YAML (and so JSON) files with the line of everything in them, so that a message can say where."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from lambent.errors import UsageProblemError

MAX_BYTES = 4 << 20
_MAX_NODES = 200_000
_PLAIN = frozenset({"tag:yaml.org,2002:seq", "tag:yaml.org,2002:map"})
_ADVICE = "see docs/howto/batch.md for an example"


@dataclass(frozen=True, slots=True)
class Document:
    """The values of a file, and the line (from 1) of every place in it, by JSON pointer."""

    path: Path
    value: Any
    lines: dict[str, int] = field(default_factory=dict)

    def where(self, pointer: str) -> str:
        """Return "file:line" of a place, or of the nearest one around it that is in the file."""
        while pointer and pointer not in self.lines:
            pointer = pointer.rpartition("/")[0]
        return f"{self.path.name}:{self.lines.get(pointer, 1)}"


class _Loader(yaml.SafeLoader):
    """Plain values only, and numbers such as 1e-3, which YAML 1.1 takes for text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?[0-9][0-9_]*(\.[0-9_]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def load_document(path: Path) -> Document:
    """Return what a YAML file holds; raises `batch.manifest` with the line for one that cannot be read.

    Anchors and merge keys are followed as long as the result stays small; no tag makes anything but values.
    """
    if not path.is_file():
        raise UsageProblemError("batch.manifest", f"there is no file {path}", "check the path")
    if path.stat().st_size > MAX_BYTES:
        raise UsageProblemError("batch.manifest", f"{path} is above 4 MiB", "split the batch")
    try:
        loader = _Loader(path.read_text(encoding="utf-8"))
        node = loader.get_single_node()
        reader = _Reader(loader)
        return Document(path, None if node is None else reader.read(node, ""), reader.lines)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{path.name}:{mark.line + 1}" if mark else path.name
        what = error.problem or error.context or "it is no YAML"
        raise UsageProblemError("batch.manifest", f"{place}: {what}", _ADVICE) from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UsageProblemError("batch.manifest", f"{path.name}: {reason}", _ADVICE) from error


class _Reader:
    """Turns nodes into values and notes their lines."""

    def __init__(self, loader: _Loader) -> None:
        self._loader = loader
        self._num_nodes = 0
        self.lines: dict[str, int] = {}

    def read(self, node: yaml.Node, pointer: str) -> Any:
        """Return the value of a node."""
        self._num_nodes += 1
        if self._num_nodes > _MAX_NODES:
            raise yaml.YAMLError("more than 200000 values once its anchors are followed")
        self.lines.setdefault(pointer, node.start_mark.line + 1)
        if not isinstance(node, yaml.ScalarNode) and node.tag not in _PLAIN:
            raise yaml.MarkedYAMLError(problem=f"the tag {node.tag!r}", problem_mark=node.start_mark)
        if isinstance(node, yaml.SequenceNode):
            return [self.read(item, f"{pointer}/{index}") for index, item in enumerate(node.value)]
        if isinstance(node, yaml.MappingNode):
            self._refuse_doubles(node)
            self._loader.flatten_mapping(node)
            found = {}
            for key, item in node.value:
                name = self._loader.construct_object(key, deep=True)
                self.lines[f"{pointer}/{name}"] = key.start_mark.line + 1
                found[name] = self.read(item, f"{pointer}/{name}")
            return found
        return self._loader.construct_object(node)

    @staticmethod
    def _refuse_doubles(node: yaml.MappingNode) -> None:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="a name is expected", problem_mark=key.start_mark)
            if key.value in seen and key.tag != "tag:yaml.org,2002:merge":
                raise yaml.MarkedYAMLError(
                    problem=f"{key.value!r} is there twice", problem_mark=key.start_mark
                )
            seen.add(key.value)

"""YAML (and so JSON) files whose places have lines, so that a message can say where."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from lambent.errors import UsageProblemError

MAX_BYTES = 4 << 20
_MAX_VALUES = 200_000
_ADVICE = "see docs/howto/batch.md for an example"


@dataclass(frozen=True)
class Document:
    """The values of a file."""

    path: Path
    value: Any

    @cached_property
    def _marked(self) -> Any:
        return YAML(pure=True).load(self.path.read_text(encoding="utf-8"))

    def where(self, pointer: str) -> str:
        """Return "file:line" of a place, or of the nearest one around it that is in the file."""
        node, line = self._marked, 0
        for step in pointer.split("/")[1:]:
            try:
                in_list = isinstance(node, list)
                key = int(step) if in_list else step
                line = (node.lc.item if in_list else node.lc.key)(key)[0]
                node = node[key]
            except (AttributeError, LookupError, TypeError, ValueError):
                break
        return f"{self.path.name}:{line + 1}"


def load_document(path: Path) -> Document:
    """Return what a YAML file holds; raises `batch.manifest` with the line for one that cannot be read.

    Anchors and merge keys are followed as long as the result stays small; no tag makes anything but values.
    """
    if not path.is_file():
        raise UsageProblemError("batch.manifest", f"there is no file {path}", "check the path")
    if path.stat().st_size > MAX_BYTES:
        raise UsageProblemError("batch.manifest", f"{path} is above 4 MiB", "split the batch")
    try:
        value = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
        _require_small(value)
        return Document(path, value)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{path.name}:{mark.line + 1}" if mark else path.name
        what = error.problem or error.context or "it is not YAML"
        raise UsageProblemError("batch.manifest", f"{place}: {what}", _ADVICE) from error
    except (YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UsageProblemError("batch.manifest", f"{path.name}: {reason}", _ADVICE) from error


def _require_small(value: Any) -> None:
    """Raise `YAMLError` for too many values, as nested anchors give, and for names that are not text."""
    waiting, count = [value], 0
    while waiting:
        each = waiting.pop()
        count += 1
        if count > _MAX_VALUES:
            raise YAMLError("more than 200000 values once its anchors are followed")
        if isinstance(each, dict):
            for name in each:
                if not isinstance(name, str):
                    raise YAMLError(f"a name is expected, not {name!r}")
            waiting += each.values()
        elif isinstance(each, list):
            waiting += each

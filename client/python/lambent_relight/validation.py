"""Faults of a document or a setting in our words: the place, the expected value, and the found one.

A place is a JSON pointer into the document ("/assets/1/material").
"""

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from lambent_core.pictures import UNCLEAR
from pydantic import BaseModel, ValidationError

_SHOWN = 40
_Schema = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a document."""

    pointer: str
    message: str
    expected: str = ""
    """Description of a correct value, where a few words can give one."""


def problems_of(error: ValidationError, model: type[BaseModel], pointer: str = "") -> Iterator[Problem]:
    """Yield what `model` found wrong with the value at `pointer`, in the order of its fields."""
    schema = model.model_json_schema()
    for each in error.errors(include_url=False):
        steps, kind, value = each["loc"], each["type"], each["input"]
        parent, node = _at(schema, steps[:-1]), _at(schema, steps)
        if steps and isinstance(steps[-1], int) and "properties" not in node:
            steps = steps[:-1]  # a list of plain values is shown whole
        name = str(steps[-1]) if steps else ""
        place = pointer + "".join(f"/{step}" for step in steps)
        start = f"{name}: " if name and "properties" not in node else ""
        expected = _expected(node)
        if kind == "missing":
            yield Problem(place.rpartition("/")[0], f"{name} is missing", expected)
        elif kind == "extra_forbidden":
            yield Problem(place, f"there is no {shown(name)} here; {_hint(name, parent)}")
        elif kind in ("value_error", UNCLEAR):
            yield Problem(place, f"{start}{each['msg'].removeprefix('Value error, ')}")
        elif kind == "string_too_long":
            yield Problem(
                place, f"{start}at most {node['maxLength']} characters are expected, not {len(value)}"
            )
        elif kind in ("greater_than_equal", "less_than_equal") and math.isfinite(value):
            yield Problem(place, f"{start}{value} is not {_range(node)}", expected)
        else:
            yield Problem(place, f"{start}{expected} is expected, not {shown(value)}", expected)


def shown(value: Any) -> str:
    """Return a value as it is quoted in a message."""
    text = repr(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def _at(schema: _Schema, steps: tuple[int | str, ...]) -> _Schema:
    """Return the part of a JSON schema that describes the value at `steps`; empty where there is none."""
    node: Any = schema
    for step in (*steps, None):
        node = next((each for each in node.get("anyOf", ()) if each.get("type") != "null"), node)
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        if step is not None:
            node = (
                node.get("items", {}) if isinstance(step, int) else node.get("properties", {}).get(step, {})
            )
    return dict(node)


def _hint(name: str, parent: _Schema) -> str:
    known = sorted(parent.get("properties", ()))
    near = difflib.get_close_matches(name, known, 1)
    return f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"


def _expected(node: _Schema) -> str:
    choices = node.get("enum") or ([node["const"]] if "const" in node else ())
    if choices:
        return f"one of {', '.join(choices)}" if len(choices) > 1 else str(choices[0])
    kind = node.get("type")
    if kind in ("integer", "number"):
        return f"{'a whole number' if kind == 'integer' else 'a number'} {_range(node)}".strip()
    if kind == "array":
        low, high = node.get("minItems", 0), node.get("maxItems")
        return f"a list of {high if low == high else f'{low} to {high}'} entries"
    words = {"boolean": "true or false", "object": "a mapping", "string": "text"}
    return str(
        node["description"] if "pattern" in node and "description" in node else words.get(str(kind), kind)
    )


def _range(node: _Schema) -> str:
    low, high = node.get("minimum"), node.get("maximum")
    if low is None or high is None:
        return "" if low is None else f"of {low:.10g} or more"
    return f"from {low:.10g} to {high:.10g}"

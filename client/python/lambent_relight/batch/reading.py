"""A manifest from plain values, as YAML, JSON or a message give them."""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from lambent_core.errors import RelightError
from lambent_core.pictures import clashes, safe_name
from pydantic import ValidationError

from lambent_relight.aovs import PASSES
from lambent_relight.batch.manifest import Manifest
from lambent_relight.validation import Problem, problems_of

_SHORT = {"assets": "bundle", "environments": "map", "cameras": "file", "qualities": "quality"}
"""The member that a word alone stands for, by list."""


class ManifestError(RelightError):
    """A manifest cannot be used; `problems` holds every one that was found. Code `batch.manifest`."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        shown_problems = "; ".join(f"{each.pointer or '/'}: {each.message}" for each in problems[:20])
        super().__init__("batch.manifest", shown_problems, "see docs/howto/batch.md for every field")
        self.problems = tuple(problems)


def read_manifest(document: Any, base: Path) -> Manifest:
    """Return the manifest that `document` describes; relative paths start at `base`.

    Nothing is looked up on the disk. Raises ManifestError with every problem that was found.
    """
    full = _without_nulls(document)
    origins = _complete(full) if isinstance(full, dict) else []
    try:
        manifest = Manifest.model_validate(full, context={"base": base, "origins": origins})
        problems = [Problem(*each) for each in clashes(manifest)]
    except ValidationError as error:
        problems = list(problems_of(error, Manifest))
    if problems:
        raise ManifestError([replace(each, pointer=_as_given(each.pointer, origins)) for each in problems])
    return manifest


def _without_nulls(value: Any) -> Any:
    """Return a copy of a document without members that are null, which counts as left out."""
    if isinstance(value, dict):
        return {name: _without_nulls(each) for name, each in value.items() if each is not None}
    return [_without_nulls(each) for each in value] if isinstance(value, list) else value


def _complete(document: dict[str, Any]) -> list[int]:
    """Replace the short forms in a document; return the place where each environment came from."""
    for place, member in _SHORT.items():
        if isinstance(document.get(place), list):
            document[place] = [
                ({"all_views": True} if (member, each) == ("file", "all") else {member: each})
                if isinstance(each, str)
                else each
                for each in document[place]
            ]
    output = document.get("output")
    if isinstance(output, dict) and output.get("passes") in ("all", "none"):
        output["passes"] = list(PASSES) if output["passes"] == "all" else []
    if not isinstance(document.get("environments"), list):
        return []
    turned = [_turned(light) for light in document["environments"]]
    document["environments"] = list(chain.from_iterable(turned))
    return [index for index, lights in enumerate(turned) for _ in lights]


def _turned(light: Any) -> list[Any]:
    """Return an environment once for every angle that it is turned by, each under its own name."""
    angles = light.get("rotate_deg") if isinstance(light, dict) else None
    if not isinstance(angles, list) or {type(angle) for angle in angles} - {int, float} or not angles:
        return [light]
    name = light.get("name") or safe_name(Path(str(light.get("map") or light.get("environment_id"))).stem)
    return [{**light, "rotate_deg": angle, "name": f"{name}_{angle:g}"} for angle in angles]


def _as_given(pointer: str, origins: list[int]) -> str:
    """Return the place in the document as it was given."""
    return re.sub(r"(?<=^/environments/)\d+", lambda match: str(origins[int(match[0])]), pointer)

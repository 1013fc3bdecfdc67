"""Refuse a Python package that constraints.txt does not pin, and an npm package that we may not ship.

`pip-licenses` checks the licences of the Python packages; both read the list in pyproject.toml.
"""

import json
import re
import sys
import sysconfig
import tomllib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
WEB = ROOT / "client" / "web"
LOCKS = (WEB / "package-lock.json", *sorted((WEB / "tools").glob("*/package-lock.json")))

_EXEMPT = frozenset({"lambent", "pip", "setuptools", "wheel"})
"""This package, and what every environment brings by itself."""
_LOOKED_UP = {"buildcheck": "MIT", "cpu-features": "MIT"}
"""Licences of npm packages whose lock names none."""


def pins(text: str) -> dict[str, str]:
    """Return the versions in the text of constraints.txt by canonical name; ValueError for any other line."""
    versions: dict[str, str] = {}
    for line in text.splitlines():
        stated = line.partition("#")[0].strip()
        if not stated:
            continue
        match = re.fullmatch(r"([A-Za-z0-9._-]+)==([A-Za-z0-9.!+_-]+)(\s*;.*)?", stated)
        if match is None:
            raise ValueError(f"constraints.txt: {stated!r} pins no version")
        name = canonicalize_name(match[1])
        if name in versions:
            raise ValueError(f"constraints.txt: {name} is pinned twice")
        versions[name] = match[2]
    return versions


def required() -> set[str]:
    """Return the canonical names of what pyproject.toml requires, extras and build system included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    texts = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    for extra in project["project"]["optional-dependencies"].values():
        texts += extra
    return {canonicalize_name(Requirement(text).name) for text in texts}


def unpinned(pinned: dict[str, str], installed: Iterable[tuple[str, str]]) -> list[str]:
    """Return a sentence for every required or installed (name, version) that is not pinned as it is."""
    problems = [f"{name} is required by pyproject.toml and not pinned" for name in required() - {*pinned}]
    for name, version in installed:
        wanted = pinned.get(name)
        if wanted is None:
            problems.append(f"{name} {version} is installed and not pinned in constraints.txt")
        elif version.partition("+")[0] != wanted.partition("+")[0]:
            problems.append(f"{name} {version} is installed, constraints.txt says {wanted}")
    return sorted(problem for problem in problems if problem.partition(" ")[0] not in _EXEMPT)


def refused(lock: dict, allowed: set[str]) -> list[str]:
    """Return a sentence for every package of an npm lock without a checksum or an allowed licence."""
    problems = []
    for place, entry in sorted(lock["packages"].items()):
        if not place or entry.get("link"):
            continue
        name = place.rpartition("node_modules/")[2]
        licence = entry.get("license") or _LOOKED_UP.get(name, "unknown")
        if licence.strip("()") not in allowed:
            problems.append(
                f"npm package {name} has the licence {licence}, which pyproject.toml does not allow"
            )
        if not entry.get("integrity", "").startswith("sha512-"):
            problems.append(f"npm package {name} has no checksum in its lock")
    return problems


def check() -> list[str]:
    """Return all problems of this environment and of the npm locks."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pip-licenses"]
    allowed = {each.strip() for each in settings["allow-only"].split(";")}
    pinned = pins((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    # Not all of sys.path: an imported ray adds packages of its own to it.
    folders = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    distributions = metadata.distributions(path=sorted(folders))
    installed = ((canonicalize_name(each.name), each.version) for each in distributions)
    problems = unpinned(pinned, installed)
    for lock in LOCKS:
        problems += refused(json.loads(lock.read_text(encoding="utf-8")), allowed)
    return problems


if __name__ == "__main__":
    try:
        problems = check()
    except ValueError as error:
        problems = [str(error)]
    print("\n".join(problems) or "every dependency is pinned, and every npm package has an allowed licence")
    sys.exit(bool(problems))

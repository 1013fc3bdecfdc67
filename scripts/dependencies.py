"""What this repository depends on: a check without network, a bill of materials, and a look for advisories.

python scripts/dependencies.py check            # every pin is used and has an allowed licence
python scripts/dependencies.py sbom FILE        # CycloneDX 1.6, from the environment and the npm locks
python scripts/dependencies.py audit            # asks advisory services; exit code 3 if that was impossible
"""

import argparse
import json
import re
import subprocess
import sys
import tomllib
import uuid
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
WEB = ROOT / "client" / "web"
LOCKS = (WEB / "package-lock.json", *sorted((WEB / "tools").glob("*/package-lock.json")))

ALLOWED = frozenset(
    {
        *(
            "Apache-2.0",
            "MIT",
            "MIT-0",
            "MIT-CMU",
            "BSD-2-Clause",
            "BSD-3-Clause",
            "0BSD",
            "ISC",
            "Zlib",
            "PSF-2.0",
        ),
        *("Python-2.0", "CC0-1.0", "BSL-1.0", "BlueOak-1.0.0", "Unlicense", "HPND"),
        # Files of theirs that are changed stay under their licence, which nothing here does.
        *("MPL-2.0", "LGPL-3.0-only", "LGPL-3.0-or-later"),
    }
)
"""SPDX identifiers under which a dependency may be used."""
_WORDS = {
    "mit license": "MIT",
    "mit": "MIT",
    "bsd license": "BSD-3-Clause",
    "3-clause bsd license": "BSD-3-Clause",
    "bsd": "BSD-3-Clause",
    "apache software license": "Apache-2.0",
    "apache 2.0": "Apache-2.0",
    "apache": "Apache-2.0",
    "apache license 2.0": "Apache-2.0",
    "isc license (iscl)": "ISC",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
    "the unlicense (unlicense)": "Unlicense",
}
_EXCEPTIONS = {
    # What their files say where the metadata do not, each looked at by hand.
    "openexr": "BSD-3-Clause",
    "pycolmap": "BSD-3-Clause",
    "usd-core": "Apache-2.0",
    "imageio-ffmpeg": "BSD-2-Clause",
    "buildcheck": "MIT",
    "cpu-features": "MIT",
}
"""Licences of packages whose metadata name none, or one without an SPDX identifier."""


_TOOLS = frozenset({"pip", "setuptools", "wheel"})
"""What every environment brings by itself."""


@dataclass(frozen=True, slots=True)
class Component:
    """A package at a version."""

    ecosystem: str
    name: str
    version: str
    licence: str
    sha512: str = ""
    needs: tuple[str, ...] = field(default=())

    @property
    def purl(self) -> str:
        """Return its package URL."""
        return f"pkg:{self.ecosystem}/{self.name.replace('@', '%40')}@{self.version}"


def pins() -> dict[str, str]:
    """Return the versions of constraints.txt by canonical name; ValueError for a line that pins nothing."""
    found: dict[str, str] = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        text = line.partition("#")[0].strip()
        if not text:
            continue
        match = re.fullmatch(r"([A-Za-z0-9._-]+)==([A-Za-z0-9.!+_-]+)(\s*;.*)?", text)
        if match is None:
            raise ValueError(f"constraints.txt: {text!r} pins no version")
        name = canonicalize_name(match[1])
        if name in found:
            raise ValueError(f"constraints.txt: {name} is pinned twice")
        found[name] = match[2]
    return found


def required() -> set[str]:
    """Return the canonical names of what pyproject.toml asks for, extras and build system included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    texts = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    for extra in project["project"]["optional-dependencies"].values():
        texts += extra
    return {canonicalize_name(Requirement(text).name) for text in texts} - {"lambent"}


def closure(roots: set[str]) -> dict[str, metadata.Distribution]:
    """Return the installed packages that `roots` need, themselves included, by canonical name."""
    found: dict[str, metadata.Distribution] = {}
    waiting: list[tuple[str, frozenset[str]]] = [(name, frozenset()) for name in roots]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for text in (
        *project["dependencies"],
        *(t for e in project["optional-dependencies"].values() for t in e),
    ):
        each = Requirement(text)
        waiting.append((canonicalize_name(each.name), frozenset(each.extras)))
    seen = set()
    while waiting:
        name, extras = waiting.pop()
        if (name, extras) in seen or name == "lambent":
            continue
        seen.add((name, extras))
        try:
            found[name] = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            continue
        for text in found[name].requires or ():
            each = Requirement(text)
            if each.marker is None or any(_holds(each, extra) for extra in ("", *extras)):
                waiting.append((canonicalize_name(each.name), frozenset(each.extras)))
    return found


def _holds(requirement: Requirement, extra: str) -> bool:
    assert requirement.marker is not None
    return requirement.marker.evaluate({**default_environment(), "extra": extra})


def licence_of(distribution: metadata.Distribution) -> str:
    """Return the SPDX expression of a package; "" if its metadata have none."""
    name = canonicalize_name(distribution.metadata["Name"])
    if name in _EXCEPTIONS:
        return _EXCEPTIONS[name]
    stated = distribution.metadata.get("License-Expression")
    if stated:
        return str(stated)
    classifiers = distribution.metadata.get_all("Classifier") or []
    words = [
        each.rpartition("::")[2].strip().lower() for each in classifiers if each.startswith("License ::")
    ]
    known = sorted({_WORDS[word] for word in words if word in _WORDS})
    if known:
        return " AND ".join(known)
    first = ((distribution.metadata.get("License") or "").strip().splitlines() or [""])[0].strip()
    return _WORDS.get(first.lower(), first if is_allowed(first) else "")


def is_allowed(expression: str) -> bool:
    """Return whether an SPDX expression leaves a choice of allowed licences."""
    text = re.sub(r"\s+WITH\s+[\w.-]+", "", expression)
    names = re.findall(r"[\w.+-]+", text)
    # Every name stands for whether it is allowed; what remains is "and", "or" and parentheses.
    words = {"AND": " and ", "OR": " or "}
    logic = re.sub(r"[\w.+-]+", lambda found: words.get(found[0], f" {found[0] in ALLOWED} "), text)
    if not names or not re.fullmatch(r"[\s()]*((True|False|and|or)[\s()]*)+", logic):
        return False
    try:
        return bool(eval(logic, {"__builtins__": {}}))  # noqa: S307
    except SyntaxError:
        return False


def python_components() -> Iterator[Component]:
    """Yield the installed packages that this repository needs."""
    for name, found in sorted(closure(required()).items()):
        needs = tuple(sorted({canonicalize_name(Requirement(text).name) for text in found.requires or ()}))
        yield Component("pypi", name, found.version, licence_of(found), needs=needs)


def npm_components() -> Iterator[Component]:
    """Yield the packages of the npm locks."""
    for lock in LOCKS:
        for place, entry in sorted(json.loads(lock.read_text(encoding="utf-8"))["packages"].items()):
            if not place or entry.get("link"):
                continue
            name = entry.get("name") or place.rpartition("node_modules/")[2]
            algorithm, _, digest = entry.get("integrity", "").partition("-")
            sha512 = b64decode(digest).hex() if algorithm == "sha512" else ""
            licence = entry.get("license") or _EXCEPTIONS.get(name, "")
            yield Component("npm", name, entry.get("version", ""), licence, sha512)


def check() -> list[str]:
    """Return a sentence for every dependency that is not pinned, not used, or has no allowed licence."""
    problems = []
    try:
        pinned = pins()
    except ValueError as error:
        return [str(error)]
    needed = closure(required())
    problems += [
        f"{name} is required by pyproject.toml and not pinned" for name in sorted(required() - set(pinned))
    ]
    for name, found in sorted(needed.items()):
        if name in _TOOLS:
            continue
        if name not in pinned:
            problems.append(f"{name} is needed and not pinned in constraints.txt")
        elif found.version.partition("+")[0] != pinned[name].partition("+")[0]:
            problems.append(f"{name} {found.version} is installed, constraints.txt says {pinned[name]}")
    installed = {canonicalize_name(each.metadata["Name"]) for each in metadata.distributions()}
    # What is not installed here may be for another system.
    for name in sorted(set(pinned) & installed - set(needed)):
        problems.append(f"{name} is pinned, but nothing needs it any more")
    for each in (*python_components(), *npm_components()):
        if not each.version:
            problems.append(f"{each.purl} has no version")
        if each.ecosystem == "npm" and not each.sha512:
            problems.append(f"{each.purl} has no checksum in its lock")
        if not is_allowed(each.licence):
            problems.append(f"{each.purl} has the licence {each.licence or 'nobody knows which'}")
    return problems


def sbom() -> dict[str, Any]:
    """Return a bill of materials in the form of CycloneDX 1.6; the same environment gives the same bill."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    root = f"pkg:pypi/lambent@{project['version']}"
    python = list(python_components())
    found = {each.purl: each for each in (*python, *npm_components())}
    by_name = {each.name: each.purl for each in python}
    components = [
        {
            "type": "library",
            "bom-ref": each.purl,
            "name": each.name,
            "version": each.version,
            "purl": each.purl,
            "licenses": [{"expression": each.licence}] if is_allowed(each.licence) else [],
            **({"hashes": [{"alg": "SHA-512", "content": each.sha512}]} if each.sha512 else {}),
        }
        for _, each in sorted(found.items())
    ]
    dependencies = [
        {"ref": each.purl, "dependsOn": sorted({by_name[name] for name in each.needs if name in by_name})}
        for each in python
    ]
    direct = sorted({by_name[name] for name in required() if name in by_name})
    content = json.dumps(components, sort_keys=True)
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, content)}",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": "lambent",
                "version": project["version"],
                "purl": root,
                "licenses": [{"license": {"id": project["license"]}}],
            }
        },
        "components": components,
        "dependencies": [{"ref": root, "dependsOn": direct}, *dependencies],
    }


def validate(bill: dict[str, Any]) -> str:
    """Return what the schema of CycloneDX objects to; empty if nothing."""
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    error = JsonStrictValidator(SchemaVersion.V1_6).validate_str(json.dumps(bill))
    return "" if error is None else str(error)[:500]


def audit(python: str) -> int:
    """Ask for advisories on all dependencies; return 1 if there are any, 3 if a service does not answer."""
    codes = []
    commands = [([python, "-m", "pip_audit", "-r", "constraints.txt", "--no-deps", "--disable-pip"], ROOT)]
    commands += [(["npm", "audit", "--package-lock-only", "--json"], lock.parent) for lock in LOCKS]
    for command, folder in commands:
        title = f"{command[0] if command[0] == 'npm' else 'pip-audit'} in {folder.relative_to(ROOT)}"
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=300
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            print(f"{title}: NOT DONE: {error}")
            codes.append(3)
            continue
        text = done.stdout + done.stderr
        if command[0] == "npm":
            reached = '"vulnerabilities"' in done.stdout
        else:
            reached = "Found" in text or "No known vulnerabilities" in text
        if not reached:
            print(f"{title}: NOT DONE: {(text.strip().splitlines() or ['no answer'])[-1][:200]}")
            codes.append(3)
        elif done.returncode:
            print(f"{title}: advisories\n{text}")
            codes.append(1)
        else:
            print(f"{title}: no advisories")
    return 1 if 1 in codes else max(codes, default=0)


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = parser.add_subparsers(dest="action", required=True)
    actions.add_parser("check")
    actions.add_parser("sbom").add_argument("file", type=Path)
    actions.add_parser("audit").add_argument(
        "--python", default=sys.executable, help="one that has pip-audit"
    )
    given = parser.parse_args()
    if given.action == "audit":
        return audit(given.python)
    if given.action == "sbom":
        bill = sbom()
        problem = validate(bill)
        if problem:
            print(f"this is no CycloneDX: {problem}")
            return 1
        given.file.parent.mkdir(parents=True, exist_ok=True)
        given.file.write_text(json.dumps(bill, indent=1) + "\n", encoding="utf-8")
        print(f"{given.file}: {len(bill['components'])} components")
        return 0
    problems = check()
    print("\n".join(problems) or "every dependency is pinned, needed, and has an allowed licence")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main())

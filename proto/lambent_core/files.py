"""Small files of ours: written whole or not at all, read without surprises, named by their content."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any


def write_json(path: Path, value: object) -> None:
    """Write JSON so that a reader sees either the old file or the whole new one."""
    partial = path.with_name(path.name + ".tmp")
    with partial.open("w", encoding="utf-8") as file:
        json.dump(value, file, indent=1)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def read_record(path: Path) -> dict[str, Any]:
    """Return the object in a small JSON file of ours, empty where there is none."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


def link_or_copy(source: str | Path, target: str | Path) -> None:
    """Make a file appear under a second name, as a copy on file systems without links."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def digest(*parts: object) -> str:
    """Return the SHA-256 of JSON-compatible values, in hexadecimal."""
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file, lower-case hexadecimal; raises OSError where it cannot be read."""
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a name beside `path` to write to; the file there becomes `path` unless something fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        yield partial
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)

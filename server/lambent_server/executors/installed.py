"""The installed Lambent as one hash. Run as a program it prints it; needs the standard library only.

Its text is also sent to machines that may have another version, or none.
"""

import hashlib
import importlib.util
import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = (
    "lambent_proto",
    "lambent_core",
    "lambent_sandbox",
    "lambent_compute",
    "lambent_relight",
    "flashcache",
    "lambent_capture",
    "lambent_asset",
    "lambent_run",
)
"""What a run process is made of."""


def installed() -> dict[str, str]:
    """Return the version of Lambent, and the SHA-256 of the files that runs use; both empty without it."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            return {"version": "", "digest": ""}
        folder = Path(spec.submodule_search_locations[0])
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if path.is_file() and "__pycache__" not in name:
                digest.update(f"{package}/{name}\0".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    try:
        release = version("lambent")
    except PackageNotFoundError:
        release = "?"
    return {"version": release, "digest": digest.hexdigest()}


if __name__ == "__main__":
    print(json.dumps(installed()))

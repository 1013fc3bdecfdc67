"""Fail when a module is longer than 400 lines: it has a second subject."""

import subprocess
import sys
from pathlib import Path

LIMIT = 400
GENERATED = ("_pb2.py", "_pb2_grpc.py", "_pb2.pyi", "_pb.ts", "src/contract/rest.ts")
ROOT = Path(__file__).resolve().parent.parent


def too_long(paths: list[Path], limit: int = LIMIT) -> list[str]:
    """Return one sentence for every file of `paths` with more than `limit` lines."""
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in paths}
    return [
        f"{path}: {length} lines, at most {limit} are allowed; split it by subject"
        for path, length in lengths.items()
        if length > limit
    ]


def tracked(*patterns: str) -> list[Path]:
    """Return the files matching these patterns that git tracks or does not ignore."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *patterns]
    listing = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [ROOT / line for line in listing.splitlines() if (ROOT / line).is_file()]


if __name__ == "__main__":
    sources = [path for path in tracked("*.py", "*.ts") if not path.as_posix().endswith(GENERATED)]
    problems = too_long(sources)
    print("\n".join(problems) or f"{len(sources)} modules, none above {LIMIT} lines")
    sys.exit(bool(problems))

"""Fail when a changelog fragment has a name that towncrier ignores, or nothing in it."""

import re
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent.parent / "changelog.d"
KINDS = ("added", "changed", "deprecated", "removed", "fixed", "security")
_NAME = re.compile(rf"^(\d+|\+[a-z0-9-]+)\.({'|'.join(KINDS)})\.md$")


def faults(folder: Path) -> list[str]:
    """Return one sentence for every fragment in `folder` that cannot become a line of the changelog."""
    problems = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if not _NAME.match(path.name):
            problems.append(f"{path.name}: call it +topic.kind.md with a kind of {', '.join(KINDS)}")
        elif not path.read_text(encoding="utf-8").strip().endswith((".", "!", "?")):
            problems.append(f"{path.name}: write one full sentence for the people who use Lambent")
    return problems


if __name__ == "__main__":
    problems = faults(FOLDER)
    print("\n".join(problems) or f"{len(list(FOLDER.glob('*.md')))} changelog fragments, all readable")
    sys.exit(bool(problems))

"""Fail when a link in one of our Markdown files leads nowhere inside the repository."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from check_modules import ROOT, tracked

_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
_HEADING = re.compile(r"^#+\s+(.*?)\s*$", re.MULTILINE)
_OUTSIDE = re.compile(r"^(https?|mailto):")


def anchors(text: str) -> set[str]:
    """Return the fragments that the headings of a Markdown `text` answer to."""
    titles = (re.sub(r"[^\w\s-]", "", heading.lower()) for heading in _HEADING.findall(text))
    return {re.sub(r"\s", "-", title.strip()) for title in titles}


def broken_links(page: Path) -> list[str]:
    """Return one sentence for every relative link of `page` whose file or heading does not exist."""
    problems = []
    for target in _LINK.findall(_CODE.sub("", page.read_text(encoding="utf-8"))):
        if _OUTSIDE.match(target):
            continue
        name, _, fragment = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists():
            problems.append(f"{page}: ({target}) leads to no file; mend the path or remove the link")
        elif fragment and file.suffix == ".md" and fragment not in anchors(file.read_text(encoding="utf-8")):
            problems.append(f"{page}: ({target}) leads to no heading of {file.name}")
    return problems


if __name__ == "__main__":
    pages = tracked("*.md")
    problems = [problem for page in pages for problem in broken_links(page)]
    print("\n".join(problems) or f"{len(pages)} pages below {ROOT.name}/, every link leads somewhere")
    sys.exit(bool(problems))

"""Fail when a link in a Markdown file is broken, or a page of docs/ is not linked from anywhere."""

import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from check_functions import ROOT, tracked

_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
_HEADING = re.compile(r"^#+\s+(.*?)\s*$", re.MULTILINE)
_OUTSIDE = re.compile(r"^(https?|mailto):")


def anchors(text: str) -> set[str]:
    """Return the link fragments of the headings of a Markdown `text`."""
    titles = (re.sub(r"[^\w\s-]", "", heading.lower()) for heading in _HEADING.findall(text))
    return {re.sub(r"\s", "-", title.strip()) for title in titles}


def links(page: Path) -> list[tuple[str, Path, str]]:
    """Return (as written, file, fragment) of every link of `page` that stays in the repository."""
    targets = []
    for target in _LINK.findall(_CODE.sub("", page.read_text(encoding="utf-8"))):
        if not _OUTSIDE.match(target):
            name, _, fragment = target.partition("#")
            targets.append((target, (page.parent / name).resolve() if name else page, fragment))
    return targets


def broken_links(page: Path) -> list[str]:
    """Return one sentence for every link of `page` whose file or heading does not exist."""
    problems = []
    for target, file, fragment in links(page):
        if not file.exists():
            problems.append(f"{page}: ({target}) leads to no file; fix the path or remove the link")
        elif fragment and file.suffix == ".md" and fragment not in anchors(file.read_text(encoding="utf-8")):
            problems.append(f"{page}: ({target}) leads to no heading of {file.name}")
    if re.search(r"^(<{7}|>{7}) ", page.read_text(encoding="utf-8"), re.MULTILINE):
        problems.append(f"{page}: has the marks of a merge that was not finished")
    return problems


def unreachable(pages: list[Path], start: Path) -> list[Path]:
    """Return those of `pages` that no chain of links from `start` leads to."""
    seen, waiting = set(), [start]
    while waiting:
        page = waiting.pop()
        if page not in seen and page.suffix == ".md" and page.exists():
            seen.add(page)
            waiting += [file for _, file, _ in links(page)]
    return [page for page in pages if page not in seen]


if __name__ == "__main__":
    pages = tracked("*.md")
    problems = [problem for page in pages for problem in broken_links(page)]
    documents = [page for page in pages if page.is_relative_to(ROOT / "docs")]
    lost = unreachable(documents, ROOT / "docs" / "index.md")
    problems += [f"{page}: no page leads here; link it from docs/index.md" for page in lost]
    print("\n".join(problems) or f"{len(pages)} Markdown files, every link leads somewhere")
    sys.exit(bool(problems))

"""Refuse words and phrases that read as translated, in code, comments, messages and pages.

CONTRIBUTING.md has the table with what to write instead; the patterns below are the same list.
"""

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from check_functions import ROOT, tracked

COMPARATIVE = (
    r"(?:bett|small|larg|bigg|long|short|few|high|low|great|fast|slow|earli|lat|old|near|clos|farth)er\b"
)
PHRASES = {
    r"(?:is|are|was|were|be|been|database|store|server|disk|away or) away(?! from)\b": "unavailable, gone",
    r"(?:what|that|who|which|where \w+|nothing) (?:is|are|was|were) there\b(?! (?:an?|any|no)\b)": "exists",
    r"(?:go|goes|going|gone|went) on\b(?! (?:a|the|to the)\b)": "continue",
    r"(?:is|are|was|were|be|been|being) told\b(?! (?:apart|from|to))": "receives, knows, is reported",
    rf"(?<!there )(?:is|are|was|were) no (?!more|less|worse|different|such|{COMPARATIVE})": "is not a",
    r"(?:somebody|anybody)\b": "a user, someone, the name of the role",
    r"nobody's\b": "no user's, belongs to no one",
    r"(?:is|are|was|were|be) (?:asked|believed)\b(?! (?:for|to)\b)": "is called, is used, is trusted",
    r"stands? (?:in(?! for)|at|there|here|beside|between|before|after)\b": "is",
    r"lies? (?:there|here|beside)\b": "is",
    r"looked after\b": "managed",
    r"turns? forth\b": "turns forward",
    r"(?:may|must) not be asked\b": "must not be called",
    r"as (?:far|long|good) as (?:it|that|time) is\b": "name the limit",
}
QUESTION = re.compile(r"(?:What|Whether|Which|Who|Whose|How|Where|When)\b")
_PHRASES = [(re.compile(rf"\b{phrase}", re.IGNORECASE), better) for phrase, better in PHRASES.items()]
NAMES = {"found": "the thing that was found"}
"""Names that say nothing, and what to name instead."""
# The page of tests repeats their names.
SKIPPED = (
    "testing.md",
    "*_pb2.py",
    "*_pb2.pyi",
    "*_pb2_grpc.py",
    "*_pb.ts",
    "*rest.ts",
    "*check_words.py",
    "CONTRIBUTING.md",
)


def phrases(text: str) -> Iterator[str]:
    """Yield each refused phrase of a text with what to write instead."""
    flat = " ".join(text.split())
    for pattern, better in _PHRASES:
        for match in pattern.finditer(flat):
            yield f"{match[0]!r}: write {better}"


def python_problems(text: str, is_test: bool) -> Iterator[tuple[int, str]]:
    """Yield the line and the problem of every refused phrase, name and module docstring of Python source."""
    tree = ast.parse(text)
    docstring = ast.get_docstring(tree)
    if docstring and QUESTION.match(docstring):
        yield 1, "a module's docstring is a noun or an imperative, not a question"
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from ((node.lineno, problem) for problem in phrases(node.value))
        named = node.id if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else None
        named = node.arg if isinstance(node, ast.arg) else named
        if named in NAMES and not is_test:
            yield node.lineno, f"{named!r} is not a name: say {NAMES[named]}"
    yield from comment_problems(text)


def comment_problems(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the problem of every refused phrase in the comments of Python source.

    Comments of consecutive lines are one text: a phrase may be broken between them.
    """
    first, last, joined = 0, -2, ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT:
            continue
        if token.start[0] != last + 1:
            yield from ((first, problem) for problem in phrases(joined))
            first, joined = token.start[0], ""
        joined += " " + token.string.lstrip("# ")
        last = token.start[0]
    yield from ((first, problem) for problem in phrases(joined))


def line_problems(text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the problem of every refused phrase of TypeScript, a page or a list of words."""
    for number, line in enumerate(text.splitlines(), 1):
        yield from ((number, problem) for problem in phrases(line))


def problems_of(path: str, text: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the problem of every refused phrase of one file."""
    if path.endswith(".py"):
        yield from python_problems(text, is_test=path.startswith("tests/"))
    else:
        yield from line_problems(text)


def texts() -> list[Path]:
    """Return the tracked files that people read: sources, tests, pages and the web client's English words."""
    sources = tracked("*.py", "*.ts", "*.glsl", "*.proto", "*.md", "*/words/en.json")
    return [path for path in sources if not any(path.match(pattern) for pattern in SKIPPED)]


def main(arguments: list[str]) -> int:
    """Print the problems of all files, or of those below the given folders; return the exit code."""
    below = [(ROOT / argument).resolve() for argument in arguments]
    problems = [
        f"{path.relative_to(ROOT)}:{line}: {problem}"
        for path in texts()
        if not below or any(path.is_relative_to(folder) for folder in below)
        for line, problem in problems_of(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
    ]
    print("\n".join(problems) or "no refused words")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

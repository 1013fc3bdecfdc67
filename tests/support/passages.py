"""Finds a passage of our source by the symbol it is in and by its tokens.

A module that is moved or renamed, a call that is wrapped anew, or a comment that is added changes nothing.
"""

import ast
import io
import tokenize
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

TOP = "<module>"
"""The symbol of what is outside all functions, classes and constants, or in several of them."""
_SILENT = frozenset(
    {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
)
Token = tuple[str, int, int]
"""Text, and where it begins and ends in the source."""


@cache
def symbols(sources: tuple[Path, ...]) -> dict[str, tuple[Path, int, int]]:
    """Return file, first and last line of every symbol below the folders `sources`, by its full name."""
    found = {}
    for source in sources:
        for path in source.rglob("*.py"):
            module = ".".join(path.relative_to(source).with_suffix("").parts)
            text = path.read_text(encoding="utf-8")
            found[f"{module}.{TOP}"] = (path, 1, text.count("\n") + 1)
            for name, first, last in _defined(ast.parse(text).body, ""):
                found[f"{module}.{name}"] = (path, first, last)
    return found


def _defined(body: Sequence[ast.stmt], prefix: str, inside: bool = False) -> Iterator[tuple[str, int, int]]:
    """Yield functions, classes and constants; variables of a function, `inside` which this is, are none."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            yield prefix + node.name, first, node.end_lineno or first
            own = inside or not isinstance(node, ast.ClassDef)
            yield from _defined(node.body, f"{prefix}{node.name}.", own)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for target in targets:
                if isinstance(target, ast.Name) and not inside:
                    yield prefix + target.id, node.lineno, node.end_lineno or node.lineno
        else:
            for part in ("body", "orelse", "finalbody"):
                yield from _defined(getattr(node, part, None) or [], prefix, inside)


def place_of(symbol: str, sources: tuple[Path, ...]) -> tuple[Path, int, int]:
    """Return file, first and last line of a symbol, given by the end of its full name that is unique.

    Raises ValueError where no symbol ends so, or several do.
    """
    places = {name: place for name, place in symbols(sources).items() if f".{name}".endswith(f".{symbol}")}
    if len(places) != 1:
        listed = ", ".join(sorted(places)[:4]) or "none"
        raise ValueError(f"{len(places)} symbols are called {symbol} ({listed}), expected one")
    return next(iter(places.values()))


def replaced(text: str, lines: tuple[int, int], old: str, new: str) -> str:
    """Return `text` with `new` in place of the code `old`, which occurs once in the lines from..to.

    Raises ValueError unless it does. Further lines of `new` are indented as the line where `old` begins.
    """
    begin, end = (
        sum(map(len, text.splitlines(keepends=True)[:number])) for number in (lines[0] - 1, lines[1])
    )
    inside = [token for token in _tokens(text) if begin <= token[1] and token[2] <= end]
    matches = _matches(_without_last_commas(inside), _texts(_without_last_commas(_tokens(old))))
    matches = matches or _matches(inside, _texts(_tokens(old)))
    if len(matches) != 1:
        raise ValueError(f"the passage occurs {len(matches)} times there, expected once: {old!r}")
    first, last = matches[0]
    line = text[text.rfind("\n", 0, first) + 1 : first]
    indent = line[: len(line) - len(line.lstrip())]
    return text[:first] + new.replace("\n", f"\n{indent}") + text[last:]


def _tokens(text: str) -> list[Token]:
    """Return the tokens of a source, or of a passage of one, without comments, breaks and indentation."""
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found = []
    try:
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type not in _SILENT:
                first, last = (starts[row - 1] + column for row, column in (token.start, token.end))
                found.append((token.string, first, last))
    except (IndentationError, tokenize.TokenError):
        # A passage may begin inside a block, and end inside a bracket.
        pass
    return found


def _without_last_commas(tokens: Sequence[Token]) -> list[Token]:
    following = [*(token[0] for token in tokens[1:]), ""]
    return [
        token
        for token, after in zip(tokens, following, strict=True)
        if token[0] != "," or after not in (*")]}",)
    ]


def _texts(tokens: Sequence[Token]) -> list[str]:
    return [token[0] for token in tokens]


def _matches(tokens: Sequence[Token], wanted: Sequence[str]) -> list[tuple[int, int]]:
    texts, length = _texts(tokens), len(wanted)
    return [
        (tokens[index][1], tokens[index + length - 1][2])
        for index in range(len(texts) - length + 1)
        if texts[index : index + length] == wanted
    ]

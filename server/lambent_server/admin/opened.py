"""The parts of a server that the commands of its operator use, whether it runs or not."""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from lambent_server.cli import opened_database
from lambent_server.services import Services, join_services

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, one object per line, for machines.")]
TenantOption = Annotated[str, typer.Option(help="Only of this tenant.")]
OlderOption = Annotated[str, typer.Option("--older-than", metavar="AGE", help="Only older: 30m, 12h, 7d.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Do it; without, it is only shown.")]
StoreOption = Annotated[str | None, typer.Option(help="URL of the blob store, as for `lambent serve`.")]
_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


@contextlib.contextmanager
def opened(
    data: Path | None, database: str | None, store: str | None = None, *, with_store: bool = False
) -> Iterator[Services]:
    """Yield the parts of the server with this data folder; its problems end the command with one line.

    A store in S3 is opened only `with_store`: other commands work while it is unavailable.
    """
    given = {"data": data, "database": database, "store": store}
    with opened_database("admin", **given) as (settings, rows):
        yield join_services(settings, rows, with_store=with_store)


def age(text: str) -> float:
    """Return the seconds of an age such as 30m, 12h or 7d; raises typer.BadParameter for any other text."""
    number, unit = text[:-1], text[-1:]
    if unit not in _UNITS or not number.isdecimal():
        raise typer.BadParameter(f"{text!r} is not an age such as 30m, 12h or 7d")
    return int(number) * _UNITS[unit]


def print_rows(rows: Sequence[Mapping[str, Any]], names: Sequence[str], as_json: bool) -> None:
    """Print rows: as JSON, a line each, with all they have, or as a table of the columns `names`."""
    if as_json:
        for row in rows:
            typer.echo(json.dumps(row))
        return
    lines = [[name.upper() for name in names], *([_text(row[name]) for name in names] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        typer.echo("  ".join(map(str.ljust, line, widths)).rstrip())


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {each}" for name, each in value.items())
    if isinstance(value, list | tuple):
        return " ".join(value)
    return "" if value is None else str(value)

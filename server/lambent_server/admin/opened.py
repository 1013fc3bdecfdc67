"""The parts of a server that the commands of its operator use, whether it runs or not."""

import contextlib
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Annotated

import typer

from lambent_server.cli import settings_of
from lambent_server.services import Capacity, Services, s3_options

JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON, one object per line, for machines.")]
TenantOption = Annotated[str, typer.Option(help="Only of this tenant.")]
_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


@contextlib.contextmanager
def opened(
    data: Path | None, database: str | None, store: str | None = None, *, with_store: bool = False
) -> Iterator[Services]:
    """Yield the parts of the server with this data folder; its problems end the command with one line.

    Only with `with_store` a store in S3 is looked at: other commands work while it is away.
    """
    from pydantic import ValidationError
    from sqlalchemy.exc import SQLAlchemyError

    from lambent_server.api.problems import Problem
    from lambent_server.cluster.shared_secrets import is_data_folder
    from lambent_server.cluster.wakeups import Wakeups
    from lambent_server.core.secrets import SecretError
    from lambent_server.database.latest_time import begin_time
    from lambent_server.executors.local import count_gpus
    from lambent_server.services import open_database
    from lambent_server.storage.store import BlobStore

    settings = settings_of(data=data, database=database, store=store)
    if not is_data_folder(settings.data):
        typer.echo(f"admin.no_server: {settings.data} is no data folder of a server; say --data", err=True)
        raise typer.Exit(2)
    rows = open_database(settings)
    try:
        begin_time(rows)
        blobs = BlobStore(
            settings.data / "store", settings.store, s3_options(settings) if with_store else None
        )
        yield Services(settings, rows, blobs, Wakeups(), Capacity.of_machine(settings, count_gpus()))
    except Problem as problem:
        typer.echo(f"admin.{problem.code}: {problem.detail}", err=True)
        raise typer.Exit(4) from problem
    except (ValidationError, SecretError, OSError, SQLAlchemyError) as error:
        typer.echo(f"admin.failed: {str(error).splitlines()[0]}", err=True)
        raise typer.Exit(2) from error
    finally:
        rows.close()


def age(text: str) -> float:
    """Return the seconds of an age such as 30m, 12h or 7d; raises typer.BadParameter for any other text."""
    number, unit = text[:-1], text[-1:]
    if unit not in _UNITS or not number.isdecimal():
        raise typer.BadParameter(f"{text!r} is no age such as 30m, 12h or 7d")
    return timedelta(seconds=int(number) * _UNITS[unit]).total_seconds()


def columns(rows: list[tuple[str, ...]]) -> None:
    """Print a table; the first row has its titles."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        typer.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())

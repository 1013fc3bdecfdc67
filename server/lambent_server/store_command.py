"""`lambent store`: what database and store know of each other, and removing what is left over."""

import json
from contextlib import closing
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from lambent_server.cli import DatabaseOption, DataOption, settings_of

if TYPE_CHECKING:
    from lambent_server.running.reconciler import Findings

StoreOption = Annotated[str | None, typer.Option(help="URL of the store; a folder in --data by default.")]


class StoreAction(StrEnum):
    """What `lambent store` does."""

    CHECK = "check"
    CLEAN = "clean"


def store(
    action: Annotated[
        StoreAction, typer.Argument(help="check: report and change nothing; clean: remove what is left over.")
    ],
    data: DataOption = None,
    database: DatabaseOption = None,
    store: StoreOption = None,
    older_than_s: Annotated[
        float | None,
        typer.Option(help="Age at which it counts as left over; LAMBENT_ORPHAN_AFTER_S by default.", min=0.0),
    ] = None,
    content: Annotated[
        bool, typer.Option("--content", help="Also read all bytes and compare them with their hashes.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Compare rows and files of a server, running or not. Exit code 1 if files are lost or damaged."""
    from obstore.exceptions import BaseError
    from sqlalchemy.exc import SQLAlchemyError

    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.cluster.shared_secrets import is_data_folder
    from lambent_server.running.reconciler import examine, repair
    from lambent_server.services import join_services

    settings = settings_of(data=data, database=database, store=store, orphan_after_s=older_than_s)
    if not is_data_folder(settings.data):
        typer.echo(f"store.no_server: {settings.data} is no data folder of a server; say --data", err=True)
        raise typer.Exit(2)
    try:
        services = join_services(settings)
        with closing(services.database):
            found = examine(services, contents=content)
            if action is StoreAction.CLEAN:
                if found.is_foreign:
                    typer.echo(
                        f"store.foreign: the database knows only {found.num_blobs - len(found.unknown)} of "
                        f"{found.num_blobs} files; it probably belongs to another store, nothing was removed",
                        err=True,
                    )
                    raise typer.Exit(2)
                repair(services, found)
                for sha256 in found.damaged:
                    services.store.checks.set_aside(sha256)
                with services.database.write() as connection:
                    audit.record(connection, operator(audit.SERVER), "store clean")
    except (SQLAlchemyError, BaseError, ValueError, OSError) as error:
        typer.echo(f"store.failed: {str(error).splitlines()[0]}", err=True)
        raise typer.Exit(2) from error
    _tell(found, removed=action is StoreAction.CLEAN, content=content, as_json=as_json)
    if found.lost or found.damaged:
        raise typer.Exit(1)


def _tell(found: "Findings", *, removed: bool, content: bool, as_json: bool) -> None:
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "num_blobs": found.num_blobs,
                    "removed": removed,
                    "unknown": sorted(found.unknown),
                    "unreferenced": sorted(sha256 for _, sha256 in found.unreferenced),
                    "staged": sorted(found.staged),
                    "parts": sorted(key for key, _ in found.parts),
                    "lost": sorted(found.lost),
                    **({"damaged": sorted(found.damaged)} if content else {}),
                }
            )
        )
        return
    done = "removed" if removed else "to remove"
    size = sum(found.unknown.values())
    for line in (
        f"{found.num_blobs} files in the store",
        f"{len(found.unknown)} without a row ({size} bytes), {done}",
        f"{len(found.unreferenced)} that nothing refers to, {done}"
        + (" by the next sweep" if removed else ""),
        f"{len(found.staged)} sent and never taken over, {done}",
        f"{len(found.parts)} uploads in parts never completed, {done}",
        f"{len(found.lost)} lost" + "".join(f"\n  {sha256}" for sha256 in found.lost),
        f"{len(found.damaged)} with damaged contents" + "".join(f"\n  {sha256}" for sha256 in found.damaged)
        if content
        else "contents were not read; --content compares them with their hashes",
    ):
        typer.echo(line)

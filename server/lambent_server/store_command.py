"""`lambent store`: what database and store know of each other, and removing what is left over."""

import json
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from lambent_server.cli import DatabaseOption, DataOption, opened_database

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
    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.running.reconciler import examine, repair
    from lambent_server.services import join_services

    given = {"data": data, "database": database, "store": store, "orphan_after_s": older_than_s}
    with opened_database("store", **given) as (settings, rows):
        services = join_services(settings, rows)
        findings = examine(services, contents=content)
        if action is StoreAction.CLEAN:
            if findings.is_foreign:
                typer.echo(
                    f"store.foreign: the database knows only {findings.num_blobs - len(findings.unknown)} of "
                    f"{findings.num_blobs} files; it probably belongs to another store, nothing was removed",
                    err=True,
                )
                raise typer.Exit(2)
            repair(services, findings)
            for sha256 in findings.damaged:
                services.store.checks.set_aside(sha256)
            with rows.write() as connection:
                audit.record(connection, operator(audit.SERVER), "store clean")
    _tell(findings, removed=action is StoreAction.CLEAN, content=content, as_json=as_json)
    if findings.lost or findings.damaged:
        raise typer.Exit(1)


def _tell(findings: "Findings", *, removed: bool, content: bool, as_json: bool) -> None:
    if as_json:
        typer.echo(
            json.dumps(
                {
                    "num_blobs": findings.num_blobs,
                    "removed": removed,
                    "unknown": sorted(findings.unknown),
                    "unreferenced": sorted(sha256 for _, sha256 in findings.unreferenced),
                    "staged": sorted(findings.staged),
                    "parts": sorted(key for key, _ in findings.parts),
                    "lost": sorted(findings.lost),
                    **({"damaged": sorted(findings.damaged)} if content else {}),
                }
            )
        )
        return
    done = "removed" if removed else "to remove"
    size = sum(findings.unknown.values())
    by_sweep = " by the next sweep" if removed else ""
    lines = [
        f"{findings.num_blobs} files in the store",
        f"{len(findings.unknown)} without a row ({size} bytes), {done}",
        f"{len(findings.unreferenced)} that nothing refers to, {done}{by_sweep}",
        f"{len(findings.staged)} sent and never taken over, {done}",
        f"{len(findings.parts)} uploads in parts never completed, {done}",
        f"{len(findings.lost)} lost",
        *(f"  {sha256}" for sha256 in findings.lost),
        f"{len(findings.damaged)} with damaged contents"
        if content
        else "contents were not read; --content compares them with their hashes",
        *(f"  {sha256}" for sha256 in findings.damaged),
    ]
    typer.echo("\n".join(lines))

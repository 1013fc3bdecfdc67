"""`lambent serve` and `lambent keys`."""

import logging
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from lambent_server.core.settings import Settings
    from lambent_server.database.engine import Database

DataOption = Annotated[Path | None, typer.Option(help="Folder of the database, the files and the key.")]
DatabaseOption = Annotated[str | None, typer.Option(help="SQLAlchemy URL; SQLite in --data by default.")]


def settings_of(**given: Any) -> "Settings":
    """Return the settings; exit with code 2 and one line for each invalid one."""
    from pydantic import ValidationError
    from pydantic_settings import SettingsError

    from lambent_server.core.settings import Settings

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        reasons = [f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()]
    except SettingsError as error:
        reasons = [f"{error}; it must be JSON"]
    for reason in reasons:
        typer.echo(f"serve.setting_invalid: {reason}", err=True)
    raise typer.Exit(2)


@contextmanager
def opened_database(command: str, **given: Any) -> Iterator[tuple["Settings", "Database"]]:
    """Yield the settings and the database of a server, running or not.

    What goes wrong meanwhile ends the command with one line: exit code 4 for what was refused, else 2.
    """
    from obstore.exceptions import BaseError
    from sqlalchemy.exc import SQLAlchemyError

    from lambent_server.api.problems import Problem
    from lambent_server.cluster.shared_secrets import is_data_folder
    from lambent_server.core.settings import ServeError
    from lambent_server.database.latest_time import begin_time
    from lambent_server.database.revision import UnreleasedSchemaError
    from lambent_server.services import open_database

    settings, code = settings_of(**given), 2
    try:
        if is_data_folder(settings.data):
            with closing(open_database(settings)) as database:
                begin_time(database)
                yield settings, database
            return
        line = f"no_server: {settings.data} is not the data folder of a server; give --data"
    except UnreleasedSchemaError as error:
        line = f"data_unreleased: {error}"
    except Problem as problem:
        line, code = f"{problem.code}: {problem.detail}", 4
    except (ValueError, ServeError, OSError, SQLAlchemyError, BaseError) as error:
        line = f"failed: {str(error).splitlines()[0]}"
    typer.echo(f"{command}.{line}", err=True)
    raise typer.Exit(code)


def serve(
    data: DataOption = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes any free one.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Allow an address that other machines can reach, without TLS.")
    ] = False,
    executor: Annotated[
        str | None, typer.Option(help="Where jobs run: local, or ray for a Ray cluster.")
    ] = None,
    database: DatabaseOption = None,
    store: Annotated[
        str | None, typer.Option(help="URL of the blob store; a folder in --data by default.")
    ] = None,
) -> None:
    """Run the server: REST interface, web page, queue and local runs. Ctrl-C ends it and its runs."""
    import asyncio

    from lambent_server.core.logs import configure_logs
    from lambent_server.core.settings import ServeError
    from lambent_server.serving import Ready, run

    settings = settings_of(
        data=data,
        port=port,
        host=host,
        insecure=insecure or None,
        executor=executor,
        database=database,
        store=store,
    )
    configure_logs(settings.log_json)

    def tell(ready: Ready) -> None:
        typer.echo(f"Lambent serves {ready.url}")
        typer.echo(f"Open (once): {ready.login_url}")
        key = "lambent keys create NAME" if ready.key_file is None else ready.key_file
        typer.echo(f"Key for programs: {key}")
        sys.stdout.flush()

    try:
        asyncio.run(run(settings, tell))
    except ServeError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from error
    finally:
        logging.shutdown()


class KeyAction(StrEnum):
    """What `lambent keys` does."""

    CREATE = "create"
    LIST = "list"
    REVOKE = "revoke"
    ROTATE = "rotate"


def keys(
    action: Annotated[KeyAction, typer.Argument(help="What to do.")],
    key: Annotated[
        str, typer.Argument(metavar="NAME|ID", help="Name of a key to create, or id of one to change.")
    ] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Create, list, revoke and replace keys in the server's data folder, whether it is running or not."""
    from lambent_server.accounts import audit
    from lambent_server.accounts import keys as key_rows
    from lambent_server.accounts.who import operator
    from lambent_server.database.model import KeyRow
    from lambent_server.database.rows import many
    from lambent_server.database.schema import api_keys
    from lambent_server.database.tenancy import DEFAULT_TENANT_ID, Tenant, rows

    if bool(key) == (action is KeyAction.LIST):
        raise typer.BadParameter("create takes a name, revoke and rotate take an id, list takes neither")
    tenant, made = Tenant(DEFAULT_TENANT_ID), None
    with (
        opened_database("keys", data=data, database=database) as (settings, opened),
        opened.write() as connection,
    ):
        if action is KeyAction.LIST:
            for each in many(connection, rows(tenant, api_keys).order_by(api_keys.c.id.desc()), KeyRow):
                row = key_rows.show(each)
                ends = f"revoked {row.revoked_at}" if row.revoked_at else row.expires_at or "no end"
                typer.echo("\t".join((row.id, row.name, row.created_at, row.last_used_at or "unused", ends)))
            return
        if action is KeyAction.CREATE:
            made = key_rows.create(connection, tenant, key_rows.NewKey(name=key))
            key = made.id
        elif action is KeyAction.ROTATE:
            made = key_rows.rotate(connection, tenant, key)
        else:
            key_rows.revoke(connection, tenant, key)
        audit.record(connection, operator(tenant), f"keys {action}", key)
    if made is not None:
        key_rows.keep_in_file(settings.data, made)
        typer.echo(made.key)

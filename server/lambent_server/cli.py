"""`lambent serve`."""

import logging
import sys
from pathlib import Path
from typing import Annotated, Any

import typer


def serve(
    data: Annotated[Path | None, typer.Option(help="Folder of database, files and key.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes any free one.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="Allow an address that other machines can reach, without TLS.")
    ] = False,
    executor: Annotated[str | None, typer.Option(help="Where jobs run: local.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; SQLite in --data by default.")] = None,
    store: Annotated[
        str | None, typer.Option(help="URL of the blob store; a folder in --data by default.")
    ] = None,
) -> None:
    """Run the server: REST interface, web page, queue and local runs. Ctrl-C ends it and its runs."""
    import asyncio

    from pydantic import ValidationError
    from pydantic_settings import SettingsError

    from lambent_server.logs import configure_logs
    from lambent_server.serving import Ready, ServeError, run
    from lambent_server.settings import Settings

    given: dict[str, Any] = {
        "data": data,
        "port": port,
        "host": host,
        "insecure": insecure or None,
        "executor": executor,
        "database": database,
        "store": store,
    }
    try:
        settings = Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        for each in error.errors():
            name = ".".join(map(str, each["loc"]))
            typer.echo(f"serve.setting_invalid: {name}: {each['msg']}", err=True)
        raise typer.Exit(2) from error
    except SettingsError as error:
        typer.echo(f"serve.setting_invalid: {error}; it must be JSON", err=True)
        raise typer.Exit(2) from error
    configure_logs(settings.log_json)

    def tell(ready: Ready) -> None:
        typer.echo(f"Lambent serves {ready.url}")
        typer.echo(f"Open (once): {ready.login_url}")
        typer.echo(f"Key for programs: {ready.key_file}")
        sys.stdout.flush()

    try:
        asyncio.run(run(settings, tell))
    except ServeError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from error
    finally:
        logging.shutdown()

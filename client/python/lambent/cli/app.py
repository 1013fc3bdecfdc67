"""The root command: lists sub-commands from a table and imports the one that is called."""

import importlib
import json
import sys
from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Annotated, Any

import typer
from lambent_core.errors import pip_install
from typer.core import TyperCommand, TyperGroup

from lambent.cli.table import ENTRIES, Entry
from lambent.errors import LambentError, UsageProblemError

ENTRY_POINT_GROUP = "lambent.commands"
_BY_NAME = {entry.name: entry for entry in ENTRIES}


class LazyGroup(TyperGroup):
    """A group whose commands are lines of a table until one of them is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names in the order of the table."""
        return [entry.name for entry in ENTRIES]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command that knows its name and summary only."""
        entry = _BY_NAME.get(cmd_name)
        if entry is None:
            return _load(cmd_name) if _find_entry_point(cmd_name) else None
        return TyperCommand(name=entry.name, help=entry.summary, rich_help_panel=entry.panel)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the real command for the name that was typed."""
        # For "did you mean": the parent class looks its suggestions up here.
        self.commands = dict.fromkeys(_BY_NAME)  # type: ignore[assignment]
        name, stub, rest = super().resolve_command(ctx, args)
        return name, None if stub is None or name is None else _load(name), rest


def _find_entry_point(name: str) -> Any:
    return next(iter(entry_points(group=ENTRY_POINT_GROUP, name=name)), None)


def _load(name: str) -> Any:
    """Return the typer command behind a name; exit code 2 with the extra to install when it cannot load."""
    entry = _BY_NAME.get(name)
    try:
        if entry is not None and entry.module:
            function = getattr(importlib.import_module(f"lambent.cli.{entry.module}"), name)
        else:
            point = _find_entry_point(name)
            if point is None:
                raise missing_extra(name)
            function = point.load()
    except ModuleNotFoundError as error:
        raise missing_extra(name, error) from error
    app = function
    if not isinstance(function, typer.Typer):
        app = typer.Typer(add_completion=False)
        app.command(name)(function)
    return typer.main.get_command(app)


def missing_extra(name: str, error: ModuleNotFoundError | None = None) -> UsageProblemError:
    """Return the error for a command whose packages are not installed."""
    extra = _BY_NAME[name].extra if name in _BY_NAME else ""
    reason = f"the package {error.name!r} is not installed" if error else "it is not installed"
    return UsageProblemError(
        "cli.missing_extra", f"`lambent {name}` cannot start: {reason}", pip_install(*filter(None, [extra]))
    )


def _print_version(value: bool) -> None:
    if value:
        from lambent import __version__

        typer.echo(f"lambent {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Photographs of an object in, a relightable asset out."""


def build() -> Any:
    """Return the root command."""
    app = typer.Typer(cls=LazyGroup, add_completion=False, no_args_is_help=True)
    app.callback()(_root)
    return typer.main.get_command(app)


def run(args: Sequence[str]) -> int:
    """Run the command line with `args` and return its exit code; messages go to standard error."""
    name = next((arg for arg in args if not arg.startswith("-")), "")
    try:
        build().main(args=list(args), prog_name="lambent")
    except LambentError as error:
        return _fail(error, as_json="--json" in args)
    except ModuleNotFoundError as error:
        if not _is_missing_package(error, _BY_NAME.get(name)):
            raise
        return _fail(missing_extra(name, error), as_json="--json" in args)
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
        if code == 130:
            print("stopped; run the same command again to continue", file=sys.stderr)
        return code
    return 0


def _is_missing_package(error: ModuleNotFoundError, entry: Entry | None) -> bool:
    """Return whether a command found a third-party package missing (a module of ours is a fault of ours)."""
    root = (error.name or "").partition(".")[0]
    return entry is not None and bool(root) and not root.startswith(("lambent", "flashcache"))


def _fail(error: LambentError, *, as_json: bool) -> int:
    if as_json:
        pointers = [{"pointer": e.pointer, "message": e.message} for e in getattr(error, "errors", ())]
        fault = {"code": error.code, "message": error.message, "advice": error.advice, "errors": pointers}
        print(json.dumps({"error": fault}), flush=True)
    else:
        print(f"error: {error}", file=sys.stderr)
    return error.exit_code

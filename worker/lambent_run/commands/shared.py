"""Options, error messages and the handling of Ctrl-C that the commands share."""

import functools
import importlib.util
import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from lambent_core.errors import SceneRefusedError, UsageError, WorkerError, pip_install

Json = Annotated[bool, typer.Option("--json", help="Write machine-readable lines to standard output.")]
Layout = Annotated[str, typer.Option(help="Read the folder as this layout instead of detecting it.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of every random number.")]
Masks = Annotated[
    Path | None, typer.Option(help="Folder of masks named like the pictures; they go before others.")
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one setting of the preset.")
]
Views = Annotated[int, typer.Option(min=0, help="Test views, evenly spaced; 0 for all.")]
Repeats = Annotated[int, typer.Option(min=1, help="Repeats behind every Monte Carlo picture.")]
Directions = Annotated[int, typer.Option(min=4, help="Secondary rays per pixel and repeat.")]
Antialias = Annotated[
    int, typer.Option(min=1, max=4, help="Camera rays along each side of a pixel; 1 as in the paper.")
]
MaxSide = Annotated[int, typer.Option(min=0, help="Longer side in pixels; 0 for that of the files.")]
Shadows = Annotated[str, typer.Option(help="Cache behind shadows in new light: fast, or nerf.")]
Threads = Annotated[int, typer.Option(min=0, help="Cores to use; 0: OMP_NUM_THREADS, else all there are.")]
Device = Annotated[str, typer.Option(help="cpu, cuda, or cuda:N; by default what the run has, else cpu.")]


def reporting_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Turn our errors into a message and the command line's exit codes; anything else stays a traceback."""

    @functools.wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except Exception as error:
            known = _as_worker_error(error)
            if known is None:
                raise
            _tell(known, as_json=bool(kwargs.get("as_json")))
            raise typer.Exit(known.exit_code) from None

    return wrapped


def _as_worker_error(error: Exception) -> WorkerError | None:
    """Return the error as one of ours, also where the method raised it, or None for a mistake of ours."""
    from flashcache.errors import ConfigError, FlashCacheError

    if isinstance(error, WorkerError):
        return error
    if isinstance(error, ConfigError):
        return UsageError("config.invalid", str(error))
    return WorkerError("training.failed", str(error)) if isinstance(error, FlashCacheError) else None


def _tell(error: WorkerError, *, as_json: bool) -> None:
    """Print an error as every command of ours does: a line, or one JSON object on standard output."""
    if not as_json:
        typer.echo(f"error: {error}", err=True)
        return
    findings = error.report.findings if isinstance(error, SceneRefusedError) else []
    problems = [{"pointer": f.subject, "message": f"{f.code}: {f.message}"} for f in findings]
    fault = {"code": error.code, "message": error.message, "advice": "", "errors": problems}
    typer.echo(json.dumps({"error": fault}))


def require_worker(form: str, instead: str) -> None:
    """Raise `UsageError` `cli.missing_extra` where torch is not installed, which only some forms need.

    `form` names what was asked for, `instead` says what the extra `capture` can do.
    """
    if importlib.util.find_spec("torch") is None:
        raise UsageError(
            "cli.missing_extra",
            f"{form} needs torch, which is not installed: {pip_install('worker')}; {instead}",
        )


@contextmanager
def stopping_on_signals(request_stop: Callable[[], None]) -> Iterator[None]:
    """Ask the run to end on the first Ctrl-C or SIGTERM; a second one ends the process at once."""

    def handle(number: int, frame: object) -> None:
        request_stop()
        typer.echo("stopping after this step; once more to stop at once", err=True)
        signal.signal(number, signal.default_int_handler)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

"""demo: from the bundled sample to relit pictures."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from lambent_core.errors import pip_install

from lambent.cli.doctor import missing_packages
from lambent.cli.output import JsonOption, Output
from lambent.errors import UsageProblemError


def demo(
    folder: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Where bundle and pictures go.")
    ] = Path("demo"),
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Data folder of the server; else DIR/data.")
    ] = None,
    preset: Annotated[str, typer.Option("--preset", "-p", help="Training preset.")] = "fast",
    seed: Annotated[int, typer.Option(help="Seed of every random number.", min=0)] = 0,
    keep: Annotated[
        bool | None, typer.Option("--keep/--no-keep", help="Leave the server running until Ctrl-C.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Serve, push the bundled sample, train it, relight it under two unseen lights, compare with the truth.

    Takes some minutes on two cores. Ctrl-C leaves nothing running; run again, it continues where it was.
    On a terminal the server stays at the end, so that its page can be looked at (--no-keep: not).
    """
    for extra in ("client", "capture", "server", "worker"):
        missing = missing_packages(extra)
        if missing:
            raise UsageProblemError(
                "cli.missing_extra",
                f"the demo runs a server and a worker; not installed: {', '.join(missing)}",
                pip_install("server", "worker"),
            )
    # The demo talks to its own server, whatever server this shell is set up for.
    for name in ("LAMBENT_URL", "LAMBENT_API_KEY", "LAMBENT_DATA"):
        os.environ.pop(name, None)
    from lambent_pages.loopback import ending_like_ctrl_c

    from lambent.cli.demo_run import run_demo

    stays = sys.stdin.isatty() and sys.stderr.isatty() if keep is None else keep
    with ending_like_ctrl_c():
        run_demo(
            folder,
            data=data or folder / "data",
            preset=preset,
            seed=seed,
            keep=stays and not as_json,
            output=Output(as_json),
        )

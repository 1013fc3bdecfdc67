"""The command that finds cameras for photographs without any."""

import json
import time
from pathlib import Path
from typing import Annotated

import typer
from lambent_core.errors import Stopped

from lambent_run.commands.shared import Json, Seed, reporting_errors, stopping_on_signals

DOING = {
    "features": "photographs looked at",
    "survey": "pairs compared roughly",
    "pairs": "pairs matched",
    "cameras": "photographs placed",
}
EVERY_S = 2.0
"""Seconds between two lines of progress of one phase."""


@reporting_errors
def poses(
    photographs: Annotated[Path, typer.Argument(help="Folder of photographs, or with images/ and masks/.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the capture; made by this command.")],
    masks: Annotated[
        Path | None, typer.Option(help="Folder of masks named like the pictures; only what they show counts.")
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Find cameras for photographs with COLMAP and write a capture that train and check take.

    After Ctrl-C the same command continues from there.
    """
    from lambent_capture.poses.capture import solve_capture, summary
    from lambent_capture.poses.solve import PoseSettings

    told = ShownProgress()
    with stopping_on_signals(told.stop):
        record = solve_capture(photographs, out, masks, PoseSettings(seed=seed), told)
    if as_json:
        typer.echo(json.dumps(record))
        return
    typer.echo(summary(record))
    for finding in record["findings"]:
        typer.echo(f"note: {finding['code']}: {finding['message']}")
    typer.echo(f'continue with: lambent check "{out}"')


class ShownProgress:
    """Progress of a search on standard error: each phase's numbers now and then, and its last."""

    def __init__(self) -> None:
        self._stopping = False
        self._phase, self._shown_at = "", 0.0

    def stop(self) -> None:
        """End the search the next time that it tells of progress."""
        self._stopping = True

    def __call__(self, phase: str, done: int, total: int) -> None:
        """Show that `done` of `total` are done; raises `Stopped` once asked to."""
        if self._stopping:
            raise Stopped
        now = time.monotonic()
        if phase != self._phase or done == total or now - self._shown_at >= EVERY_S:
            typer.echo(f"{done} of {total} {DOING[phase]}", err=True)
            self._phase, self._shown_at = phase, now

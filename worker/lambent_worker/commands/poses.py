"""The command that finds cameras for photographs without any."""

import json
from pathlib import Path
from typing import Annotated

import typer

from lambent_worker.commands.shared import Json, Seed, reporting_errors


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
    """Find cameras for photographs with COLMAP and write a capture that train and check take."""
    from lambent_worker.poses.capture import solve_capture, summary
    from lambent_worker.poses.solve import PoseSettings

    record = solve_capture(photographs, out, masks, PoseSettings(seed=seed), tell_progress)
    if as_json:
        typer.echo(json.dumps(record))
        return
    typer.echo(summary(record))
    for finding in record["findings"]:
        typer.echo(f"note: {finding['code']}: {finding['message']}")
    typer.echo(f'go on with: lambent check "{out}"')


def tell_progress(text: str) -> None:
    """Print progress to standard error."""
    typer.echo(text, err=True)

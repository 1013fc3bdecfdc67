"""The command that finds where the object is in each picture, to be looked at before training."""

import json
from pathlib import Path
from typing import Annotated

import typer

from lambent_worker.commands.shared import Json, Layout, reporting_errors


@reporting_errors
def masks(
    scene_dir: Annotated[Path, typer.Argument(help="Folder of a capture.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for masks/ and masks.jpg.")],
    segmenter: Annotated[
        str,
        typer.Option(help="module:callable, or a name that a package offers, instead of the estimate."),
    ] = "",
    layout: Layout = "",
    as_json: Json = False,
) -> None:
    """Find the object in each picture and write masks, with thumbnails to confirm them by."""
    from lambent_worker.masks.folder import write_masks
    from lambent_worker.masks.segmenter import find_segmenter
    from lambent_worker.masks.sparse import sparse_points
    from lambent_worker.scenes.detect import describe_scene

    chosen = find_segmenter(segmenter) if segmenter else None
    manifest = describe_scene(scene_dir, layout or None)
    points = None if chosen is not None else sparse_points(scene_dir, manifest)
    written = write_masks(scene_dir, manifest, out, chosen, points=points)
    if as_json:
        record = {
            "masks": str(written.folder),
            "sheet": str(written.sheet),
            "overlap": round(written.overlap, 4),
            "doubtful": list(written.doubtful),
        }
        if not written.reason:
            typer.echo(json.dumps(record))
        written.require_credible()
        return
    written.require_credible()
    if not segmenter:
        typer.echo(f"the views agree to {100.0 * written.overlap:.0f} %")
    for name in written.doubtful:
        typer.echo(f'note: the others see frame "{name}" differently; look at its mask')
    typer.echo(f"thumbnails: {written.sheet}")
    typer.echo(f'look at them, then: lambent train "{scene_dir}" --masks "{written.folder}" -o RUN_DIR')

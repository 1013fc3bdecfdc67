"""The command that looks at a capture before any training."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from lambent_run.commands.shared import Json, Layout, Masks, reporting_errors, require_worker


@reporting_errors
def check(
    scene_dir: Annotated[Path, typer.Argument(help="Folder of a capture.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for capture.html and capture.json.")
    ] = None,
    masks: Masks = None,
    layout: Layout = "",
    grey_card: Annotated[
        str, typer.Option(metavar="PHOTOGRAPH:X,Y,W,H[:R]", help="A grey card, as train takes it.")
    ] = "",
    as_json: Json = False,
) -> None:
    """Say what is wrong with a capture before any training; exit code 4 if it cannot be used."""
    from lambent_run.run.card_option import look_for_photograph, parse_grey_card

    card = parse_grey_card(grey_card) if grey_card else None
    if card is not None:
        look_for_photograph(scene_dir, card)
    from lambent_capture.checks.check import check_capture
    from lambent_capture.checks.check_result import capture_record

    checked = check_capture(scene_dir, layout or None, masks)
    record = capture_record(checked)
    if out is not None:
        from lambent_capture.checks.page import write_capture_report

        write_capture_report(out, scene_dir.resolve().name, checked)
    if as_json:
        typer.echo(json.dumps(record))
    else:
        _tell(scene_dir, record, out)
    if not checked.report.usable:
        raise typer.Exit(4)
    if card is not None and not lacks_cameras(record):
        require_worker(
            "--grey-card of a capture with cameras",
            "without --grey-card the same capture is checked, all but the card",
        )
        from lambent_run.run.card_pixels import check_in_capture

        check_in_capture(card, scene_dir, layout or None, masks, checked.left_out)


def lacks_cameras(record: dict[str, Any]) -> bool:
    """Return whether a usable capture is of photographs whose cameras are still to be found."""
    return bool(record["layout"] == "photographs")


def _tell(scene_dir: Path, record: dict[str, Any], out: Path | None) -> None:
    for finding in record["findings"]:
        kind = "error" if finding["severity"] == "SEVERITY_ERROR" else "note"
        typer.echo(f"{kind}: {finding['code']}: {finding['message']}")
    verdict = "can be used" if record["usable"] else "cannot be used"
    if lacks_cameras(record) and record["usable"]:
        typer.echo(
            f'"{scene_dir}" {verdict}: {record["num_train_frames"]} photographs without cameras; lambent '
            "train finds cameras and cuts the object out (lambent poses and lambent masks, for a look first)"
        )
        return
    typer.echo(
        f'"{scene_dir}" {verdict}: {record["layout"] or "no known layout"}, '
        f"{record['num_train_frames']} training and {record['num_test_frames']} test views"
    )
    if out is not None:
        typer.echo(f"report: {out / 'capture.html'}")

"""The command that cuts the object out of each picture, to be looked at and corrected."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from lambent_core.errors import UsageError
from lambent_core.measured import measured

from lambent_run.commands.shared import Json, Layout, reporting_errors, require_worker, stopping_on_signals

if TYPE_CHECKING:
    from lambent_capture.masks.folder import WrittenMasks

    from lambent_run.console_reporter import ConsoleReporter
    from lambent_run.run.spec import RunSpec

SEGMENTED = "segmented"
"""Folder in that of a run for the masks of an external segmenter."""


@reporting_errors
def masks(
    scene_dir: Annotated[Path, typer.Argument(help="Folder of photographs, or of a capture.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="Run folder; of a capture with cameras, folder for masks/ and masks.jpg."
        ),
    ],
    segmenter: Annotated[
        str,
        typer.Option(help="module:callable, or a name that a package offers, instead of the estimate."),
    ] = "",
    edit: Annotated[
        bool, typer.Option("--edit", help="Correct them on a page in the browser; -o is a run folder.")
    ] = False,
    layout: Layout = "",
    as_json: Json = False,
) -> None:
    """Cut the object out of each photograph, with thumbnails to confirm it by, or a page to correct it."""
    if edit and segmenter:
        raise UsageError(
            "config.edit_segmenter",
            "--edit corrects what Lambent estimates itself; leave out --segmenter, or correct its masks with "
            "any paint program",
        )
    from lambent_capture.layouts.detect import detect_layout
    from lambent_core.layouts import PHOTOGRAPHS

    if not edit and (layout or detect_layout(scene_dir)) != PHOTOGRAPHS:
        _write(scene_dir, out, segmenter, layout, as_json=as_json)
        return
    from lambent_core.startup import prepare

    prepare()
    from lambent_run.console_reporter import ConsoleReporter
    from lambent_run.run.prepare import has_settings, preparation_of

    if has_settings(out):
        require_worker("a run folder with settings of the training", "choose another folder with -o")
    spec = preparation_of(scene_dir, out, layout)
    with ConsoleReporter(out, as_json=as_json) as reporter:
        if edit:
            _edit(spec, out, reporter, as_json=as_json)
        elif segmenter:
            _segment(spec, out, segmenter, reporter, as_json=as_json)
        else:
            _prepare(spec, out, reporter)
            _tell_prepared(spec, out, as_json=as_json)


def train_command(scene_dir: Path, run_dir: Path, *options: str) -> str:
    """Return the command that trains on what was prepared."""
    return shlex.join(["lambent", "train", str(scene_dir), *options, "-o", str(run_dir)])


def _write(scene_dir: Path, out: Path, segmenter: str, layout: str, *, as_json: bool) -> None:
    """Write the masks of a capture that has cameras."""
    from lambent_capture.layouts.detect import describe_scene
    from lambent_capture.masks.folder import write_masks
    from lambent_capture.masks.segmenter import find_segmenter
    from lambent_capture.masks.sparse import sparse_points

    chosen = find_segmenter(segmenter) if segmenter else None
    manifest = describe_scene(scene_dir, layout or None)
    points = None if chosen is not None else sparse_points(scene_dir, manifest)
    written = write_masks(scene_dir, manifest, out, chosen, points=points)
    _tell_written(scene_dir, written, out=Path("RUN_DIR"), segmented=bool(segmenter), as_json=as_json)


def _segment(
    spec: "RunSpec", out: Path, segmenter: str, reporter: "ConsoleReporter", *, as_json: bool
) -> None:
    """Find the cameras of photographs in a run folder, and write masks by an external segmenter there."""
    from lambent_capture.masks.folder import write_masks
    from lambent_capture.masks.segmenter import find_segmenter

    from lambent_run.run.capture import read_checked_manifest
    from lambent_run.run.prepare import open_task

    chosen = find_segmenter(segmenter)
    _prepare(spec, out, reporter, ("cameras", "ingest"))
    manifest = read_checked_manifest(open_task(out, "masks", reporter))
    written = write_masks(spec.scene, manifest, out / SEGMENTED, chosen)
    _tell_written(spec.scene, written, out=out, segmented=True, as_json=as_json)


def _prepare(
    spec: "RunSpec", out: Path, reporter: "ConsoleReporter", tasks: tuple[str, ...] | None = None
) -> None:
    from lambent_run.run.hashes import PREPARATION
    from lambent_run.run.pipeline import run_pipeline
    from lambent_run.run.prepare import device_for

    with stopping_on_signals(reporter.request_stop):
        run_pipeline(spec, out, device_for(out), reporter, tasks or PREPARATION)


def _edit(spec: "RunSpec", out: Path, reporter: "ConsoleReporter", *, as_json: bool) -> None:
    """Let a person correct the masks of a run, and draw them then."""
    from lambent_capture.editor.session import correct_masks

    from lambent_run.run.folder import locked
    from lambent_run.run.prepare import check_correctable, editing_of
    from lambent_run.run.spec import keep_run, read_run

    check_correctable(spec, out)
    _prepare(spec, out, reporter, ("cameras", "ingest"))
    device = read_run(out)[1]
    with locked(out):
        done = correct_masks(
            editing_of(out, reporter),
            spec.corrections,
            lambda corrections: keep_run(out, replace(spec, corrections=tuple(corrections)), device),
            command=train_command(spec.scene, out),
            tell=lambda text: typer.echo(text, err=True),
            opens=not as_json,
        )
    spec = replace(read_run(out)[0], scene=spec.scene)
    if done:
        _prepare(spec, out, reporter)
        _tell_prepared(spec, out, as_json=as_json)
    elif not as_json:
        typer.echo(f"{len(spec.corrections)} corrections are kept in {out}")
        typer.echo(f"continue with: {train_command(spec.scene, out)}")


def _tell_written(
    scene_dir: Path, written: "WrittenMasks", *, out: Path, segmented: bool, as_json: bool
) -> None:
    """Print where masks are that training gets by `--masks`; raises for ones that are not credible."""
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
    if not segmented:
        typer.echo(f"the views agree to {measured(100.0 * written.overlap)} %")
    _tell_doubtful(written.doubtful)
    typer.echo(f"thumbnails: {written.sheet}")
    typer.echo(f'look at them, then: lambent train "{scene_dir}" --masks "{written.folder}" -o {out}')


def _tell_prepared(spec: "RunSpec", out: Path, *, as_json: bool) -> None:
    """Print where the masks of a prepared run are, and the command that trains."""
    from lambent_capture.masks.folder import MASKS, SHEET
    from lambent_core.files import read_record

    from lambent_run.run.folder import task_folder
    from lambent_run.run.tasks.masks import AGREEMENT

    folder = task_folder(out, "masks")
    if not (folder / SHEET).is_file():
        record: dict[str, object] = {"run": str(out), "masks": "", "sheet": ""}
        lines = ["masks: those of the capture"]
    else:
        agreement = read_record(folder / AGREEMENT)
        record = {"run": str(out), "masks": str(folder / MASKS), "sheet": str(folder / SHEET), **agreement}
        edit = shlex.join(["lambent", "masks", str(spec.scene), "-o", str(out), "--edit"])
        lines = [f"thumbnails: {folder / SHEET}", f"to correct them: {edit}"]
    if as_json:
        typer.echo(json.dumps(record))
        return
    for line in (*lines, f"continue with: {train_command(spec.scene, out)}"):
        typer.echo(line)


def _tell_doubtful(doubtful: tuple[str, ...]) -> None:
    for name in doubtful:
        typer.echo(f'note: the others see frame "{name}" differently; look at its mask')

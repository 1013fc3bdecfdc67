"""batch: assets x environments x cameras x qualities into files, on this machine or on a server."""

import time
from pathlib import Path
from typing import Annotated

import typer
from lambent_compute.threads import available_threads
from lambent_relight.batch.manifest import Manifest
from lambent_relight.batch.plan import Plan, make_plan
from lambent_relight.batch.reading import ManifestError, read_manifest

from lambent.cli.batch_report import list_failures, report
from lambent.cli.output import FilesOption, JsonOption, Output, UrlOption, format_duration
from lambent.cli.rendering import relight_errors, shown_batch
from lambent.errors import UsageProblemError
from lambent.manifest_file import Document, load_document


def batch(
    manifest: Annotated[Path, typer.Argument(metavar="MANIFEST", help="What to render; YAML or JSON.")],
    output_folder: FilesOption,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", help="Processes that render; 0: one per core.", min=0, max=256)
    ] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List the work and render nothing.")] = False,
    server: Annotated[bool, typer.Option("--server", help="Render on the server, then fetch.")] = False,
    shards: Annotated[
        int, typer.Option(help="With --server: jobs to split into; 0: as many as run at once.", min=0, max=64)
    ] = 0,
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Render everything a manifest asks for into DIR, with pictures.csv and contact_sheet.png.

    Run again, it makes only what is missing or made from other input. Exit code 1 when a picture failed.
    """
    output = Output(as_json)
    document = load_document(manifest)
    asked = _read(document)
    if server:
        from lambent.cli.batch_server import batch_on_server

        if dry_run:
            raise typer.Exit(_list_server_work(asked, document, output_folder, output, url))
        raise typer.Exit(batch_on_server(asked, document, output_folder, output, url=url, shards=shards))
    from lambent.batch_inputs import plan_here, with_local_bundles

    with relight_errors():
        if dry_run:
            plan = plan_here(asked, output.note, url=url)
            raise typer.Exit(_list_work(plan, asked, document, output_folder, output))
        plan = make_plan(with_local_bundles(asked, output_folder, output.note, url=url))
        raise typer.Exit(_render(plan, asked, document, output_folder, output, jobs or available_threads()))


def _read(document: Document) -> Manifest:
    """Return the manifest; raises `batch.manifest` with every problem and its line."""
    try:
        return read_manifest(document.value, document.path.parent)
    except ManifestError as error:
        lines = [f"{document.where(each.pointer)}: {each.message}" for each in error.problems[:20]]
        if len(error.problems) > len(lines):
            lines.append(f"and {len(error.problems) - len(lines)} more")
        text = "\n  ".join([f"{len(error.problems)} problem(s)", *lines])
        raise UsageProblemError("batch.manifest", text, error.advice) from error


def _list_server_work(manifest: Manifest, document: Document, folder: Path, output: Output, url: str) -> int:
    """Print what a server would be asked for and return the exit code."""
    from lambent.batch_inputs import plan_on_server
    from lambent.client import Client

    with Client(url) as client, relight_errors():
        plan, to_send = plan_on_server(manifest, client, output.note)
        for path in to_send:
            output.note(f"to send: {path}")
        return _list_work(plan, manifest, document, folder, output)


def _list_work(plan: Plan, manifest: Manifest, document: Document, folder: Path, output: Output) -> int:
    """Print what would be done and return the exit code."""
    from lambent_relight.batch.journal import peek_journal
    from lambent_relight.batch.run import sort_plan

    done, tasks = sort_plan(plan, manifest.files, peek_journal(folder), copy=False)
    todo = {row.path: suffixes for row, suffixes in tasks}
    for row in plan.rows:
        state = f"make {','.join(todo[row.path])}" if row.path in todo else "keep"
        pixels = f"{row.camera.width}x{row.camera.height}"
        text = f"{state:13} {row.path}  {pixels} {row.quality.quality}"
        output.result(text, {"picture": row.path, "files": list(todo.get(row.path, ()))})
    list_failures(plan.failures, document, output)
    counts = {"to_make": len(todo), "to_keep": len(done), "failed": len(plan.failures)}
    text = f"{counts['to_make']} to make, {counts['to_keep']} to keep, {counts['failed']} cannot be made"
    output.result(text, {"path": str(folder), **counts})
    return 1 if plan.failures else 0


def _render(
    plan: Plan, manifest: Manifest, document: Document, folder: Path, output: Output, num_jobs: int
) -> int:
    """Make what is missing, write table and sheet, and return the exit code."""
    from lambent_relight.batch.journal import open_journal
    from lambent_relight.batch.run import Result
    from lambent_relight.batch.sheet_lights import light_pictures
    from lambent_relight.batch.summary import TABLE, write_sheets, write_table

    began = time.monotonic()
    results: list[Result] = []
    files = manifest.files.model_copy(update={"linear": True})
    with open_journal(folder) as journal:
        try:
            # One by one: what there is when Ctrl-C comes is in the table.
            for result in shown_batch(plan, files, journal, output, num_jobs=num_jobs):
                results.append(result)  # noqa: PERF402
        finally:
            write_table(folder / TABLE, results)
        sheets = write_sheets(folder, results, title=manifest.name, lights=light_pictures(manifest))
    shown = report(results, folder, sheets, document, output)
    counts = shown["states"]
    notes = sorted({note for each in results if each.record is not None for note in each.record.notes})
    for note in notes:
        output.note(note)
    text = (
        f"{folder}  ({counts['made']} made, {counts['kept'] + counts['copied']} kept, "
        f"{counts['failed']} failed, {format_duration(time.monotonic() - began)})"
    )
    output.result(text, {**shown, "notes": notes})
    return 1 if shown["failures"] else 0

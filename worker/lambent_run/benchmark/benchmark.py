"""Runs a whole benchmark: run, combine, write the tables."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lambent_core.errors import UsageError
from lambent_core.files import read_record, whole_file, write_json

from lambent_run.benchmark.plan import Cell
from lambent_run.benchmark.results import average_rows, differences, finished, scene_rows
from lambent_run.benchmark.runner import Part, parts_of, run_parts
from lambent_run.benchmark.tables import ABLATION_COLUMNS, Content, as_csv, as_json, markdown
from lambent_run.console_reporter import format_duration
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.folder import locked

MARKER = "benchmark.json"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a benchmark."""

    markdown: str
    failed: tuple[str, ...]
    """Titles of the failed processes, with the paths of their logs."""


def run_benchmark(
    cells: Sequence[Cell],
    *,
    out: Path,
    preset: str,
    evaluation: EvaluationRequest,
    jobs: int,
    devices: Sequence[str],
    tell: Callable[[str], None],
) -> Outcome:
    """Compute the cells that are missing and write `table.md`, `table.csv` and `table.json` into `out`.

    Called again after a kill, it resumes: finished cells are kept by the hash of their inputs, others
    continue from their checkpoints. Raises `UsageError` where `out` holds something else, and `Stopped` on
    Ctrl-C.
    """
    _check_folder(out)
    with locked(out):
        write_json(out / MARKER, {"preset": preset, "cells": [cell.name for cell in cells]})
        parts = parts_of(cells, out)
        failed = run_parts(parts, jobs=jobs, devices=devices, event=_narrator(tell, len(parts)))
        lines = tuple(f"{part.title}: see {part.folder / 'log.txt'}" for part in failed)
        text = write_tables(cells, out, preset, lines, evaluation)
    return Outcome(text, lines)


def write_tables(
    cells: Sequence[Cell], out: Path, preset: str, failed: Sequence[str], evaluation: EvaluationRequest
) -> str:
    """Write the tables of the cells that are done, and return them as Markdown."""
    results = finished(cells, out)
    rows = scene_rows(results)
    content = Content(
        preset=preset,
        rows=rows,
        averages=average_rows(rows),
        differences=differences(results, [name for _, name in ABLATION_COLUMNS]),
        failed=failed,
        notes=_notes(cells, out, evaluation),
    )
    text = markdown(content)
    for name, written in (("md", text), ("csv", as_csv(content)), ("json", as_json(content))):
        with whole_file(out / f"table.{name}") as partial:
            partial.write_text(written, encoding="utf-8")
    return text


def _notes(cells: Sequence[Cell], out: Path, evaluation: EvaluationRequest) -> tuple[str, ...]:
    views = f"{evaluation.num_views} test views" if evaluation.num_views else "all test views"
    rays = f"{evaluation.antialias**2} camera and {evaluation.num_directions} secondary rays per pixel"
    notes = [f"Evaluated on {views}, {rays} x {evaluation.num_repeats} repeats."]
    if not evaluation.environments:
        notes.append("Not relit: no environment maps were given or found in the suite.")
    if not evaluation.lpips_weights:
        notes.append("LPIPS is absent: it needs network weights (--lpips-weights FILE).")
    revisions = {
        str(record["git_revision"])[:10]
        for cell in cells
        if (record := read_record(out / "cells" / cell.name / "result.json")).get("git_revision")
    }
    if len(revisions) > 1:
        notes.append(f"The runs were made by several revisions of the code: {', '.join(sorted(revisions))}.")
    return tuple(notes)


def _check_folder(out: Path) -> None:
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / MARKER).is_file())):
        raise UsageError(
            "benchmark.folder_not_empty", f'"{out}" holds something else; choose another folder with -o'
        )
    out.mkdir(parents=True, exist_ok=True)


def _narrator(tell: Callable[[str], None], total: int) -> Callable[[str, Part, float], None]:
    """Return a function that reports every process in one line, with the number of finished ones."""
    done = 0

    def event(what: str, part: Part, seconds: float) -> None:
        nonlocal done
        done += what in ("finished", "failed", "reused")
        took = f" after {format_duration(seconds)}" if what in ("finished", "failed") else ""
        more = f"; see {part.folder / 'log.txt'}" if what == "failed" else ""
        tell(f"[{done}/{total}] {part.title}: {what}{took}{more}")

    return event

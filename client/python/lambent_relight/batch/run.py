"""A batch from its plan to a folder of pictures; existing ones are kept."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from lambent_core.files import whole_file

from lambent_relight.batch.journal import Journal, MadeFile, Record
from lambent_relight.batch.manifest import LINEAR, Files, place
from lambent_relight.batch.plan import Failure, Plan, Row
from lambent_relight.batch.pool import Progress, Task, run_tasks
from lambent_relight.batch.studio import remove_partials
from lambent_relight.settings import BACKGROUNDS

State = Literal["made", "kept", "copied", "failed"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """The outcome of one picture; `record` is set unless it failed."""

    path: str
    state: State
    record: Record | None = None
    failure: Failure | None = None


def sort_plan(
    plan: Plan, files: Files, journal: Journal, *, copy: bool = True
) -> tuple[list[Result], list[Task]]:
    """Return the pictures that exist, under their name or copied from another, and those to make.

    A file is known by the hash of everything it is made from. One that lies under another name is copied,
    unless `copy` is False; then it is only listed. Where linear pictures are kept, a task without one among
    its files needs no rendering.
    """
    done: list[Result] = []
    tasks: list[Task] = []
    for row in plan.rows:
        kept = (*files.files, LINEAR) if files.linear else files.files
        known = {suffix: journal.known(suffix, row.path, row.key(suffix, files)) for suffix in kept}
        present = {suffix: made for suffix, made in known.items() if made is not None}
        in_place = {suffix: made for suffix, made in present.items() if made.path == place(row.path, suffix)}
        if not present.keys() >= set(files.files):
            # A file under another name may be overwritten before this picture's turn comes.
            wanted: list[str] = [suffix for suffix in files.files if suffix not in in_place]
            if files.linear and not (
                LINEAR in in_place and ("exr" not in wanted or _has_layers(row, files, journal))
            ):
                wanted.append(LINEAR)
            tasks.append((row, tuple(wanted)))
            continue
        source = _source(row, present, journal)
        if in_place == present and source.path == row.path:
            done.append(Result(path=row.path, state="kept", record=source))
            continue
        if copy:
            present = {suffix: _copied(journal.folder, row, suffix, made) for suffix, made in present.items()}
        record = replace(source, **row.names(), files=present)
        if copy:
            journal.add(record)
        done.append(Result(path=row.path, state="copied", record=record))
    return done, tasks


def run_batch(
    plan: Plan,
    files: Files,
    journal: Journal,
    *,
    num_jobs: int = 1,
    progress: Progress | None = None,
    strict: bool = False,
) -> Iterator[Result]:
    """Make what is missing and yield the result of every picture; what exists or cannot be made comes first.

    Each picture is in the journal before it is yielded, so nothing is lost where the caller stops.
    `num_jobs`, `progress` and `strict` as in `run_tasks`.
    """
    remove_partials(journal.folder, plan.rows)
    done, tasks = sort_plan(plan, files, journal)
    yield from done
    for failure in plan.failures:
        yield Result(path=failure.path, state="failed", failure=failure)
    pictures = run_tasks(tasks, journal.folder, files, num_jobs=num_jobs, progress=progress, strict=strict)
    try:
        for row, made in pictures:
            if isinstance(made, Failure):
                failure = replace(made, pointer=row.pointer)
                yield Result(path=row.path, state="failed", failure=failure)
                continue
            before = journal.records.get(row.path)
            kept = before.files if before is not None else {}
            both = {**kept, **made.files}
            wanted = (*files.files, LINEAR) if files.linear else files.files
            record = replace(made, files={suffix: both[suffix] for suffix in wanted})
            journal.add(record)
            yield Result(path=row.path, state="made", record=record)
    finally:
        # Processes that are at work when the caller stops are ended, perhaps while they write.
        pictures.close()
        remove_partials(journal.folder, plan.rows)


def _has_layers(row: Row, files: Files, journal: Journal) -> bool:
    """Return whether the picture's EXR lies in its place, before whatever background."""
    record = journal.records.get(row.path)
    made = record.files.get("exr") if record is not None else None
    return (
        made is not None
        and made.path == place(row.path, "exr")
        and made.key in {row.before(each).key("exr", files) for each in BACKGROUNDS}
        and journal.is_whole(made)
    )


def _source(row: Row, present: dict[str, MadeFile], journal: Journal) -> Record:
    """Return the record that says what was measured on a picture that exists."""
    own = journal.records.get(row.path)
    if own is not None and all(own.files.get(suffix) == made for suffix, made in present.items()):
        return own
    paths = {made.path for made in present.values()}
    return next(
        record
        for record in journal.records.values()
        if any(made.path in paths for made in record.files.values())
    )


def _copied(folder: Path, row: Row, suffix: str, made: MadeFile) -> MadeFile:
    relative = place(row.path, suffix)
    with whole_file(folder / relative) as partial:
        shutil.copyfile(folder / made.path, partial)
    return replace(made, path=relative)

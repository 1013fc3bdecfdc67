"""Shared by relight and turntable: a batch of one bundle's pictures, with its progress."""

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lambent_core.files import whole_file
from lambent_core.pictures import EnvironmentInput, RenderQuality, RenderSettings
from lambent_relight import Bundle, BundleError, Camera, RelightError, load_bundle
from lambent_relight.batch.journal import Journal, Record, open_journal
from lambent_relight.batch.manifest import SUFFIXES, Asset, Files, Light
from lambent_relight.batch.plan import Plan, Row, bundle_digest, check_names, light_digests
from lambent_relight.batch.run import Result, run_batch

from lambent.cli.output import Output, format_duration
from lambent.cli.progress import Live, bars
from lambent.errors import LambentError, UsageProblemError

INDEX = "pictures.json"


@dataclass(frozen=True, kw_only=True, slots=True)
class Shot:
    """One picture to make: `path` is its place in the output folder without a suffix."""

    path: str
    light: Light
    camera: Camera


_BOUNCES = {
    "": "without bounced light",
    "adapted": "bounced light from the fast cache that was adapted to it",
    "baked": "bounced light from baked transport, of the diffuse lobe as it was baked at the surface",
    "transport": "bounced light from baked transport",
    "one": "light that bounced once",
}


@contextmanager
def relight_errors() -> Iterator[None]:
    """Turn the errors of lambent_relight into the client's: exit code 1 for a bad bundle, else 2."""
    try:
        yield
    except BundleError as error:
        raise LambentError(error.code, error.message, error.advice) from error
    except RelightError as error:
        raise UsageProblemError(error.code, error.message, error.advice) from error


def check_choice(option: str, value: str, choices: Sequence[str]) -> None:
    """Raise `cli.bad_choice` unless `value` is one of `choices`."""
    if value not in choices:
        raise UsageProblemError("cli.bad_choice", f"{option} {value!r}", f"use one of {', '.join(choices)}")


def open_bundle(bundle: Path) -> Bundle:
    """Return a checked bundle folder or zip."""
    if not bundle.exists():
        raise UsageProblemError(
            "bundle.missing", f"there is no {bundle}", "fetch one: lambent fetch JOB -o DIR"
        )
    return load_bundle(bundle)


def asset_here(bundle: Path, **fields: Any) -> Asset:
    """Return an asset of a batch for a bundle that may have any name."""
    return Asset.model_construct(name=bundle.name, bundle=bundle, **fields)


def light_here(path: Path, given: EnvironmentInput, rotate_deg: float = 0.0) -> Light:
    """Return an environment of a batch for a map that may have any name."""
    return Light.model_construct(name=path.name, map=path, rotate_deg=rotate_deg, **dict(given))


def rows_of(shots: Sequence[Shot], bundle: Bundle, asset: Asset, settings: RenderSettings) -> list[Row]:
    """Return pictures of one bundle as rows of a batch.

    Raises `environment.missing` for a map that is not there, `batch.same_name` for two cameras of one name.
    """
    digest = bundle_digest(bundle)
    quality = RenderQuality.model_construct(**dict(settings))
    maps = light_digests([shot.light for shot in shots])
    rows = []
    for shot in shots:
        map_digest = maps[shot.light.called]
        if isinstance(map_digest, Exception):
            raise map_digest
        rows.append(
            Row(
                path=shot.path,
                asset=asset,
                light=shot.light,
                quality=quality,
                camera=shot.camera,
                bundle_digest=digest,
                light_digest=map_digest,
            )
        )
    check_names(rows)
    return rows


def shown_batch(
    plan: Plan, files: Files, journal: Journal, output: Output, *, num_jobs: int = 1, strict: bool = False
) -> Iterator[Result]:
    """Yield the result of every picture of a batch as `run_batch` does, and show how far it is."""
    done = 0
    with PictureBar(len(plan.rows) + len(plan.failures), output) as bar:

        def show(fraction: float) -> None:
            bar.move(done + fraction)

        for result in run_batch(plan, files, journal, num_jobs=num_jobs, progress=show, strict=strict):
            bar.done(done, result.path, result.state)
            done += 1
            yield result


def make_pictures(rows: Sequence[Row], files: Files, folder: Path, output: Output) -> None:
    """Make every picture that is not there yet, and list those of `folder` in its pictures.json.

    Pictures that exist are recognised as in a batch, by the hash of everything they depend on.
    """
    told: set[str] = set()
    began, num_made = time.monotonic(), 0
    plan = Plan(rows=tuple(rows), failures=())
    with open_journal(folder) as journal:
        try:
            for result in shown_batch(plan, files, journal, output, strict=True):
                if result.state != "made" or result.record is None:
                    continue
                num_made += 1
                for note in _notes(result.record):
                    if note not in told:
                        told.add(note)
                        output.note(note)
        finally:
            listed = {path: _listed(record) for path, record in sorted(journal.records.items())}
            _write_index(folder / INDEX, listed)
    seconds = time.monotonic() - began
    text = f"{folder}  ({num_made} pictures made, {len(rows) - num_made} kept, {format_duration(seconds)})"
    wanted = [listed[row.path] for row in rows]
    output.result(text, {"path": str(folder), "made": num_made, "pictures": wanted})


def _notes(record: Record) -> Iterator[str]:
    """Yield notes for the user about the light of a picture."""
    yield from record.notes
    if record.quality == "refined":
        yield f"{record.environment}: {_BOUNCES[record.bounces.partition(':')[0]]}"


def _listed(record: Record) -> dict[str, Any]:
    return {
        "key": next(iter(record.files.values())).key,
        "files": [record.files[suffix].path for suffix in SUFFIXES if suffix in record.files],
        "camera": record.camera,
        "environment": record.environment,
        "rotate_deg": record.rotate_deg,
        "num_samples": record.num_samples,
        "bounces": record.bounces,
        "mean_standard_error": record.mean_standard_error,
        "environment_notes": list(record.notes),
    }


def _write_index(index: Path, listed: Mapping[str, dict[str, Any]]) -> None:
    pictures = [{"name": name, **record} for name, record in listed.items()]
    with whole_file(index) as partial:
        partial.write_text(json.dumps({"pictures": pictures}, indent=1) + "\n")


class PictureBar(Live):
    """Progress over pictures: a bar on a terminal, one line per picture elsewhere, nothing with JSON."""

    def __init__(self, total: int, output: Output) -> None:
        self._total, self._output = total, output
        if not output.as_json and sys.stderr.isatty():
            from rich.progress import MofNCompleteColumn, TimeRemainingColumn

            self._bars = bars(MofNCompleteColumn(), TimeRemainingColumn())
            self._task = self._bars.add_task("relight", total=total)

    def move(self, done: float) -> None:
        """Show that `done` pictures are made; a fraction while one is on its way."""
        if self._bars:
            self._bars.update(self._task, completed=done)

    def done(self, number: int, name: str, what: str) -> None:
        """Show that picture `number` is there."""
        self.move(number + 1)
        if not self._bars:
            self._output.note(f"{what} {number + 1}/{self._total} {name}")

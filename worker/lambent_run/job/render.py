"""The kinds `render` and `batch`: pictures of published bundles, as artifacts of the job.

A run that takes the place of a lost one finds what its checkpoints hold and makes the rest.
"""

import io
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lambent_core.errors import IncompleteError, RelightError, Stopped, UsageError
from lambent_core.files import link_or_copy
from lambent_core.reporter import Reporter
from lambent_proto.v1.job_pb2 import Progress
from lambent_relight.batch import tiles
from lambent_relight.batch.journal import NAME as JOURNAL
from lambent_relight.batch.journal import Journal, open_journal, read_records
from lambent_relight.batch.manifest import SCHEMA, Manifest
from lambent_relight.batch.plan import Failure, Plan, make_plan
from lambent_relight.batch.reading import ManifestError, read_manifest
from lambent_relight.batch.run import Result, run_batch
from lambent_relight.batch.sheet_lights import light_pictures
from lambent_relight.batch.summary import TABLE, TileOf, write_sheets, write_table

if TYPE_CHECKING:
    from lambent_run.job.order import Order

TASK = "render"
SUMMARY_TASK = "contact_sheet"
CHECKPOINT_S = 30.0
"""A lost machine costs the pictures of this many seconds."""
_PARTS = "parts"
_PREVIEW_PIXELS = 256


def render_pictures(order: "Order") -> None:
    """Make the pictures of one part of an order; what fails is a finding, and stops no other picture.

    The run behind several parts makes their table and contact sheet instead. Raises UsageError
    (`render.spec_invalid`) for an order that cannot be meant and (`render.all_failed`) when no picture could
    be made.
    """
    shard, num_shards = order.start.render.shard, order.start.render.num_shards
    try:
        manifest = manifest_of(order.start.render.spec, order.scene_dir)
        plan = part_of(make_plan(manifest), shard, num_shards) if shard < num_shards else None
    except (ManifestError, RelightError) as error:
        raise UsageError("render.spec_invalid", f"{error.message}; {error.advice}") from error
    if plan is None:
        sum_up(order, manifest)
        return
    folder = order.run_dir / "pictures"
    _restore(order.run_dir, folder)
    with open_journal(folder) as journal:
        work = _Work(order.reporter, order.run_dir, journal, len(plan.rows) + len(plan.failures))
        try:
            for result in run_batch(plan, manifest.files, journal, progress=work.progress):
                work.add(result)
        except _StopNowError as stop:
            work.checkpoint()
            raise Stopped from stop
    _publish(order, folder, work.results, manifest)


def sum_up(order: "Order", manifest: Manifest) -> None:
    """Make the table and the contact sheet of an order from what its parts have left in `parts/<part>/`.

    Parts that failed have left nothing there. Raises UsageError (`render.all_failed`) if all have, and
    IncompleteError (`render.parts_failed`) after table and sheet if some have.
    """
    folder = order.run_dir / "summary"
    folder.mkdir(parents=True, exist_ok=True)
    parts = sorted((order.scene_dir / "parts").glob("*"))
    results = [
        Result(path=record.path, state="made", record=record)
        for part in parts
        for record in read_records(part / JOURNAL)
    ]
    for each in order.start.render.failures:
        failure = Failure(path=each.path, code=each.code, message=each.message)
        results.append(Result(path=failure.path, state="failed", failure=failure))
    _require_any(results)
    tile_of = tiles.Tiles(path for part in parts for path in part.glob(tiles.NAME))
    _summary(order.reporter, folder, results, manifest, tile_of)
    num = len(results)
    order.reporter.progress(Progress(stage=SUMMARY_TASK, step=num, num_steps=num, fraction=1.0))
    num_shards = order.start.render.num_shards
    num_failed = num_shards - len(parts)
    if num_failed:
        raise IncompleteError(
            "render.parts_failed",
            f"{num_failed} of {num_shards} parts failed; the table lists why their pictures are missing, "
            "and a retry of the batch makes them",
        )


def manifest_of(order: str, inputs: Path) -> Manifest:
    """Return the manifest of an order (JSON of `RenderSpec`) whose bundles and maps lie in `inputs`.

    That is `bundles/<id>/` and `environments/<id>.<format>`. Raises ManifestError for values that no manifest
    may have.
    """
    document = json.loads(order)
    # Relative paths in a manifest are relative to the manifest.
    inputs = inputs.absolute()
    for asset in document["assets"]:
        asset["bundle"] = str(inputs / "bundles" / asset.pop("bundle_id"))
    maps = {path.stem: path for path in (inputs / "environments").glob("*")}
    for light in document["environments"]:
        identifier = light.pop("environment_id")
        light["map"] = str(maps.get(identifier, inputs / "environments" / identifier))
    return read_manifest({**document, "schema": SCHEMA}, inputs)


def part_of(plan: Plan, shard: int, num_shards: int) -> Plan:
    """Return one part of a plan; its neighbours in the plan stay together. The first tells what failed."""
    start, end = (round(len(plan.rows) * index / num_shards) for index in (shard, shard + 1))
    return Plan(rows=plan.rows[start:end], failures=plan.failures if shard == 0 else ())


class _StopNowError(BaseException):
    """Leaves a picture in the middle; no handler of failed pictures takes it for one."""


@dataclass(slots=True)
class _Work:
    """How far the run is, and what it has not yet made safe."""

    reporter: Reporter
    run_dir: Path
    journal: Journal
    num_pictures: int
    results: list[Result] = field(default_factory=list)
    _began: float = field(default_factory=time.monotonic)
    _saved_at: float = field(default_factory=time.monotonic)
    _unsaved: list[Result] = field(default_factory=list)

    def add(self, result: Result) -> None:
        """Note a picture; from time to time everything so far is made safe."""
        self.results.append(result)
        self.progress(0.0)
        if result.state not in ("made", "copied"):
            return
        self._unsaved.append(result)
        shown = tiles.thumbnail(self.journal.folder, result, _PREVIEW_PIXELS)
        if shown is not None:
            buffer = io.BytesIO()
            shown.save(buffer, format="PNG")
            self.reporter.preview(result.path, buffer.getvalue())
        if time.monotonic() - self._saved_at >= CHECKPOINT_S:
            self.checkpoint()

    def progress(self, fraction: float) -> None:
        """Tell how far the run is, or end it; `fraction` is that of the picture in work."""
        if self.reporter.should_stop():
            raise _StopNowError
        done = len(self.results)
        seconds = time.monotonic() - self._began
        rate = done / seconds if done and seconds > 0.0 else 0.0
        self.reporter.progress(
            Progress(
                stage=TASK,
                step=done,
                num_steps=self.num_pictures,
                fraction=(done + fraction) / max(self.num_pictures, 1),
                eta_s=(self.num_pictures - done) / rate if rate else 0.0,
                steps_per_s=rate,
            )
        )

    def checkpoint(self) -> None:
        """Make every picture since the last time safe, each of them once."""
        self._saved_at = time.monotonic()
        if not self._unsaved:
            return
        number = len(list((self.run_dir / _PARTS).glob("*"))) + 1
        folder = self.run_dir / _PARTS / f"{number:06d}"
        for result in self._unsaved:
            assert result.record is not None
            for made in result.record.files.values():
                target = folder / made.path
                target.parent.mkdir(parents=True, exist_ok=True)
                link_or_copy(self.journal.folder / made.path, target)
        names = {result.path for result in self._unsaved}
        (folder / JOURNAL).write_text(self.journal.lines(names), encoding="utf-8")
        # A name of its own: the server keeps the newest of every name, and the parts complete each other.
        self.reporter.checkpoint(f"{TASK}-{number:06d}", len(self.results), folder)
        self._unsaved.clear()


def _restore(run_dir: Path, folder: Path) -> None:
    """Put what checkpoints hold where the batch looks for it."""
    lines = []
    for part in sorted((run_dir / _PARTS).glob("*")):
        for path in (path for path in part.rglob("*") if path.is_file()):
            relative = path.relative_to(part)
            if relative == Path(JOURNAL):
                lines.append(path.read_text(encoding="utf-8"))
                continue
            target = folder / relative
            target.parent.mkdir(parents=True, exist_ok=True)
            target.unlink(missing_ok=True)
            link_or_copy(path, target)
    if lines:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / JOURNAL).write_text("".join(lines), encoding="utf-8")


def _publish(order: "Order", folder: Path, results: list[Result], manifest: Manifest) -> None:
    """Send every picture, the records, and table and sheets or what they are made of; tell what failed."""
    reporter = order.reporter
    for failure in (result.failure for result in results if result.failure is not None):
        reporter.finding(failure.code, failure.message, subject=failure.path, error=True)
    _require_any(results)
    for result in results:
        if result.record is not None:
            for made in result.record.files.values():
                reporter.artifact(made.path, folder / made.path)
    reporter.artifact(JOURNAL, folder / JOURNAL)
    if order.start.render.num_shards > 1:
        reporter.artifact(tiles.NAME, tiles.write_tiles(folder, results))
    else:
        _summary(reporter, folder, results, manifest)


def _require_any(results: list[Result]) -> None:
    """Raise UsageError (`render.all_failed`) if every picture has failed."""
    failures = [result.failure for result in results if result.failure is not None]
    if failures and len(failures) == len(results):
        first = failures[0]
        raise UsageError("render.all_failed", f"no picture could be made: {first.code}: {first.message}")


def _summary(
    reporter: Reporter,
    folder: Path,
    results: list[Result],
    manifest: Manifest,
    tile_of: TileOf | None = None,
) -> None:
    """Send the table and the contact sheets of pictures."""
    write_table(folder / TABLE, results)
    lights = light_pictures(manifest)
    sheets = write_sheets(folder, results, title=manifest.name, lights=lights, tile_of=tile_of)
    for path in (folder / TABLE, *sheets):
        reporter.artifact(path.name, path)

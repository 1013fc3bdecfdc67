"""`python -m lambent_run.benchmark.cell KIND FOLDER DEVICE STAGE_ONE` computes a part of a benchmark.

KIND is "stage-one" or "cell"; FOLDER holds cell.json, DEVICE is torch's, STAGE_ONE the run folder of the
stage one to start from. All output is written to FOLDER, and an interrupted cell resumes from it.
"""

import shutil
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lambent_core.files import link_or_copy, write_json
from lambent_core.startup import end_with_parent, prepare

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lambent_core.reporter import Reporter

    from lambent_run.benchmark.plan import Cell
    from lambent_run.run.spec import RunSpec

RUN, REPORT, RESULT, ORDER = "run", "report", "result.json", "cell.json"
SHARED = ("scene", "estimated_masks", "cache")
SHARED_TASKS = ("ingest", "masks", "cache")


def main(arguments: list[str]) -> int:
    """Return the exit code of the command line."""
    prepare()
    end_with_parent(signal.SIGTERM)
    from lambent_core.errors import WorkerError

    from lambent_run.benchmark.plan import CELL_FILE
    from lambent_run.console_reporter import ConsoleReporter

    kind, folder, device, stage_one = arguments[0], Path(arguments[1]), arguments[2], Path(arguments[3])
    cell = CELL_FILE.validate_json((folder / ORDER).read_bytes())
    with ConsoleReporter(folder) as reporter:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: reporter.request_stop())
        try:
            if kind == "stage-one":
                train_stage_one(cell, folder, device, reporter)
            else:
                compute(cell, folder, device, stage_one, reporter)
        except WorkerError as error:
            print(f"error: {error}", file=sys.stderr)
            return error.exit_code
    return 0


def train_stage_one(cell: "Cell", folder: Path, device: str, reporter: "Reporter") -> None:
    """Train the stage one that all ablations of a scene and seed share."""
    from lambent_run.run.pipeline import run_pipeline

    # Its folder is named by what it depends on; what the other cells' stage two looks like does not count.
    (folder / RUN / "run.json").unlink(missing_ok=True)
    run_pipeline(spec_of(cell, cell.base_overrides), folder / RUN, device, reporter, SHARED_TASKS)


def spec_of(cell: "Cell", overrides: "Mapping[str, str]") -> "RunSpec":
    """Return the run of a cell, with these settings over its preset."""
    from lambent_run.run.spec import RunSpec

    return RunSpec.from_options(
        Path(cell.scene_dir),
        preset=cell.preset,
        overrides=overrides,
        lights=cell.lights,
        layout=cell.layout,
        seed=cell.seed,
    )


def compute(cell: "Cell", folder: Path, device: str, stage_one: Path, reporter: "Reporter") -> None:
    """Train stage two from a shared stage one, evaluate, and write `result.json` last."""
    from lambent_asset.bundle.manifest import git_revision
    from lambent_core.messages import message_to_dict

    from lambent_run.run.evaluation import evaluate_run
    from lambent_run.run.folder import task_seconds
    from lambent_run.run.pipeline import run_pipeline
    from lambent_run.run.prepare import check_device

    scene_dir, run_dir = Path(cell.scene_dir), folder / RUN
    if run_dir.exists() and not (run_dir / "run.json").exists():
        shutil.rmtree(run_dir)
    check_device(device)
    adopt(stage_one, run_dir)
    spec = spec_of(cell, cell.overrides)
    run_pipeline(spec, run_dir, device, reporter, (*SHARED_TASKS, "joint", "polish"))
    out = folder / REPORT
    report = evaluate_run(run_dir, scene_dir, out, cell.evaluation, device=device, reporter=reporter)
    result = {
        "inputs": cell.inputs,
        "git_revision": git_revision(),
        "seconds": task_seconds(run_dir),
        "report": message_to_dict(report),
    }
    write_json(folder / RESULT, result)
    if not cell.keep_predictions:
        discard_predictions(out)


def discard_predictions(report: Path) -> None:
    """Remove the float maps of an evaluation; its page and metrics are kept."""
    for path in report.glob("pred*"):
        shutil.rmtree(path)


def adopt(stage_one: Path, run_dir: Path) -> None:
    """Let a run start from another run's stage one, by links to its files or, failing that, copies."""
    if (run_dir / "steps" / "cache.done.json").exists():
        return
    for name in SHARED:
        shutil.rmtree(run_dir / name, ignore_errors=True)
        shutil.copytree(stage_one / name, run_dir / name, copy_function=link_or_copy)
    (run_dir / "steps").mkdir(exist_ok=True)
    for task in SHARED_TASKS:
        for kind in ("inputs", "done"):
            shutil.copyfile(
                stage_one / "steps" / f"{task}.{kind}.json", run_dir / "steps" / f"{task}.{kind}.json"
            )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

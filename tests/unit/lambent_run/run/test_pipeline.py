"""A run's tasks run once each, in order, and again only when what they depend on has changed."""

import dataclasses

import numpy as np
import pytest
from flashcache.presets import PRESETS
from lambent_capture.masks.corrections import Correction
from lambent_core.errors import Stopped, UsageError, WorkerError
from lambent_run.run import pipeline
from lambent_run.run.context import Clock
from lambent_run.run.folder import done_inputs, locked, task_folder, task_seconds
from lambent_run.run.hashes import TASKS, input_hashes, scene_hash
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.spec import RunSpec
from support.captures import save, write_blender
from support.recording_reporter import RecordingReporter

CONFIG = dataclasses.replace(PRESETS["fast"](), polish="on")
POSED = TASKS[1:]
"""The tasks of a capture that has cameras."""


@pytest.fixture
def scene(tmp_path):
    return write_blender(tmp_path / "scene", num_train=3, num_test=1)


class Tasks:
    """Takes the place of the tasks: remembers the order, leaves a file, may fail."""

    def __init__(self):
        self.ran = []
        self.clocks = {}
        self.fails = None

    def function(self, name):
        def run(context):
            assert context.folder.is_dir()
            self.clocks[name] = context.clock
            self.ran.append((name, sorted(path.name for path in context.folder.iterdir())))
            context.progress(1, 2)
            (context.folder / "result").write_text(name)
            if self.fails == name:
                raise WorkerError("test.failed", "as asked")
            context.progress(2, 2)

        return run

    def names(self):
        return [name for name, _ in self.ran]


@pytest.fixture
def tasks(monkeypatch):
    fake = Tasks()
    monkeypatch.setattr(pipeline, "_task_function", fake.function)
    return fake


def run(tmp_path, scene, reporter=None, tasks=TASKS, **changes):
    """Run the tasks; which ones are done is seen by their own marks, whatever `run.json` says."""
    reporter = reporter or RecordingReporter()
    (tmp_path / "run" / "run.json").unlink(missing_ok=True)
    run_pipeline(spec_of(scene, **changes), tmp_path / "run", "cpu", reporter, tasks)
    return reporter


def spec_of(scene, **changes):
    return RunSpec(**{"scene": scene, "config": CONFIG, **changes})


def test_all_tasks_run_in_order_and_only_once(tmp_path, scene, tasks):
    run(tmp_path, scene)
    assert tasks.names() == list(POSED)
    again = run(tmp_path, scene)
    assert tasks.names() == list(POSED)
    assert [fields["stage"] for fields in again.named("step.reused")] == list(POSED)


def test_cameras_are_found_first_where_there_are_none(tmp_path, tasks):
    scene = tmp_path / "photographs"
    for number in range(3):
        save(scene / f"{number}.jpg", np.full((8, 8, 3), 40 * number, dtype=np.uint8))
    run(tmp_path, scene)
    assert tasks.names() == list(TASKS)
    save(scene / "3.jpg", np.full((8, 8, 3), 250, dtype=np.uint8))
    run(tmp_path, scene)
    assert tasks.names()[len(TASKS) :] == list(TASKS)


def test_a_failed_task_is_repeated_with_its_files_and_the_ones_before_are_kept(tmp_path, scene, tasks):
    tasks.fails = "joint"
    with pytest.raises(WorkerError):
        run(tmp_path, scene)
    tasks.fails = None
    run(tmp_path, scene)
    assert tasks.names() == ["ingest", "masks", "cache", "joint", "joint", "polish", "evaluate", "export"]
    assert tasks.ran[4] == ("joint", ["result"])


def smoother(config):
    return dataclasses.replace(config, stage_two=dataclasses.replace(config.stage_two, smoothness_weight=0.5))


def seen_once(config):
    return dataclasses.replace(config, evaluation=dataclasses.replace(config.evaluation, num_views=1))


@pytest.mark.parametrize(
    ("changes", "repeated"),
    [
        ({"config": smoother(CONFIG)}, POSED[3:]),
        ({"config": seen_once(CONFIG)}, ("evaluate",)),
        ({"seed": 1}, POSED[2:]),
    ],
    ids=["stage two", "evaluation", "seed"],
)
def test_a_change_repeats_the_tasks_that_read_it_and_those_after_from_scratch(
    tmp_path, scene, tasks, changes, repeated
):
    run(tmp_path, scene)
    run(tmp_path, scene, **changes)
    assert tasks.ran[len(POSED) :] == [(name, []) for name in repeated]


def test_a_changed_photograph_repeats_everything(tmp_path, scene, tasks):
    run(tmp_path, scene)
    with (scene / "train" / "r_0.png").open("ab") as file:
        file.write(b"\0")
    run(tmp_path, scene)
    assert tasks.names()[len(POSED) :] == list(POSED)


def test_a_copy_of_the_scene_elsewhere_is_the_same_scene(tmp_path, scene):
    other = write_blender(tmp_path / "copy" / "scene", num_train=3, num_test=1)
    (other / ".listing").write_text("a hidden file does not count")
    assert scene_hash(scene) == scene_hash(other)


def test_checkpoints_brought_from_elsewhere_are_kept(tmp_path, scene, tasks):
    folder = task_folder(tmp_path / "run", "joint")
    folder.mkdir(parents=True)
    (folder / "step_0000010").mkdir()
    run(tmp_path, scene)
    assert tasks.ran[3] == ("joint", ["step_0000010"])


def test_some_tasks_can_be_run_alone(tmp_path, scene, tasks):
    run(tmp_path, scene, tasks=("ingest", "cache"))
    assert tasks.names() == ["ingest", "cache"]
    assert done_inputs(tmp_path / "run", "joint") is None


def test_an_unknown_task_is_a_usage_error(tmp_path, scene):
    with pytest.raises(UsageError, match="dusting"):
        run(tmp_path, scene, tasks=("dusting",))


def test_progress_of_the_job_only_grows_and_ends_at_one(tmp_path, scene, tasks):
    reporter = run(tmp_path, scene)
    fractions = [fields["fraction"] for fields in reporter.named("progress")]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] == pytest.approx(1.0)
    assert {fields["stage"] for fields in reporter.named("progress")} == set(POSED)


def test_a_stop_before_a_task_leaves_it_undone(tmp_path, scene, tasks):
    with pytest.raises(Stopped):
        run(tmp_path, scene, RecordingReporter(stop_after=1))
    assert tasks.names() == ["ingest"]
    run(tmp_path, scene)
    assert tasks.names() == list(POSED)


def test_a_run_folder_belongs_to_one_process(tmp_path, scene, tasks):
    with locked(tmp_path / "run"), pytest.raises(WorkerError, match=r"run\.busy"):
        run(tmp_path, scene)


def test_the_time_of_every_sitting_is_added_up(tmp_path, scene, tasks, monkeypatch):
    ticks = iter(range(1000))
    monkeypatch.setattr(pipeline.time, "monotonic", lambda: float(next(ticks)))
    tasks.fails = "cache"
    with pytest.raises(WorkerError):
        run(tmp_path, scene)
    first = task_seconds(tmp_path / "run")["cache"]
    tasks.fails = None
    run(tmp_path, scene)
    assert task_seconds(tmp_path / "run")["cache"] > first > 0.0


def test_time_to_go_counts_only_what_this_process_did():
    clock = Clock(before=0.5, share=0.5, job_started=0.5, began=0.0, now=lambda: 10.0)
    assert clock.job_fraction(0.5) == 0.75
    assert clock.eta_s(0.5) == pytest.approx(10.0)
    assert clock.eta_s(0.0) == 0.0


def test_the_speed_so_far_is_that_of_training(tmp_path, scene, tasks):
    """What comes before takes as long as the photographs want, and says nothing about the rest."""
    run(tmp_path, scene)
    clocks = tasks.clocks
    assert clocks["cache"].job_started == pytest.approx(clocks["cache"].before)
    assert clocks["cache"].began > clocks["ingest"].began
    for name in ("joint", "polish", "evaluate", "export"):
        assert (clocks[name].began, clocks[name].job_started) == (
            clocks["cache"].began,
            clocks["cache"].job_started,
        )
    shares = [clocks[name].share for name in POSED]
    assert sum(shares) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("lights", ("capture",), ("lamp",)),
        ("known_lights", {"": "a.hdr"}, {"": "b.hdr"}),
        ("masks", "a", "b"),
    ],
)
def test_what_the_first_task_reads_changes_every_task(scene, name, one, other):
    hashes = [input_hashes(spec_of(scene, **changes)) for changes in ({}, {name: one}, {name: other})]
    # Each task's hash contains the one before.
    assert len({each for made in hashes for each in made.values()}) == 3 * len(POSED)


STROKE = Correction(frame="train_r_0", is_object=False, points=((1.0, 2.0),), radius=3.0)


def test_corrections_change_the_masks_and_what_comes_after_and_nothing_before(scene):
    own = input_hashes(spec_of(scene))
    corrected, other = (
        input_hashes(spec_of(scene, corrections=(dataclasses.replace(STROKE, radius=radius),)))
        for radius in (3.0, 4.0)
    )
    assert own["ingest"] == corrected["ingest"] == other["ingest"]
    assert all(len({own[task], corrected[task], other[task]}) == 3 for task in POSED[1:])


def test_what_was_found_outlives_other_corrections_and_the_masks_do_not(tmp_path, scene, tasks):
    run(tmp_path, scene)
    workspace = task_folder(tmp_path / "run", "masks") / "workspace"
    workspace.mkdir()
    (workspace / "estimate.json").write_text("found")
    run(tmp_path, scene, corrections=(STROKE,))
    assert tasks.ran[len(POSED) :] == [
        ("masks", ["workspace"]),
        *((name, []) for name in ("cache", "joint", "polish", "evaluate", "export")),
    ]
    assert (workspace / "estimate.json").read_text() == "found"

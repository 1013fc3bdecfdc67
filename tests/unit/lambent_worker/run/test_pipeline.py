"""A job's steps run once each, in order, and again only when what they depend on has changed."""

import dataclasses

import pytest
from flashcache.presets import PRESETS
from lambent_worker.errors import Stopped, UsageError, WorkerError
from lambent_worker.run import pipeline
from lambent_worker.run.context import Clock
from lambent_worker.run.folder import done_inputs, locked, stage_seconds, step_folder
from lambent_worker.run.hashes import STEPS, input_hashes, scene_hash
from lambent_worker.run.pipeline import run_pipeline
from support.captures import write_blender
from support.recording_reporter import RecordingReporter

CONFIG = PRESETS["fast"]()


@pytest.fixture
def scene(tmp_path):
    return write_blender(tmp_path / "scene", num_train=3, num_test=1)


class Steps:
    """Stands in for the steps: remembers the order, leaves a file, may fail."""

    def __init__(self):
        self.ran = []
        self.fails = None

    def function(self, name):
        def run(context):
            assert context.folder.is_dir()
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
def steps(monkeypatch):
    fake = Steps()
    monkeypatch.setattr(pipeline, "_step_function", fake.function)
    return fake


def run(tmp_path, scene, reporter=None, config=CONFIG, seed=0, **options):
    reporter = reporter or RecordingReporter()
    run_pipeline(scene, tmp_path / "run", config, seed, "cpu", reporter, **options)
    return reporter


def test_all_steps_run_in_order_and_only_once(tmp_path, scene, steps):
    run(tmp_path, scene)
    assert steps.names() == list(STEPS)
    again = run(tmp_path, scene)
    assert steps.names() == list(STEPS)
    assert [fields["stage"] for fields in again.named("step.reused")] == list(STEPS)


def test_a_failed_step_is_repeated_with_its_files_and_the_ones_before_are_kept(tmp_path, scene, steps):
    steps.fails = "joint"
    with pytest.raises(WorkerError):
        run(tmp_path, scene)
    steps.fails = None
    run(tmp_path, scene)
    assert steps.names() == ["ingest", "cache", "joint", "joint", "evaluate", "export"]
    assert steps.ran[3] == ("joint", ["result"])


def test_a_changed_setting_repeats_the_steps_that_read_it_and_those_after_from_scratch(
    tmp_path, scene, steps
):
    run(tmp_path, scene)
    changed = dataclasses.replace(
        CONFIG, stage_two=dataclasses.replace(CONFIG.stage_two, smoothness_weight=0.5)
    )
    run(tmp_path, scene, config=changed)
    assert steps.ran[5:] == [("joint", []), ("evaluate", []), ("export", [])]


def test_an_evaluation_setting_does_not_repeat_the_export(tmp_path, scene, steps):
    run(tmp_path, scene)
    changed = dataclasses.replace(CONFIG, evaluation=dataclasses.replace(CONFIG.evaluation, num_views=1))
    run(tmp_path, scene, config=changed)
    assert steps.names()[5:] == ["evaluate"]


def test_another_seed_reads_the_same_scene_but_trains_anew(tmp_path, scene, steps):
    run(tmp_path, scene)
    run(tmp_path, scene, seed=1)
    assert steps.names()[5:] == ["cache", "joint", "evaluate", "export"]


def test_a_changed_photograph_repeats_everything(tmp_path, scene, steps):
    run(tmp_path, scene)
    with (scene / "train" / "r_0.png").open("ab") as file:
        file.write(b"\0")
    run(tmp_path, scene)
    assert steps.names()[5:] == list(STEPS)


def test_a_copy_of_the_scene_elsewhere_is_the_same_scene(tmp_path, scene):
    other = write_blender(tmp_path / "copy" / "scene", num_train=3, num_test=1)
    (other / ".listing").write_text("a hidden file does not count")
    assert scene_hash(scene) == scene_hash(other)


def test_checkpoints_brought_from_elsewhere_are_kept(tmp_path, scene, steps):
    folder = step_folder(tmp_path / "run", "joint")
    folder.mkdir(parents=True)
    (folder / "step_0000010").mkdir()
    run(tmp_path, scene)
    assert steps.ran[2] == ("joint", ["step_0000010"])


def test_some_steps_can_be_run_alone(tmp_path, scene, steps):
    run(tmp_path, scene, steps=("ingest", "cache"))
    assert steps.names() == ["ingest", "cache"]
    assert done_inputs(tmp_path / "run", "joint") is None


def test_an_unknown_step_is_a_usage_error(tmp_path, scene):
    with pytest.raises(UsageError, match="polish"):
        run(tmp_path, scene, steps=("polish",))


def test_progress_of_the_job_only_grows_and_ends_at_one(tmp_path, scene, steps):
    reporter = run(tmp_path, scene)
    fractions = [fields["fraction"] for fields in reporter.named("progress")]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] == pytest.approx(1.0)
    assert {fields["stage"] for fields in reporter.named("progress")} == set(STEPS)


def test_a_stop_before_a_step_leaves_it_undone(tmp_path, scene, steps):
    with pytest.raises(Stopped):
        run(tmp_path, scene, RecordingReporter(stop_after=1))
    assert steps.names() == ["ingest"]
    run(tmp_path, scene)
    assert steps.names() == list(STEPS)


def test_a_run_folder_belongs_to_one_process(tmp_path, scene, steps):
    with locked(tmp_path / "run"), pytest.raises(WorkerError, match=r"run\.busy"):
        run(tmp_path, scene)


def test_the_time_of_every_sitting_is_added_up(tmp_path, scene, steps, monkeypatch):
    ticks = iter(range(1000))
    monkeypatch.setattr(pipeline.time, "monotonic", lambda: float(next(ticks)))
    steps.fails = "cache"
    with pytest.raises(WorkerError):
        run(tmp_path, scene)
    first = stage_seconds(tmp_path / "run")["cache"]
    steps.fails = None
    run(tmp_path, scene)
    assert stage_seconds(tmp_path / "run")["cache"] > first > 0.0


def test_time_to_go_counts_only_what_this_process_did():
    clock = Clock(before=0.5, share=0.5, job_started=0.5, began=0.0, now=lambda: 10.0)
    assert clock.job_fraction(0.5) == 0.75
    assert clock.eta_s(0.5) == pytest.approx(10.0)
    assert clock.eta_s(0.0) == 0.0


def test_each_steps_hash_contains_the_one_before(scene):
    one = input_hashes(scene, CONFIG, 0, (), "")
    other = input_hashes(scene, CONFIG, 0, ("capture",), "")
    assert not set(one.values()) & set(other.values())
    assert len(set(one.values())) == len(STEPS)


def test_a_given_environment_changes_every_step(scene):
    learned = input_hashes(scene, CONFIG, 0, (), "")
    given, other = (input_hashes(scene, CONFIG, 0, (), "", {"": name}) for name in ("a.hdr", "b.hdr"))
    assert not set(given.values()) & (set(other.values()) | set(learned.values()))
    assert input_hashes(scene, CONFIG, 0, (), "", {}) == learned


def test_given_masks_change_every_step(scene):
    own = input_hashes(scene, CONFIG, 0, (), "")
    given, other = (input_hashes(scene, CONFIG, 0, (), "", None, masks) for masks in ("one", "other"))
    assert all(len({own[step], given[step], other[step]}) == 3 for step in STEPS)

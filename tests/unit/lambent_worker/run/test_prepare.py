"""A run folder is used for the run it was made for, or refused with what to do."""

import numpy as np
import pytest
from flashcache.errors import ConfigError
from lambent_relight.environment.maps import write_environment
from lambent_worker.errors import UsageError
from lambent_worker.files import write_json
from lambent_worker.run import prepare as training_run
from lambent_worker.run.folder import begin_step, finish_step, read_settings, step_folder
from lambent_worker.run.prepare import check_device, export_run, open_run, prepare_run, step_inputs
from support.recording_reporter import RecordingReporter


def prepare(tmp_path, **changes):
    options = {
        "preset": "fast",
        "lights": (),
        "layout": "",
        "seed": 0,
        "device": "",
        "overrides": {},
        "resume": False,
    }
    return prepare_run(tmp_path / "scene", tmp_path / "run", **{**options, **changes})


def test_settings_on_the_command_line_change_the_preset(tmp_path):
    run = prepare(tmp_path, overrides={"stage_one.num_steps": "7"}, seed=4, lights=("sunset",))
    assert run.config.stage_one.num_steps == 7
    assert (run.seed, run.device, run.lights) == (4, "cpu", ("sunset",))
    assert read_settings(tmp_path / "run").config["stage_one"]["num_steps"] == 7


def test_the_same_command_again_goes_on_with_the_run(tmp_path):
    assert prepare(tmp_path, seed=4) == prepare(tmp_path, seed=4)


def test_resume_takes_the_settings_from_the_folder(tmp_path):
    first = prepare(tmp_path, seed=4, overrides={"stage_one.num_steps": "7"})
    assert prepare(tmp_path, resume=True) == first


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"seed": 1}, "seed"), ({"lights": ("a",)}, "lights"), ({"overrides": {"max_side": "64"}}, "config")],
)
def test_other_settings_for_a_folder_in_use_are_refused_and_named(tmp_path, changes, named):
    prepare(tmp_path)
    with pytest.raises(UsageError, match=rf"run\.other_settings.*another {named};"):
        prepare(tmp_path, **changes)


def test_a_folder_with_something_else_is_not_written_into(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.txt").write_text("")
    with pytest.raises(UsageError, match=r"run\.folder_not_empty"):
        prepare(tmp_path)


def test_there_is_nothing_to_resume_in_an_empty_folder(tmp_path):
    with pytest.raises(UsageError, match=r"run\.not_found"):
        prepare(tmp_path, resume=True)


def test_an_unknown_preset_is_a_usage_error_that_lists_them(tmp_path):
    with pytest.raises(UsageError, match="fast"):
        prepare(tmp_path, preset="fastest")


def test_an_unknown_setting_is_a_config_error_and_leaves_no_folder(tmp_path):
    with pytest.raises(ConfigError, match="wings"):
        prepare(tmp_path, overrides={"stage_one.wings": "2"})
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("device", ["cuda:99", "toaster", "mps"])
def test_a_device_that_is_not_there_is_a_usage_error(device):
    with pytest.raises(UsageError, match=r"device\.not_found"):
        check_device(device)


def test_another_device_can_be_chosen_for_a_run_that_exists(tmp_path):
    prepare(tmp_path)
    with pytest.raises(UsageError, match=r"device\.not_found"):
        open_run(tmp_path / "run", "cuda:99")
    assert open_run(tmp_path / "run", "cpu").device == "cpu"


def finished_run(tmp_path):
    """Return a run folder whose steps pretend to be done."""
    run = prepare(tmp_path)
    folder = tmp_path / "run"
    begin_step(folder, "joint", "trained")
    finish_step(folder, "joint", "trained")
    inputs = step_inputs("export", "trained", run.config, run.seed)
    begin_step(folder, "export", inputs)
    write_json(step_folder(folder, "export") / "manifest.json", {})
    finish_step(folder, "export", inputs)
    return folder


def test_a_bundle_that_is_there_is_copied_without_our_marks(tmp_path):
    export_run(finished_run(tmp_path), tmp_path / "out", RecordingReporter())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["manifest.json"]


def test_tier_and_weights_of_an_export_replace_the_runs_settings(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(training_run, "run_step", lambda context, inputs: asked.append(context.config.export))
    folder, reporter = finished_run(tmp_path), RecordingReporter()
    export_run(folder, tmp_path / "lite", reporter, tier="lite")
    export_run(folder, tmp_path / "exact", reporter, weights="fp32")
    export_run(folder, tmp_path / "both", reporter, tier="lite", weights="fp16")
    assert [(s.transport_tier, s.weights) for s in asked] == [
        ("lite", "none"),
        ("full", "fp32"),
        ("lite", "fp16"),
    ]
    with pytest.raises(ConfigError, match="transport_tier"):
        export_run(folder, tmp_path / "huge", reporter, tier="huge")
    assert not (tmp_path / "huge").exists()


def test_an_existing_bundle_folder_is_not_overwritten(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(UsageError, match=r"export\.exists"):
        export_run(finished_run(tmp_path), tmp_path / "out", RecordingReporter())


def test_a_run_that_is_not_trained_has_no_bundle(tmp_path):
    prepare(tmp_path)
    with pytest.raises(UsageError, match=r"run\.not_trained"):
        export_run(tmp_path / "run", tmp_path / "out", RecordingReporter())


def test_a_published_scene_has_its_own_settings(tmp_path):
    run = prepare(tmp_path, preset="paper_tensoir:hotdog")
    assert run.config.stage_one.distortion_weight == 0.01
    with pytest.raises(UsageError, match=r"config\.preset_unknown.*armadillo"):
        prepare(tmp_path, preset="paper_tensoir:cat")


def test_given_environments_are_kept_and_part_of_what_a_run_is(tmp_path):
    sky = tmp_path / "sky.exr"
    write_environment(sky, np.ones((4, 8, 3), np.float32))
    run = prepare(tmp_path, known_lights=[str(sky)])
    (name,) = run.known_lights.values()
    assert (tmp_path / "run" / "known_lights" / name).is_file()
    sky.write_bytes(sky.read_bytes())
    assert prepare(tmp_path, known_lights=[str(sky)]) == run
    write_environment(sky, np.full((4, 8, 3), 2.0, np.float32))
    with pytest.raises(UsageError, match=r"run\.other_settings.*another known_lights;"):
        prepare(tmp_path, known_lights=[str(sky)])

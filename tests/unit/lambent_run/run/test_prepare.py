"""The folder and the device of a run are there or refused with what to do; a trained run has a bundle."""

import pytest
import torch
from flashcache.config import with_overrides
from flashcache.errors import ConfigError
from lambent_core.errors import UsageError
from lambent_core.files import write_json
from lambent_run.run import prepare
from lambent_run.run.folder import begin_task, finish_task, task_folder
from lambent_run.run.hashes import task_inputs
from lambent_run.run.prepare import check_device, device_for, export_run, open_task
from lambent_run.run.spec import RunSpec, keep_run
from support.recording_reporter import RecordingReporter


def kept_run(tmp_path):
    """Return the specification of a run that is kept in the folder `run`."""
    spec = RunSpec.from_options(tmp_path / "scene", preset="fast")
    keep_run(tmp_path / "run", spec, "cpu")
    return spec


def test_a_folder_with_something_else_is_not_written_into(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.txt").write_text("")
    with pytest.raises(UsageError, match=r"run\.folder_not_empty"):
        device_for(tmp_path / "run")


def test_there_is_nothing_to_open_in_an_empty_folder(tmp_path):
    with pytest.raises(UsageError, match=r"run\.not_found"):
        open_task(tmp_path, "export", RecordingReporter())


@pytest.mark.parametrize("device", ["cuda:99", "toaster", "mps"])
def test_a_device_that_is_not_there_is_a_usage_error(device):
    with pytest.raises(UsageError, match=r"device\.not_found"):
        check_device(device)


def test_a_run_has_a_device_and_another_can_be_chosen(tmp_path):
    assert device_for(tmp_path / "run") == "cpu"
    keep_run(tmp_path / "run", RunSpec.from_options(tmp_path, preset="fast"), "cuda:99")
    for choose in (device_for, lambda run, *device: open_task(run, "joint", None, *device).device):
        with pytest.raises(UsageError, match=r"device\.not_found.*cuda:99"):
            choose(tmp_path / "run")
        assert choose(tmp_path / "run", "cpu") == "cpu"


def test_ranks_need_a_gpu_each_from_the_first_one_on(tmp_path, monkeypatch):
    assert device_for(tmp_path / "run", "cpu", 8) == "cpu"
    with pytest.raises(UsageError, match=r"device\.not_found"):
        device_for(tmp_path / "run", "cuda", 8)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert device_for(tmp_path / "run", "cuda", 2) == "cuda"
    with pytest.raises(UsageError, match=r"device\.not_found.*cuda:2"):
        device_for(tmp_path / "run", "cuda", 3)
    with pytest.raises(UsageError, match=r"device\.of_ranks.*cuda:1"):
        device_for(tmp_path / "run", "cuda:1", 2)


def finished_run(tmp_path):
    """Return a run folder whose tasks pretend to be done."""
    config, folder = kept_run(tmp_path).config, tmp_path / "run"
    begin_task(folder, "polish", "trained")
    finish_task(folder, "polish", "trained")
    exported(folder, config, {})
    return folder


def exported(folder, config, manifest):
    """Let the bundle of these settings, with this manifest, be made already."""
    inputs = task_inputs("export", "trained", config, 0)
    begin_task(folder, "export", inputs)
    write_json(task_folder(folder, "export") / "manifest.json", manifest)
    finish_task(folder, "export", inputs)


def test_a_bundle_that_is_there_is_copied_without_our_marks(tmp_path):
    export_run(finished_run(tmp_path), tmp_path / "out", RecordingReporter())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["manifest.json"]


def test_what_is_to_be_said_of_a_bundle_is_said_when_it_is_copied_too(tmp_path):
    folder = finished_run(tmp_path)
    config = with_overrides(kept_run(tmp_path).config, {"export.atlas_size": "2048"})
    exported(folder, config, {"atlas": {"size": 512}})
    reporter = RecordingReporter()
    export_run(folder, tmp_path / "out", reporter, atlas="2048")
    assert [fields["code"] for fields in reporter.named("finding")] == ["export.atlas_unused"]


def test_a_texture_coarser_than_transport_is_refused_and_does_not_make_that_coarser(tmp_path):
    with pytest.raises(ConfigError, match=r"at least export\.transport_size.*256 and 512"):
        export_run(finished_run(tmp_path), tmp_path / "out", RecordingReporter(), atlas="256")


@pytest.fixture
def asked(monkeypatch):
    """Return the settings of the exports that are made, which do nothing."""
    settings = []
    monkeypatch.setattr(prepare, "run_task", lambda context, inputs: settings.append(context.config.export))
    return settings


def test_tier_and_weights_of_an_export_replace_the_runs_settings(tmp_path, asked):
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


def test_the_number_of_triangles_of_an_export_is_given_or_found(tmp_path, asked):
    folder, reporter = finished_run(tmp_path), RecordingReporter()
    for name, faces in (("few", "900"), ("needed", "auto")):
        export_run(folder, tmp_path / name, reporter, faces=faces)
    # The run's own setting is "auto", and its bundle is there.
    assert [settings.faces for settings in asked] == [900]
    assert (tmp_path / "needed" / "manifest.json").is_file()
    for faces in ("some", "3", "2000000"):
        with pytest.raises(ConfigError, match="faces"):
            export_run(folder, tmp_path / "wrong", reporter, faces=faces)


def test_an_existing_bundle_folder_is_not_overwritten(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(UsageError, match=r"export\.exists"):
        export_run(finished_run(tmp_path), tmp_path / "out", RecordingReporter())


def test_a_run_that_is_not_trained_has_no_bundle(tmp_path):
    kept_run(tmp_path)
    with pytest.raises(UsageError, match=r"run\.not_trained"):
        export_run(tmp_path / "run", tmp_path / "out", RecordingReporter())

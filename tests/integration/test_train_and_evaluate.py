"""From a capture through training to a scored evaluation, small enough for a test."""

import json
import shutil

import numpy as np
import pytest
from lambent_core.errors import Stopped, UsageError
from lambent_core.exr import read_exr_rgb
from lambent_relight.environment.maps import write_environment
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.evaluation import evaluate_run, read_maps
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.spec import RunSpec
from support.captures import REFERENCES
from support.predictions import reference_evaluation
from support.recording_reporter import RecordingReporter

pytestmark = pytest.mark.slow

SCENE = REFERENCES / "scenes" / "tensoir_synthetic"
SMALL = {
    "max_side": "16",
    "stage_one.num_steps": "6",
    "stage_two.num_steps": "4",
    "stage_two.warmup_steps": "2",
    "stage_two.distil.num_steps": "2",
    "evaluation.num_views": "1",
    "evaluation.num_directions": "8",
}
REQUEST = EvaluationRequest(num_repeats=1, num_directions=8, max_side=16)
TASKS = ("ingest", "cache", "joint", "evaluate")


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """Return a run that has been trained for a few steps."""
    folder = tmp_path_factory.mktemp("train") / "run"
    spec = RunSpec.from_options(SCENE, preset="tiny", overrides=SMALL)
    run_pipeline(spec, folder, "cpu", RecordingReporter(), TASKS)
    return folder


@pytest.fixture
def maps(tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    write_environment(folder / "studio_small_05.exr", np.full((8, 16, 3), 0.5, dtype=np.float32))
    write_environment(folder / "venice_sunset.exr", np.full((32, 64, 3), 0.5, dtype=np.float32))
    return folder


def test_a_job_leaves_a_report_a_page_and_a_preview(run_dir):
    report = json.loads((run_dir / "evaluation" / "report.json").read_text())
    names = {row["name"] for row in report["metrics"]}
    assert {"nvs/psnr", "nvs_cache/psnr", "normal/mae_mask", "albedo_rgb_ratio/psnr_gamma"} <= names
    assert set(report["seconds"]) == set(TASKS[:3])
    assert report["num_views"] == 1
    assert any("--grey-card" in note for note in report["notes"])
    assert report["antialias"] == 1  # Of preset tiny.
    assert (run_dir / "evaluation" / "report.html").read_text().startswith("<!doctype html>")


@pytest.mark.long
def test_the_full_evaluation_relights_and_is_scored_the_same_by_the_reference(run_dir, maps, tmp_path):
    request = EvaluationRequest(num_repeats=1, num_directions=8, environments=maps)
    reporter = RecordingReporter()
    report = evaluate_run(run_dir, SCENE, tmp_path / "out", request, device="", reporter=reporter)
    assert report.antialias == 2
    ours = {row.name: row.value for row in report.metrics}
    reference = reference_evaluation().evaluate(SCENE, tmp_path / "out" / "pred")
    units = {row.name: row.unit for row in report.metrics}
    shared = {name for name in ours if name in reference}
    assert {"nvs/psnr", "relight/psnr", "albedo_rgb_ratio/psnr_gamma", "normal/mae_mask"} <= shared
    for name in shared:
        tolerance = 0.05 if units[name] in ("dB", "deg") else 1e-3
        assert ours[name] == pytest.approx(reference[name], abs=tolerance), name
    for folder, group in (("pred_cache", "nvs_cache"), ("pred_direct", "relight_direct")):
        other = reference_evaluation().evaluate(SCENE, tmp_path / "out" / folder)
        for figure, tolerance in (("psnr", 0.05), ("ssim", 1e-3)):
            expected = other[f"{group.split('_')[0]}/{figure}"]
            assert ours[f"{group}/{figure}"] == pytest.approx(expected, abs=tolerance), group
    assert {"relight_direct/psnr", "relight_unscaled/psnr"} <= set(ours)
    assert {"environment/log_rmse", "environment/peak_ratio"} <= set(ours)
    assert "true light, venice_sunset_000" in (tmp_path / "out" / "report.html").read_text()
    fractions = [fields["fraction"] for fields in reporter.named("progress")]
    assert fractions[-1] == 1.0
    assert list(report.albedo_ratio_rgb) == pytest.approx(reference["albedo_ratio"], rel=1e-3)


def test_every_monte_carlo_picture_has_its_standard_error_beside_it(run_dir, maps, tmp_path):
    out = tmp_path / "out"
    request = EvaluationRequest(
        num_views=1, num_repeats=2, num_directions=8, max_side=16, environments=maps, exr=True
    )
    report = evaluate_run(run_dir, SCENE, out, request, device="", reporter=RecordingReporter())
    pictures = [path for path in out.glob("pred*/*/rgba_*.npy") if not path.stem.endswith("_stderr")]
    random = [path for path in pictures if "pred_cache" not in path.parts[-3]]
    assert len(random) == 4
    for path in random:
        error = np.load(path.with_name(f"{path.stem}_stderr.npy"))
        assert error.shape == (16, 16, 3)
        assert error.max() > 0.0
        picture = read_exr_rgb(path.with_suffix(".exr"), max_pixels=512)
        linear = picture.rows(slice(0, picture.height))
        assert np.isfinite(linear).all()
    names = {row.name: row.value for row in report.metrics}
    assert names["nvs/noise_ceiling"] > names["nvs/psnr"]
    assert report.protocol_version
    assert len(report.protocol) >= 8
    assert {row.name for row in report.absent} >= {"nvs/lpips", "relight/lpips"}


def test_an_interrupted_evaluation_goes_on_where_it_stopped(run_dir, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(Stopped):
        evaluate_run(run_dir, SCENE, out, REQUEST, device="", reporter=RecordingReporter(stop_after=2))
    first = {path: path.stat().st_mtime_ns for path in out.rglob("*.npy")}
    assert first
    evaluate_run(run_dir, SCENE, out, REQUEST, device="", reporter=RecordingReporter())
    assert all(path.stat().st_mtime_ns == time for path, time in first.items())
    assert (out / "report.html").is_file()


def test_other_settings_replace_an_earlier_evaluation(run_dir, tmp_path):
    out = tmp_path / "out"
    evaluate_run(run_dir, SCENE, out, REQUEST, device="", reporter=RecordingReporter())
    (out / "pred" / "stale.npy").write_bytes(b"")
    other = EvaluationRequest(num_views=1, num_repeats=1, num_directions=8, max_side=16)
    report = evaluate_run(run_dir, SCENE, out, other, device="", reporter=RecordingReporter())
    assert report.num_views == 1
    assert not (out / "pred" / "stale.npy").exists()


def test_a_folder_with_something_else_is_left_alone(run_dir, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match=r"evaluate\.folder_not_empty"):
        evaluate_run(run_dir, SCENE, tmp_path, REQUEST, device="", reporter=RecordingReporter())
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_scene_in_another_light_cannot_be_compared(run_dir, tmp_path):
    scene = REFERENCES / "scenes" / "nerf_blender"
    with pytest.raises(UsageError, match=r"evaluate\.light_missing.*venice_sunset_000"):
        evaluate_run(run_dir, scene, tmp_path / "out", REQUEST, device="", reporter=RecordingReporter())


def test_a_run_that_is_not_finished_is_not_evaluated(run_dir, tmp_path):
    unfinished = tmp_path / "run"
    shutil.copytree(run_dir, unfinished)
    (unfinished / "steps" / "joint.done.json").unlink()
    with pytest.raises(UsageError, match=r"run\.not_trained"):
        evaluate_run(unfinished, SCENE, tmp_path / "out", REQUEST, device="", reporter=RecordingReporter())


def test_training_that_was_stopped_ends_like_training_that_was_not(run_dir, tmp_path):
    folder = tmp_path / "run"
    spec = RunSpec.from_options(SCENE, preset="tiny", overrides=SMALL)
    with pytest.raises(Stopped):
        run_pipeline(spec, folder, "cpu", RecordingReporter(stop_after=3), TASKS[:3])
    run_pipeline(spec, folder, "cpu", RecordingReporter(), TASKS[:3])
    name = "joint/step_0000006/model.safetensors"
    assert (folder / name).read_bytes() == (run_dir / name).read_bytes()


@pytest.mark.parametrize(
    ("name", "code"),
    [(None, "environments_missing"), ("other.exr", "unmatched"), ("studio_small_05.hdr", "unreadable")],
)
def test_environments_that_cannot_be_used_are_usage_errors(tmp_path, name, code):
    folder = tmp_path / "maps"
    if name is not None:
        folder.mkdir()
        (folder / name).write_bytes(b"not a map")
    with pytest.raises(UsageError, match=code):
        read_maps(folder, ("studio_small_05",))

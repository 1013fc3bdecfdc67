"""A whole run on a GPU, from a capture to a bundle that is relit, and an evaluation in other light."""

import json

import numpy as np
import pytest
from lambent_relight.environment.maps import write_environment
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.evaluation import evaluate_run
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.spec import RunSpec
from support.captures import REFERENCES
from support.recording_reporter import RecordingReporter

pytestmark = [pytest.mark.slow, pytest.mark.gpu]
SCENE = REFERENCES / "scenes" / "tensoir_synthetic"
# The preset's parts, all switched on, at a small size.
SMALL = {
    "max_side": "32",
    "stage_one.num_steps": "300",
    "stage_two.num_steps": "60",
    "stage_two.warmup_steps": "5",
    "stage_two.distil.num_steps": "20",
    "evaluation.num_views": "1",
    "evaluation.num_directions": "8",
}


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory):
    """Return a run that has trained on the GPU and written its bundle."""
    folder = tmp_path_factory.mktemp("train") / "run"
    spec = RunSpec.from_options(SCENE, preset="fast", overrides=SMALL)
    run_pipeline(spec, folder, "cuda", RecordingReporter())
    return folder


@pytest.mark.timeout(600)
def test_a_run_ends_with_a_report_and_a_bundle(run_dir):
    report = json.loads((run_dir / "evaluation" / "report.json").read_text())
    assert {"nvs/psnr", "normal/mae_mask"} <= {row["name"] for row in report["metrics"]}
    assert json.loads((run_dir / "run.json").read_text())["device"] == "cuda"
    assert (run_dir / "bundle" / "manifest.json").is_file()


@pytest.mark.timeout(600)
def test_what_it_trained_is_evaluated_in_other_light(run_dir, tmp_path):
    for name in ("studio_small_05", "venice_sunset"):
        write_environment(tmp_path / f"{name}.exr", np.full((32, 64, 3), 0.5, dtype=np.float32))
    request = EvaluationRequest(num_repeats=1, num_directions=8, max_side=16, environments=tmp_path)
    report = evaluate_run(run_dir, SCENE, tmp_path / "out", request, device="", reporter=RecordingReporter())
    found = {row.name: row.value for row in report.metrics}
    assert {"relight/psnr", "environment/log_rmse"} <= found.keys()
    assert all(np.isfinite(value) for value in found.values())

"""Every layout works in a job: it is checked in the child process, described, loaded and trained on."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from lambent_capture.checks.check import check_capture
from lambent_capture.loading.load import load_scene
from lambent_run.report.request import EvaluationRequest
from lambent_run.run import evaluation as evaluation_run
from lambent_run.run.capture import left_out_of
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.spec import RunSpec
from support.captures import REFERENCES
from support.layouts import ColmapBinaryFolder
from support.recording_reporter import RecordingReporter

pytestmark = pytest.mark.slow

LAYOUTS = REFERENCES / "layouts"
SAMPLES = {
    "nerf_blender": LAYOUTS / "blender",
    "nerfstudio": LAYOUTS / "nerfstudio",
    "colmap": LAYOUTS / "colmap",
    "openillumination": LAYOUTS / "openillumination",
    "glossy_synthetic": LAYOUTS / "glossy",
    "tensoir_synthetic": REFERENCES / "scenes" / "tensoir_synthetic",
}
SMALL = {
    "max_side": "16",
    "stage_one.num_steps": "3",
    "stage_one.num_rays": "64",
    "stage_two.num_steps": "3",
    "stage_two.num_rays": "32",
    "stage_two.warmup_steps": "1",
    "stage_two.distil.num_steps": "1",
    "evaluation.num_views": "1",
    "evaluation.num_directions": "8",
}


@pytest.mark.parametrize(("layout", "folder"), SAMPLES.items(), ids=SAMPLES)
def test_a_forced_layout_is_checked_and_described_by_the_first_task(tmp_path, layout, folder):
    spec = RunSpec.from_options(folder, preset="tiny", layout=layout)
    run_pipeline(spec, tmp_path / "run", "cpu", RecordingReporter(), ("ingest",))
    manifest = json.loads((tmp_path / "run" / "scene" / "manifest.json").read_text())
    report = json.loads((tmp_path / "run" / "scene" / "capture.json").read_text())
    assert manifest["layout"] == report["layout"] == layout
    assert report["usable"]
    assert len(manifest["lights"]) == 1
    assert len(manifest["frames"]) == report["num_train_frames"] + report["num_test_frames"]


def test_the_check_says_the_same_from_its_child_process(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    capture.mask(3).write_text("no picture")
    (finding,) = check_capture(capture.folder).report.findings
    assert (finding.code, finding.subject) == ("scene.image_not_a_picture", "masks/IMG_0003.png.png")


def test_a_run_goes_on_without_a_picture_that_ends_too_early_and_one_that_is_missing(tmp_path):
    capture = ColmapBinaryFolder(tmp_path / "scene")
    broken = capture.picture(3)
    broken.write_bytes(broken.read_bytes()[: broken.stat().st_size // 2])
    capture.picture(5).unlink()
    spec = RunSpec.from_options(capture.folder, preset="tiny")
    reporter = RecordingReporter()
    run_pipeline(spec, tmp_path / "run", "cpu", reporter, ("ingest",))
    manifest = json.loads((tmp_path / "run" / "scene" / "manifest.json").read_text())
    names = {frame["name"] for frame in manifest["frames"]}
    assert len(names) == len(capture.poses) - 2
    assert not names & {"IMG_0003", "IMG_0005"}
    context = SimpleNamespace(run_dir=tmp_path / "run")
    assert left_out_of(context, capture.folder) == [capture.path(3)]
    broken.write_bytes(capture.picture(4).read_bytes())  # repaired meanwhile: another file
    assert left_out_of(context, capture.folder) == []


def test_a_model_far_from_the_origin_trains_and_is_evaluated_in_the_world_it_was_trained_in(
    tmp_path, monkeypatch
):
    scene = tmp_path / "scene"
    shutil.copytree(LAYOUTS / "colmap", scene, ignore=shutil.ignore_patterns("sparse_text"))
    shutil.rmtree(scene / "sparse")
    shutil.copytree(LAYOUTS / "colmap" / "sparse_text", scene / "sparse")
    shift(scene / "sparse" / "0" / "images.txt", np.array([100.0, -50.0, 20.0]), 10.0)
    spec = RunSpec.from_options(scene, preset="tiny", overrides=SMALL)
    run_pipeline(spec, tmp_path / "run", "cpu", RecordingReporter(), ("ingest", "cache", "joint"))
    manifest = json.loads((tmp_path / "run" / "scene" / "manifest.json").read_text())
    world = np.array(manifest["world_from_capture"]).reshape(4, 4)
    assert np.abs(world[:3, :3] @ [100.0, -50.0, 20.0] + world[:3, 3]).max() < 1.0
    # Fewer photographs would be settled elsewhere if they were looked at alone.
    for name in ("train_000", "train_003", "train_006"):
        remove(scene / "sparse" / "0" / "images.txt", f"{name}.png")
    seen = []
    monkeypatch.setattr(
        evaluation_run,
        "load_scene",
        lambda *args, **options: seen.append(args[1]) or load_scene(*args, **options),
    )
    request = EvaluationRequest(num_repeats=1, num_directions=8, max_side=16)
    evaluation_run.evaluate_run(
        tmp_path / "run", scene, tmp_path / "out", request, device="", reporter=RecordingReporter()
    )
    trained = {frame["name"]: frame["camera"]["camera_to_world"] for frame in manifest["frames"]}
    evaluated = {frame.name: list(frame.camera.camera_to_world) for frame in seen[0].frames}
    assert evaluated
    for name, pose in evaluated.items():
        np.testing.assert_allclose(pose, trained[name], atol=1e-8)


def shift(path, offset, scale):
    """Move and enlarge a model: x' = scale x + offset."""
    lines = []
    for line in path.read_text().splitlines():
        words = line.split()
        if len(words) == 10 and not line.startswith("#") and words[9].endswith(".png"):
            w, x, y, z = (float(v) for v in words[1:5])
            turn = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                ]
            )
            moved = scale * np.array([float(v) for v in words[5:8]]) - turn @ offset
            line = " ".join([*words[:5], *(f"{v:.12g}" for v in moved), *words[8:]])
        lines.append(line)
    path.write_text("\n".join(lines) + "\n")


def remove(path, name):
    """Leave an image out of a model."""
    lines = path.read_text().splitlines()
    place = next(i for i, line in enumerate(lines) if line.endswith(f" {name}"))
    path.write_text("\n".join(lines[:place] + lines[place + 2 :]) + "\n")

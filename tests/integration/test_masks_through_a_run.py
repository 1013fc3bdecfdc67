"""Masks on their way through a run: given, estimated or refused, and the same ones in every later task."""

import json

import numpy as np
import pytest
from lambent_capture.loading.load import load_scene
from lambent_core.errors import SceneRefusedError
from lambent_proto.v1 import scene_pb2
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.capture import read_manifest
from lambent_run.run.evaluation import _scene_to_compare
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import open_task
from lambent_run.run.spec import RunSpec
from PIL import Image
from support.ball_photographs import write_ball_photographs, write_masks
from support.recording_reporter import RecordingReporter

from benchmarks.painted_scene import overlap

pytestmark = pytest.mark.slow


def ingest(tmp_path, **options):
    """Run the first task alone; return the run's context and what was reported."""
    spec = RunSpec.from_options(tmp_path / "scene", preset="tiny", **options)
    reporter = RecordingReporter()
    run_pipeline(spec, tmp_path / "run", "cpu", reporter, PREPARATION)
    return open_task(tmp_path / "run", "cache", reporter), reporter


def alphas(context):
    """Return the coverage of every training view as training gets it."""
    scene = load_scene(context.spec.scene, read_manifest(context), max_side=64)
    return {view.name: next(iter(view.images.values()))[..., 3] for view in (*scene.train, *scene.test)}


def test_given_masks_are_kept_with_the_run_and_cut_its_photographs(tmp_path):
    true = write_ball_photographs(tmp_path / "scene")
    masks = write_masks(tmp_path / "cut", true)
    context, reporter = ingest(tmp_path, masks=masks)
    for path in masks.iterdir():
        path.unlink()
    found = alphas(context)
    assert all(np.array_equal(found[name] >= 0.5, mask) for name, mask in true.items())
    assert not reporter.named("artifact")
    manifest = json.loads((tmp_path / "run" / "scene" / "manifest.json").read_text())
    assert str(tmp_path) not in json.dumps(manifest)
    # The box comes from the masks, as if the layout had them.
    assert manifest["bounds_from"] == "silhouettes"


def test_without_masks_they_are_estimated_and_shown_and_used_by_evaluation(tmp_path):
    true = write_ball_photographs(tmp_path / "scene")
    context, reporter = ingest(tmp_path, overrides={"crop": "frame"})
    assert "scene.mask_estimated" in {call["code"] for call in reporter.named("finding")}
    (sheet,) = reporter.named("artifact")
    assert sheet["path"].is_file()
    found = alphas(context)
    assert min(overlap(found[name], mask.astype(float)) for name, mask in true.items()) > 0.9
    compared, _ = _scene_to_compare(context, tmp_path / "scene", EvaluationRequest())
    assert compared.test
    for view in compared.test:
        assert np.array_equal(next(iter(view.images.values()))[..., 3], found[view.name])


def test_masks_of_a_run_are_not_put_on_another_capture_with_the_same_names(tmp_path):
    true = write_ball_photographs(tmp_path / "scene")
    context, _ = ingest(tmp_path, masks=write_masks(tmp_path / "cut", true))
    write_ball_photographs(tmp_path / "other", count=13)
    (tmp_path / "other" / "train" / "r_12.png").unlink()
    transforms = tmp_path / "other" / "transforms_train.json"
    record = json.loads(transforms.read_text())
    record["frames"] = record["frames"][:12]
    transforms.write_text(json.dumps(record))
    compared, _ = _scene_to_compare(context, tmp_path / "other", EvaluationRequest())
    assert all((next(iter(view.images.values()))[..., 3] == 1.0).all() for view in compared.test)


def test_everything_in_view_is_taken_where_that_was_asked_for(tmp_path):
    write_ball_photographs(tmp_path / "scene", count=4)
    context, reporter = ingest(tmp_path, whole_view=True)
    assert all((alpha == 1.0).all() for alpha in alphas(context).values())
    assert not reporter.named("artifact")


def test_a_capture_whose_object_is_not_found_is_refused(tmp_path):
    write_ball_photographs(tmp_path / "scene", count=4)
    with pytest.raises(SceneRefusedError) as caught:
        ingest(tmp_path)
    (finding,) = caught.value.report.findings
    assert (finding.code, finding.severity) == ("scene.mask_missing", scene_pb2.SEVERITY_ERROR)
    assert "4 views are too few" in finding.message


def test_masks_that_were_refused_may_be_fixed_in_the_same_run_folder(tmp_path):
    true = write_ball_photographs(tmp_path / "scene")
    masks = write_masks(tmp_path / "cut", true)
    Image.new("L", (8, 8), 255).save(masks / "train_r_2.png")
    with pytest.raises(SceneRefusedError, match=r"scene\.mask_size: .*train_r_2\.png"):
        ingest(tmp_path, masks=masks)
    write_masks(masks, true)
    context, _ = ingest(tmp_path, masks=masks)
    assert len(alphas(context)) == 12

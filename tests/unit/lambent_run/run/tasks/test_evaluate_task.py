"""Findings of the evaluation inside a run."""

from dataclasses import replace

import numpy as np
import pytest
from flashcache.presets import tiny
from lambent_core.scene import Scene
from lambent_proto.v1 import scene_pb2
from lambent_run.report.common_factor import CODE
from lambent_run.run.card_option import GreyCard
from lambent_run.run.tasks import evaluate
from lambent_run.run.tasks.training import new_model
from support.lit_sphere import lit_sphere
from support.task_context import task_context

SCENE = lit_sphere(3, side=8)
TRUTH = {"albedo": np.zeros((8, 8, 4), np.float32)}


def told(tmp_path, monkeypatch, scene: Scene, **changes) -> list[tuple[str, str]]:
    """Return code and message of the findings of an evaluation in which nothing is rendered."""
    context = task_context(tmp_path, replace(tiny(), polish="on"), "evaluate", **changes)
    model = new_model(context, SCENE)
    monkeypatch.setattr(evaluate, "read_scene", lambda context: scene)
    monkeypatch.setattr(evaluate, "load_final", lambda context, scene: model)
    monkeypatch.setattr(evaluate, "read_manifest", lambda context: scene_pb2.SceneManifest())
    for name in ("uncertainty_of_run", "evaluated"):
        monkeypatch.setattr(evaluate, name, lambda *given: None)
    monkeypatch.setattr(evaluate, "preview_sheet", lambda subject: b"")
    evaluate.run(context)
    return [(each["code"], each["message"]) for each in context.reporter.named("finding")]


def test_the_open_factor_is_told_where_there_is_no_truth_that_removes_it(tmp_path, monkeypatch):
    ((code, message),) = told(tmp_path, monkeypatch, SCENE)
    assert code == CODE
    assert "--grey-card" in message
    known = replace(SCENE, test=tuple(replace(view, truth=TRUTH) for view in SCENE.test))
    assert told(tmp_path, monkeypatch, known) == []


def test_a_grey_card_leaves_nothing_to_tell(tmp_path, monkeypatch):
    assert told(tmp_path, monkeypatch, SCENE, grey_card=GreyCard("a.png", (0.0, 0.0, 4.0, 4.0))) == []


@pytest.mark.parametrize("name", ["sky.hdr", "sky.exr"])
def test_a_true_map_that_cannot_be_read_is_told_and_ends_nothing(tmp_path, monkeypatch, name):
    (tmp_path / "scene" / "envmaps").mkdir(parents=True)
    (tmp_path / "scene" / "envmaps" / name).write_bytes(b"no map")
    codes = [code for code, _ in told(tmp_path, monkeypatch, SCENE)]
    assert codes == ["evaluate.environment_unreadable", CODE]

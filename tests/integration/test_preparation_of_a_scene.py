"""Cameras and masks on a server: prepared once, corrected without photographs, used by every later job."""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lambent_run.job import process
from lambent_run.job.connection import Connection, Identity
from lambent_run.job.server_reporter import ServerReporter
from lambent_run.run import pipeline
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.tasks import ingest, masks
from PIL import Image
from support.api import Api, expect
from support.ball_photographs import write_ball_photographs
from support.ball_views import SIDE
from support.runs import Stage, staged, token

pytestmark = pytest.mark.slow
TASKS = {"ingest": ingest.run, "masks": masks.run}
MARK = {"frame": "train_r_3", "label": "background", "stroke": [[0, 0], [SIDE, 0]], "radius": SIDE // 2}
"""The upper half of a photograph."""


def text_of(*corrections: dict[str, Any]) -> str:
    return json.dumps({"version": 1, "corrections": list(corrections)})


def files_of(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with staged(tmp_path_factory.mktemp("s"), local_slots=50, progress_interval_s=0.001) as stage:
        yield stage


def work(stage: Stage, job: str, pipeline: Any = process.perform) -> Path:
    """Do a job as a run process does and return the folder of its run."""
    folder = stage.api.services.settings.runs / job / "run-1"
    folder.mkdir(parents=True)
    connection = Connection(
        Identity(job_id=job, run=1, address=stage.address, token=token(job, 1), work_dir=folder)
    )
    reporter = ServerReporter(connection, folder, progress_interval_s=0.01)
    try:
        process._work(connection, reporter, stage.call("Start", job), pipeline, process.check)
    finally:
        connection.close()
    return folder


def artifacts(api: Api, job: str) -> dict[str, bytes]:
    items = expect(api.get(f"/v1/jobs/{job}/artifacts"), 200)["items"]
    return {item["name"]: api.get(item["url"]).content for item in items}


def mask_of(files: dict[str, bytes], frame: str) -> np.ndarray:
    with Image.open(io.BytesIO(files[f"preparation/masks/{frame}.png"])) as image:
        return np.asarray(image) >= 128


@pytest.fixture(scope="module")
def prepared(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, dict, dict]:
    """Return a scene without masks, the job that has prepared it, its artifacts, and the true masks."""
    folder = tmp_path_factory.mktemp("ball")
    true = write_ball_photographs(folder)
    scene = stage.api.scene(files_of(folder))
    job = stage.start(scene_id=scene, kind="prepare")
    work(stage, job)
    found = stage.job(job)
    assert (found["state"], found["bundle_id"]) == ("succeeded", None), found["error"]
    return scene, job, artifacts(stage.api, job), true


def test_a_prepared_scene_shows_every_frame_with_its_mask_and_how_well_they_agree(prepared):
    _, _, files, true = prepared
    assert files["masks.jpg"].startswith(b"\xff\xd8")
    record = json.loads(files["preparation/frames.json"])
    assert (record["editable"], record["reason"], len(record["frames"])) == (True, "", len(true))
    assert 0.85 < record["overlap"] <= 1.0
    for frame in record["frames"]:
        mask = mask_of(files, frame["name"])
        with Image.open(io.BytesIO(files[f"preparation/{frame['picture']}"])) as picture:
            assert picture.size == mask.shape[::-1]
            assert max(picture.size) <= 800
        assert (frame["width"], frame["height"]) == (SIDE, SIDE)
        both = mask & true[frame["name"]]
        assert both.sum() / (mask | true[frame["name"]]).sum() > 0.85


def test_corrections_are_shown_without_photographs_and_without_the_tasks(
    stage: Stage, prepared, monkeypatch: pytest.MonkeyPatch
):
    scene, _, before, _ = prepared
    monkeypatch.setattr(process, "fetch_scene", None)
    monkeypatch.setattr(pipeline, "run_pipeline", None)
    job = stage.start(scene_id=scene, kind="prepare", params={"corrections": text_of(MARK)})
    folder = work(stage, job)
    assert stage.job(job)["state"] == "succeeded", stage.job(job)["error"]
    assert not (folder.parent / "scene").exists()
    after = artifacts(stage.api, job)
    assert after.keys() == before.keys()
    assert mask_of(before, MARK["frame"])[: SIDE // 2].any()
    assert not mask_of(after, MARK["frame"])[: SIDE // 2 - 1].any()
    assert (
        after[f"preparation/pictures/{MARK['frame']}.jpg"]
        == before[f"preparation/pictures/{MARK['frame']}.jpg"]
    )


@pytest.mark.parametrize(
    "text", ["no json", "{}", text_of({**MARK, "frame": "nobody"}), text_of({**MARK, "radius": -1})]
)
def test_corrections_that_cannot_be_used_end_the_job_for_good_and_publish_nothing(
    stage: Stage, prepared, text: str
):
    job = stage.start(scene_id=prepared[0], kind="prepare", params={"corrections": text})
    work(stage, job)
    found = stage.job(job)
    assert (found["state"], found["error"]["code"]) == ("failed", "config.corrections_invalid")
    assert artifacts(stage.api, job) == {}


def test_a_job_with_another_preset_uses_the_masks_that_are_kept(
    stage: Stage, prepared, monkeypatch: pytest.MonkeyPatch
):
    ran = []

    def function(name: str) -> Any:
        ran.append(name)
        return TASKS.get(name, lambda context: None)

    monkeypatch.setattr(pipeline, "_task_function", function)
    monkeypatch.setattr(masks, "find_object", None)
    monkeypatch.setattr(process, "_send_bundle", lambda connection, bundle: [])
    job = stage.start(scene_id=prepared[0], preset="fast", params={"stage_one.num_steps": "7"})
    folder = work(stage, job)
    assert stage.job(job)["state"] == "succeeded", stage.job(job)["error"]
    assert ran[: len(PREPARATION) - 1] == ["ingest", "masks"]
    assert len(list((folder / "estimated_masks" / "masks").iterdir())) == 12
    assert "masks.jpg" in artifacts(stage.api, job)


@pytest.mark.parametrize("order", [{"params": {"layout": "nerf_blender"}}, {"params": {"masks": "none"}}])
def test_an_estimate_that_was_made_with_other_settings_is_not_shown(stage: Stage, prepared, order):
    job = stage.start(scene_id=prepared[0], kind="prepare", **order)
    orders = []
    folder = work(stage, job, orders.append)
    assert len(orders) == 1
    assert artifacts(stage.api, job) == {}
    assert (folder.parent / "scene").exists()


def test_masks_that_nobody_believes_are_shown_with_the_reason_and_may_be_corrected(
    stage: Stage, tmp_path: Path
):
    write_ball_photographs(tmp_path, count=5)
    scene = stage.api.scene(files_of(tmp_path))
    job = stage.start(scene_id=scene, kind="prepare")
    work(stage, job)
    assert stage.job(job)["state"] == "succeeded", stage.job(job)["error"]
    assert "5 views are too few" in json.loads(artifacts(stage.api, job)["preparation/frames.json"])["reason"]
    mark = {**MARK, "label": "object", "stroke": [[SIDE / 2, SIDE / 2]], "radius": 8}
    corrected = stage.start(scene_id=scene, kind="prepare", params={"corrections": text_of(mark)})
    folder = work(stage, corrected)
    assert json.loads(artifacts(stage.api, corrected)["preparation/frames.json"])["reason"] == ""
    assert not (folder.parent / "scene").exists()


def test_masks_that_a_capture_brings_are_shown_and_not_corrected(stage: Stage, tmp_path: Path):
    true = write_ball_photographs(tmp_path)
    for name, mask in true.items():
        path = tmp_path / "train" / f"{name.removeprefix('train_')}.png"
        with Image.open(path) as image:
            pixels = np.dstack([np.asarray(image.convert("RGB")), np.where(mask, 255, 0)])
        Image.fromarray(pixels.astype(np.uint8)).save(path)
    scene = stage.api.scene(files_of(tmp_path))
    job = stage.start(scene_id=scene, kind="prepare")
    work(stage, job)
    files = artifacts(stage.api, job)
    record = json.loads(files["preparation/frames.json"])
    assert (record["editable"], record["doubtful"]) == (False, [])
    assert all(np.array_equal(mask_of(files, name), mask) for name, mask in true.items())
    job = stage.start(scene_id=scene, kind="prepare", params={"corrections": text_of(MARK)})
    work(stage, job)
    assert stage.job(job)["error"]["code"] == "config.corrections_invalid"

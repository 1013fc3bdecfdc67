"""Photographs without cameras through a real server: nothing is prepared, and nothing is found twice."""

import io
import json
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from lambent import Client, Event, Job, Scene
from PIL import Image
from support.live_server import LiveServer
from support.photographs import heif
from support.textured_box import SIDE, box_cameras, box_picture

pytest.importorskip("pycolmap", reason="cameras are found with it")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

COUNT = 12
SMALL = {
    "stage_one.num_steps": "150",
    "stage_one.num_rays": "256",
    "stage_two.num_steps": "4",
    "stage_two.num_rays": "32",
    "stage_two.warmup_steps": "1",
    "stage_two.distil.num_steps": "1",
    "evaluation.num_views": "1",
    "evaluation.num_directions": "8",
    "export.transport_tier": "none",
}


def archive(path: Path) -> Path:
    """Write a zip with a top folder of photographs, one of them HEIC as phones write it."""
    heif()
    with zipfile.ZipFile(path, "w") as file:
        for number, camera in enumerate(box_cameras(COUNT)):
            picture, buffer = Image.fromarray(box_picture(camera)[0]), io.BytesIO()
            heic = number == 3
            picture.save(buffer, "HEIF" if heic else "JPEG", quality=95)
            name = f"IMG_{number:04d}.HEIC" if heic else f"IMG_{number:04d}.jpg"
            file.writestr(f"my phone/{name}", buffer.getvalue())
        file.writestr("my phone/.DS_Store", b"x")
    return path


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    command = [sys.executable, "-m", "lambent_run", "run"]
    patient = {"heartbeat_s": 1.0, "lost_after_s": 30.0, "stop_grace_s": 20.0, "local_slots": 1}
    with (
        LiveServer(tmp_path_factory.mktemp("server") / "data", run_command=command, **patient) as server,
        Client(server.url, server.key) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def scene(client: Client, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return client.push(archive(tmp_path_factory.mktemp("phone") / "phone.zip"))


def stages_of(client: Client, job: str) -> list[str]:
    """Return the tasks that a job has told of, in order."""
    return list(
        dict.fromkeys(event.progress.stage for event in client.events(job) if event.type == "progress")
    )


@pytest.fixture(scope="module")
def trained(client: Client, scene: Scene) -> Job:
    """Return the first job of the scene, which finds everything."""
    job = client.wait(client.submit(scene.id, preset="tiny", params=SMALL).id)
    assert job.state == "succeeded", f"{job.error}\n{client.logs(job.id)[-3000:]}"
    return job


def test_photographs_become_a_bundle_with_no_option(client: Client, scene: Scene, trained: Job):
    assert trained.bundle_id
    stages = stages_of(client, trained.id)
    assert stages == ["cameras", "ingest", "masks", "cache", "joint", "evaluate", "export"]
    report = client.scene_report(scene.id)
    assert (report.layout, report.usable) == ("photographs", True)
    said = {event.message.partition(":")[0] for event in client.events(trained.id) if event.type == "finding"}
    assert {"scene.poses_solved", "scene.mask_estimated"} <= said
    assert {"masks.jpg", "report.html", "asset.glb"} <= {each.name for each in client.artifacts(trained.id)}


def test_another_job_of_the_scene_goes_on_from_cameras_and_masks(client: Client, scene: Scene, trained: Job):
    job = client.submit(scene.id, preset="tiny", params={**SMALL, "stage_one.num_steps": "100000"})
    for update in client.watch([job.id], after={job.id: 0}):
        if isinstance(update, Event) and update.progress.stage == "cache":
            client.cancel(job.id)
    log = client.logs(job.id)
    assert "cameras.restored" in log
    assert "masks.restored" in log
    assert "cameras.search" not in log
    assert client.job(job.id).state == "cancelled"


def test_masks_are_looked_at_and_corrected_with_neither_photographs_nor_torch(
    client: Client, scene: Scene, trained: Job
):
    frame = "IMG_0005"
    mark = {"frame": frame, "label": "background", "stroke": [[0, 0], [SIDE, 0]], "radius": SIDE // 2}
    shown = {}
    for name, marks in (("before", []), ("after", [mark])):
        params = {"corrections": json.dumps({"version": 1, "corrections": marks})} if marks else {}
        job = client.wait(client.submit(scene.id, kind="prepare", params=params).id)
        assert (job.state, job.bundle_id) == ("succeeded", ""), job.error
        assert "step.started" not in client.logs(job.id)
        found = {each.name: each for each in client.artifacts(job.id)}
        with Image.open(io.BytesIO(client.read_artifact(found[f"preparation/masks/{frame}.png"]))) as image:
            shown[name] = np.asarray(image) >= 128
    half = shown["before"].shape[0] // 2
    assert shown["before"][:half].any()
    assert not shown["after"][: half - 2].any()


def test_a_training_takes_the_corrections_that_were_looked_at(client: Client, scene: Scene, trained: Job):
    mark = {"frame": "IMG_0005", "label": "background", "stroke": [[0, 0], [SIDE, 0]], "radius": 4}
    corrections = json.dumps({"version": 1, "corrections": [mark]})
    endless = {**SMALL, "stage_one.num_steps": "100000", "corrections": corrections}
    job = client.submit(scene.id, preset="tiny", params=endless)
    for update in client.watch([job.id], after={job.id: 0}):
        if isinstance(update, Event) and update.progress.stage == "cache":
            client.cancel(job.id)
    assert client.job(job.id).state == "cancelled", client.logs(job.id)[-3000:]
    said = [event.message for event in client.events(job.id) if event.type == "finding"]
    assert any(each.startswith("scene.mask_estimated") and "corrected by hand" in each for each in said)
    assert "cameras.restored" in client.logs(job.id)

"""Pictures through a real server: orders, batches, faults, and the command that fetches what was made."""

import csv
import json
import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
from lambent import Client, Job, RefusedError
from lambent.batch_order import order_of
from lambent.cli import app
from lambent_relight import cameras_json, turntable, write_environment
from lambent_relight.batch.reading import read_manifest
from lambent_server.renders.messages import NewBatch
from lambent_server.storage.store import BlobStore
from PIL import Image
from support.live_server import LiveServer, wait_until

pytestmark = pytest.mark.slow

TRAINER = Path(__file__).parents[1] / "support" / "bundle_trainer.py"


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Return a server with two slots, whose data folder was given as a relative one."""
    command = json.dumps([sys.executable, str(TRAINER), "run"])
    data = Path(os.path.relpath(tmp_path_factory.mktemp("server") / "data"))
    with LiveServer(data, run_command=command, local_slots=2) as server:
        yield server


@pytest.fixture(scope="module")
def bundle_id(server):
    """Return the id of a published bundle."""
    job = server.wait(server.submit(server.scene()))
    assert job["state"] == "succeeded", job
    return job["bundle_id"]


@pytest.fixture
def client(server, monkeypatch):
    """Return a client; the command line finds the same server."""
    monkeypatch.setenv("LAMBENT_URL", server.url)
    monkeypatch.setenv("LAMBENT_API_KEY", server.key)
    with Client(server.url, server.key) as client:
        yield client


@pytest.fixture
def sky(tmp_path):
    """Return a map."""
    radiance = np.zeros((8, 16, 3), np.float32)
    radiance[:4] = (0.2, 0.4, 0.6)
    write_environment(tmp_path / "sky.exr", radiance)
    return tmp_path / "sky.exr"


def test_an_environment_that_was_damaged_in_the_store_is_sent_again(server, client, sky):
    first = client.push_environment(sky)
    path = server.data / "store" / BlobStore.key(first.sha256)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    again = client.push_environment(sky)
    assert (again.sha256, again.name) == (first.sha256, first.name)
    assert path.read_bytes() == whole


def test_a_render_is_a_job_whose_artifacts_are_pictures(client, bundle_id, sky, tmp_path):
    environment = client.push_environment(sky)
    assert client.push_environment(sky) == environment, "the same bytes are sent once"
    job = client.render(
        bundle_id,
        [environment.id, {"environment_id": environment.id, "name": "turned", "rotate_deg": 90}],
        {"views": ["turntable_002"], "size": 12},
        quality={"spp": 4, "antialias": 1},
        output={"files": ["png"]},
    )
    assert (job.kind, job.is_final) == ("render", False)
    updates = list(client.watch([job.id], after={job.id: 0}))
    (done,) = [update for update in updates if isinstance(update, Job) and update.is_final]
    assert done.state == "succeeded", client.logs(job.id)
    assert done.progress.stage == "render"
    found = {artifact.name: artifact for artifact in client.artifacts(job.id)}
    name = f"{bundle_id}/turned/refined/turntable_002.png"
    assert {name, "contact_sheet.png", "pictures.csv"} <= set(found)
    path = client.download(found[name], tmp_path / "one.png")
    with Image.open(path) as image:
        assert image.size == (12, 12)
    before = path.stat().st_mtime_ns
    assert client.download(found[name], path).stat().st_mtime_ns == before


def write_batch(tmp_path, bundle_id, **changes):
    document = {
        "schema": "lambent-batch/1",
        "name": "spring",
        "assets": [
            {"name": "ball", "bundle_id": bundle_id},
            {"name": "red", "bundle_id": bundle_id, "material": {"albedo": [0.9, 0.1, 0.1]}},
        ],
        "environments": [{"map": "sky.exr", "rotate_deg": [0, 90]}],
        "cameras": [{"turntable": 3, "size": 8}],
        "settings": {"spp": 4, "antialias": 1},
        **changes,
    }
    (tmp_path / "m.yaml").write_text(json.dumps(document))
    return document


def run_batch(tmp_path, *words):
    return app.run(["batch", str(tmp_path / "m.yaml"), "-o", str(tmp_path / "out"), *words])


def states(tmp_path):
    with (tmp_path / "out" / "pictures.csv").open(newline="") as file:
        return {line["picture"]: line["state"] for line in csv.DictReader(file)}


def test_a_batch_of_the_command_line_is_spread_over_jobs_and_fetched(client, bundle_id, sky, tmp_path):
    """Its table and contact sheet are those that this machine would make."""
    write_batch(tmp_path, bundle_id, output={"path": "{asset}-{environment}/{camera}"})
    assert run_batch(tmp_path, "--server") == 0
    found = states(tmp_path)
    assert len(found) == 12
    assert set(found.values()) == {"made"}
    with Image.open(tmp_path / "out/red-sky_90/turntable_002.png") as image:
        assert image.size == (8, 8)
    fetched = lines(tmp_path / "out")
    batch = next(client.batches())
    assert (batch.name, batch.num_pictures, batch.num_done, len(batch.job_ids)) == ("spring", 12, 12, 3)
    by_sdk = client.fetch_batch(batch.id, tmp_path / "sdk")
    names = {path.relative_to(tmp_path / "sdk").as_posix() for path in by_sdk}
    assert len(names) == 2 * 12 + 2
    assert {"contact_sheet.png", "pictures.csv", "red-sky_90/turntable_002.exr"} <= names
    assert run_batch(tmp_path, "--server") == 0
    assert next(client.batches()).id == batch.id, "the same manifest is the same batch"
    assert set(states(tmp_path).values()) == {"kept"}
    sheet = (tmp_path / "out" / "contact_sheet.png").read_bytes()
    # What the server made is what this machine would make: the journal knows it.
    assert run_batch(tmp_path) == 0
    assert set(states(tmp_path).values()) == {"kept"}
    shutil.rmtree(tmp_path / "out")
    assert run_batch(tmp_path) == 0
    local = (tmp_path / "out" / "contact_sheet.png").read_bytes()
    assert local == sheet == (tmp_path / "sdk" / "contact_sheet.png").read_bytes()
    assert lines(tmp_path / "sdk") == fetched == lines(tmp_path / "out")


def lines(folder):
    """Return a folder's table without what differs between two runs of the same."""
    with (folder / "pictures.csv").open(newline="") as file:
        return [{**line, "seconds": ""} for line in csv.DictReader(file)]


def test_a_dry_run_on_a_server_lists_the_work_and_sends_nothing(client, bundle_id, sky, tmp_path, capsys):
    sky = sky.rename(tmp_path / "dry.exr")
    before = client.environments(), [batch.id for batch in client.batches()]
    write_batch(tmp_path, bundle_id, environments=["dry.exr"], name="dry")
    assert run_batch(tmp_path, "--server", "--dry-run") == 0
    assert not (tmp_path / "out").exists()
    shown = capsys.readouterr()
    assert "6 to make, 0 to keep, 0 cannot be made" in shown.out
    assert f"to send: {sky}" in shown.err
    assert (client.environments(), [batch.id for batch in client.batches()]) == before
    assert run_batch(tmp_path, "--server", "--shards", "1") == 0
    capsys.readouterr()
    assert run_batch(tmp_path, "--server", "--dry-run") == 0
    shown = capsys.readouterr()
    assert "0 to make, 6 to keep, 0 cannot be made" in shown.out
    assert "to send" not in shown.err
    # A bundle that is not there fails its pictures; a map that is not there, the order.
    write_batch(tmp_path, "bundle_nowhere", environments=["dry.exr"])
    assert run_batch(tmp_path, "--server", "--dry-run") == 1
    assert "ball/*: batch.not_here" in capsys.readouterr().err
    write_batch(tmp_path, bundle_id, environments=[{"environment_id": "env_nowhere"}])
    assert run_batch(tmp_path, "--server", "--dry-run") == 2
    assert "batch.map_unknown" in capsys.readouterr().err


def test_what_a_server_cannot_make_is_listed_with_exit_code_one(client, bundle_id, sky, tmp_path, capsys):
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[1, 1] = np.nan
    write_environment(tmp_path / "broken.exr", radiance)
    write_batch(tmp_path, bundle_id, environments=["sky.exr", "broken.exr"], name="partly")
    assert run_batch(tmp_path, "--server", "--shards", "1") == 1
    told = [line for line in capsys.readouterr().err.splitlines() if "environment.unusable_values" in line]
    assert len(told) == 6, "each failure is reported once"
    found = states(tmp_path)
    assert {name.split("/")[1] for name, state in found.items() if state == "failed"} == {"broken"}
    assert sorted(found.values()) == ["failed"] * 6 + ["made"] * 6
    assert next(client.batches()).num_failed == 6


def test_bad_orders_are_refused(client, sky, tmp_path, capsys):
    write_batch(tmp_path, "bundle_nowhere")
    assert run_batch(tmp_path, "--server") == 4
    assert "bundle_not_found" in capsys.readouterr().err
    write_batch(tmp_path, "x", assets=["ball.relight"])
    assert run_batch(tmp_path, "--server") == 2
    assert "batch.bundle_here" in capsys.readouterr().err
    with pytest.raises(RefusedError) as caught:
        client.render("bundle_nowhere", ["env_nowhere"], {"turntable": 1})
    assert caught.value.code == "bundle_not_found"


def test_bundles_of_a_server_are_fetched_for_a_batch_on_this_machine(client, bundle_id, sky, tmp_path):
    write_batch(tmp_path, bundle_id, cameras=["all"])
    assert run_batch(tmp_path, "--dry-run") == 0
    assert not (tmp_path / "out").exists(), "a dry run fetches no bundle"
    assert run_batch(tmp_path) == 0
    assert set(states(tmp_path).values()) == {"made"}
    assert (tmp_path / "out" / "inputs" / bundle_id / "manifest.json").is_file()


def long_order(client, bundle_id, sky, num_pictures):
    """Return an order that takes a while."""
    return {
        "assets": [{"bundle_id": bundle_id}],
        "environments": [{"environment_id": client.push_environment(sky).id}],
        "cameras": [{"turntable": num_pictures, "size": 24}],
        "qualities": [{"spp": 4, "antialias": 1}],
        "output": {"files": ["png"]},
        "shards": 1,
    }


def test_a_stopped_run_goes_on_from_its_checkpoint(client, server, bundle_id, sky):
    order = long_order(client, bundle_id, sky, 80)
    batch = client.submit_batch(order, idempotency_key="to-stop")
    assert client.submit_batch(order, idempotency_key="to-stop").id == batch.id
    (job_id,) = batch.job_ids
    server.wait_step(job_id, 5)
    worker = wait_until(
        lambda: next(
            (p for p in psutil.process_iter() if _is_worker(p, job_id) and "work" in p.cmdline()), None
        )
    )
    os.kill(worker.pid, signal.SIGTERM)
    job = server.wait(job_id)
    assert job["state"] == "succeeded", client.logs(job_id)
    assert job["run"] == 2
    assert any(event.type == "checkpoint" for event in client.events(job_id))
    assert "checkpoint.restored" in client.logs(job_id)
    names = [artifact.name for artifact in client.batch_artifacts(batch.id)]
    assert len([name for name in names if name.endswith(".png") and "/" in name]) == 80


def test_a_cancelled_batch_ends_and_can_be_tried_again(client, server, bundle_id, sky):
    batch = client.submit_batch(long_order(client, bundle_id, sky, 400))
    server.wait_step(batch.job_ids[0], 1)
    client.cancel_batch(batch.id)
    assert wait_until(lambda: client.batch(batch.id).state == "cancelled")
    retried = client.retry_batch(batch.id)
    assert retried.state in ("queued", "running")
    client.cancel_batch(batch.id)


def _is_worker(process, job_id):
    try:
        return job_id in process.environ().get("LAMBENT_RUN", "")
    except (psutil.Error, OSError):
        return False


def test_whatever_a_manifest_may_say_a_server_takes(tmp_path):
    """The client's body of every kind of manifest is one that the server's own description allows."""
    (tmp_path / "c.json").write_text(cameras_json(turntable(2, radius=2.0, width=9, height=6)))
    document = {
        "schema": "lambent-batch/1",
        "assets": [{"bundle_id": "b", "object_rotate_deg": -20, "material": {"roughness_scale": 0}}],
        "environments": [
            {
                "name": "e",
                "environment_id": "f",
                "axes": "skylibs",
                "mend": True,
                "sun_clamp": 3,
                "rotate_deg": 9,
            }
        ],
        "cameras": [
            {"turntable": 2, "name": "t", "elevation_deg": 0, "radius": 3, "field_of_view_deg": 20},
            {"file": "c.json", "name": "f", "size": 3},
            {"views": ["x"]},
            "all",
        ],
        "qualities": ["preview", {"quality": "refined", "until_stderr": 0.1, "background": "white"}],
        "output": {"files": ["exr"], "passes": "none", "half": False},
    }
    body = order_of(read_manifest(document, tmp_path), {})
    parsed = NewBatch.model_validate(json.loads(json.dumps(body)))
    assert [camera.width for camera in parsed.cameras[1].poses] == [3, 3]
    assert parsed.cameras[0].elevation_deg == 0.0
    assert parsed.qualities[1].until_stderr == 0.1
    assert parsed.output.passes == []

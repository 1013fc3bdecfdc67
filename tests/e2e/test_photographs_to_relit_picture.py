"""The whole chain on a still life, small and real: upload, train, lose the run, resume, relight, bake.

Preset `tiny`: its pictures are rough, so that the floors here say "it works" and no more. The figures of
the other presets are in docs/benchmarks/.
"""

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
import psutil
import pytest
from lambent import Client, Event, Job, truth
from lambent.cli import app
from lambent_relight import cameras_json, load_bundle, load_environment
from lambent_relight.bundle.adapted import adapted_lights, environment_digest
from PIL import Image
from support.live_server import LiveServer

# The first test waits for the training: six minutes on two cores that compile the kernels, too, and do other
# work beside.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]

SAMPLE = Path(__file__).parents[1] / "data" / "still_life"
TRAIN_LIGHT, UNSEEN_LIGHT = "morning_000", "sunset"
MIN_KILL_STEP = 120
"""Stage 1 of `tiny` has 350 steps and a checkpoint every 50."""


BAKE_STEPS = "4"


@dataclass(frozen=True)
class Trained:
    """A scene that was trained on the server, its run killed once."""

    scene_id: str
    job: Job
    killed_at: int
    """Step of stage 1 at which the run was killed; 0: it was not."""
    steps_after: list[int]
    """Steps that the second run reported."""
    log: str
    bundle: Path
    """The folder of the downloaded bundle."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Return a server that runs the real pipeline and notices a lost run within seconds."""
    command = [sys.executable, "-m", "lambent_run", "run"]
    patient = {"heartbeat_s": 1.0, "lost_after_s": 5.0, "stop_grace_s": 20.0}
    with LiveServer(tmp_path_factory.mktemp("server") / "data", run_command=command, **patient) as server:
        yield server
        for process in run_processes(server):
            process.kill()


def run_processes(server):
    """Return the processes of the server's jobs: the supervisor and the one that trains."""
    return [
        process
        for process in psutil.Process(server.process.pid).children(recursive=True)
        if "lambent_run" in process.cmdline()
    ]


def kill_run(server):
    """Kill -9 the supervisor and the training process, as a lost machine would."""
    for process in run_processes(server):
        os.kill(process.pid, signal.SIGKILL)


def over_white(path):
    with Image.open(path) as image:
        return truth.over_white(np.asarray(image.convert("RGBA"), np.float64) / 255.0)


@pytest.fixture(scope="module")
def trained(server, tmp_path_factory):
    """Return the result of the sample whose run was killed during training."""
    with Client(server.url, server.key) as client:
        scene = client.push(SAMPLE)
        job = client.submit(scene.id, preset="tiny", seed=0)
        killed_at, saved, steps_after = 0, 0, []
        for update in client.watch([job.id], after={job.id: 0}):
            if not isinstance(update, Event):
                continue
            if update.type == "checkpoint" and not killed_at:
                saved += 1
            in_training = update.type == "progress" and update.progress.stage == "cache"
            if in_training and not killed_at and saved and update.progress.step >= MIN_KILL_STEP:
                killed_at = update.progress.step
                kill_run(server)
            elif in_training and update.run == 2:
                steps_after.append(update.progress.step)
        assert isinstance(update, Job)
        log = client.logs(job.id)
        assert update.state == "succeeded", f"{update.error}\n{log[-3000:]}"
        bundle = client.fetch(job.id, tmp_path_factory.mktemp("fetched") / "bundle").path
    return Trained(scene.id, update, killed_at, steps_after, log, bundle)


def test_photographs_become_a_relit_picture_although_the_run_is_killed_once(trained, tmp_path):
    assert trained.killed_at, "training ended before it could be killed"
    assert trained.job.run == 2
    trained_on = [step for step in trained.steps_after if step > 1]
    assert trained_on[0] >= trained.killed_at - 100, "the second run continued from the last checkpoint"
    bundle = trained.bundle

    views = [truth.read_view(SAMPLE / name, (TRAIN_LIGHT, UNSEEN_LIGHT)) for name in ("test_000", "test_003")]
    (tmp_path / "views.json").write_text(cameras_json([view.camera for view in views]))
    sky = SAMPLE / "envmaps" / f"{UNSEEN_LIGHT}.hdr"
    words = ["relight", str(bundle), "--env", str(sky), "--cameras", str(tmp_path / "views.json")]
    assert app.run([*words, "-o", str(tmp_path / "out"), "--spp", "32"]) == 0

    relit, copied = [], []
    for view in views:
        true = view.pictures_srgb[UNSEEN_LIGHT]
        relit.append(truth.psnr(over_white(tmp_path / "out" / UNSEEN_LIGHT / f"{view.name}.png"), true))
        copied.append(truth.psnr(view.pictures_srgb[TRAIN_LIGHT], true))
    print(json.dumps({"relit": relit, "photograph as it is": copied}))
    # By 1.0 to 1.7 dB with three seeds; another processor rounds differently, which is as another seed.
    assert np.mean(relit) > np.mean(copied) + 0.5, "relighting beats the photograph as it is"


def test_a_bake_through_the_server_makes_what_the_command_line_makes(server, trained, tmp_path):
    sky = SAMPLE / "envmaps" / f"{UNSEEN_LIGHT}.hdr"
    with Client(server.url, server.key) as client:
        light = client.push_environment(sky)
        settings = {"name": UNSEEN_LIGHT, "rotate_deg": "30", "steps": BAKE_STEPS}
        named = {"bundle": trained.job.bundle_id, "environment": light.id}
        job = client.submit(trained.scene_id, kind="bake", params={**named, **settings})
        stages = {
            update.progress.stage
            for update in client.watch([job.id], after={job.id: 0})
            if isinstance(update, Event) and update.type == "progress"
        }
        done = client.job(job.id)
        assert done.state == "succeeded", f"{done.error}\n{client.logs(job.id)[-3000:]}"
        assert "bake" in stages
        baked = client.fetch(job.id, tmp_path / "baked").path
        first = load_bundle(baked).cameras()[0].name
        rendered = client.render(
            done.bundle_id,
            [{"environment_id": light.id, "rotate_deg": 30}],
            {"views": [first], "size": 24},
            quality={"quality": "refined", "bounces": "adapted", "spp": 16, "antialias": 1},
            output={"files": ["exr"], "passes": ["indirect"], "half": False},
        )
        ended = client.wait(rendered.id)
        assert ended.state == "succeeded", f"{ended.error}\n{client.logs(rendered.id)[-3000:]}"
        found = {artifact.name: artifact for artifact in client.artifacts(rendered.id)}
        (record,) = client.read_artifact(found["pictures.jsonl"]).decode().splitlines()
        assert json.loads(record)["bounces"] == f"adapted:{UNSEEN_LIGHT}"
        (name,) = (name for name in found if name.endswith(".exr"))
        of_server = indirect_pass(client.download(found[name], tmp_path / "server.exr"))

    words = ["--name", UNSEEN_LIGHT, "--rotate-deg", "30", "--steps", BAKE_STEPS, "-o", "by_hand"]
    command = [sys.executable, "-m", "lambent", "bake-light", str(trained.bundle), str(sky), *words]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    (of_job,), (by_hand,) = (adapted_lights(load_bundle(path)) for path in (baked, tmp_path / "by_hand"))
    assert (of_job.name, of_job.rotate_deg) == (UNSEEN_LIGHT, 30.0)
    assert of_job.environment_sha256 == environment_digest(load_environment(sky))
    assert of_job.environment_sha256 == by_hand.environment_sha256
    assert of_job.albedo_ratio == by_hand.albedo_ratio

    pictures = {}
    for name, bundle, bounces in (
        ("job", baked, "adapted"),
        ("hand", tmp_path / "by_hand", "adapted"),
        ("transport", baked, "transport"),
    ):
        (tmp_path / "view.json").write_text(cameras_json([load_bundle(bundle).cameras()[0].resized(24, 24)]))
        words = ["relight", str(bundle), "--env", str(sky), "--cameras", str(tmp_path / "view.json")]
        words += ["--rotate-deg", "30", "--spp", "16", "--antialias", "1", "--bounces", bounces]
        assert app.run([*words, "-o", str(tmp_path / name)]) == 0
        pictures[name] = indirect_pass(next((tmp_path / name / UNSEEN_LIGHT).glob("*.exr")))
    same, other = (np.abs(pictures[name] - pictures["job"]).mean() for name in ("hand", "transport"))
    assert pictures["job"].mean() > 0.0
    assert same < 0.05 * other, "order of sums may differ, the light may not"
    # The command line writes halves.
    np.testing.assert_allclose(of_server, pictures["job"], rtol=2e-3, atol=1e-5)


def indirect_pass(path):
    """Return the light that bounced, [height, width, 3]."""
    channels = OpenEXR.File(str(path), separate_channels=True).parts[0].channels
    return np.stack([channels[f"indirect.{name}"].pixels for name in "RGB"], axis=-1).astype(np.float32)

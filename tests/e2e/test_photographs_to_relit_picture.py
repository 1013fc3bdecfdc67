"""The whole chain on the bundled sample, small and real: upload, train, lose the run, resume, relight.

Preset `tiny`: its pictures are rough, so that the floors here say "it works" and no more. The figures of
the presets people use stand in docs/benchmarks/.
"""

import json
import os
import signal
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
from lambent import Client, Event, Job, truth
from lambent.cli import app
from lambent_relight import cameras_json
from PIL import Image
from support.live_server import LiveServer

SAMPLE = Path(__file__).parents[2] / "client" / "python" / "lambent" / "sample"
TRAIN_LIGHT, UNSEEN_LIGHT = "morning_000", "sunset"
MIN_KILL_STEP = 120
"""Stage 1 of `tiny` has 350 steps and a checkpoint every 50."""


@pytest.fixture
def server(tmp_path):
    """Return a server that runs the real pipeline and notices a lost run within seconds."""
    command = [sys.executable, "-m", "lambent_worker", "run"]
    patient = {"heartbeat_s": 1.0, "lost_after_s": 5.0, "stop_grace_s": 20.0}
    with LiveServer(tmp_path / "data", run_command=command, **patient) as server:
        yield server
        for process in run_processes(server):
            process.kill()


def run_processes(server):
    """Return the processes of the server's jobs: the supervisor and the one that trains."""
    return [
        process
        for process in psutil.Process(server.process.pid).children(recursive=True)
        if "lambent_worker" in process.cmdline()
    ]


def kill_run(server):
    """Kill -9 the supervisor and the training process, as a lost machine would."""
    for process in run_processes(server):
        os.kill(process.pid, signal.SIGKILL)


def over_white(path):
    with Image.open(path) as image:
        return truth.over_white(np.asarray(image.convert("RGBA"), np.float64) / 255.0)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_photographs_become_a_relit_picture_although_the_run_is_killed_once(server, tmp_path, monkeypatch):
    monkeypatch.setenv("LAMBENT_DATA", str(server.data))
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
        assert update.state == "succeeded", f"{update.error}\n{client.logs(job.id)[-3000:]}"
        assert killed_at, "training ended before it could be killed"
        assert update.run == 2
        trained_on = [step for step in steps_after if step > 1]
        assert trained_on[0] >= killed_at - 100, "the second run went on from the last checkpoint"
        bundle = client.fetch(job.id, tmp_path / "bundle").path

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
    assert np.mean(relit) > np.mean(copied) + 1.0, "relighting beats the photograph as it is"

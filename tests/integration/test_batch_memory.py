"""Memory stays constant over a batch of many frames: each picture's memory is freed before the next one."""

import subprocess
import sys

import numpy as np
import pytest
from lambent_relight import write_environment
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere

# Ten seconds of a machine of its own; much longer beside busy neighbours.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

WARM, FRAMES, SIDE = 60, 500, 32
PROGRAM = f"""
import sys
from pathlib import Path
import psutil
from lambent_relight.batch.journal import open_journal
from lambent_relight.batch.plan import make_plan
from lambent_relight.batch.reading import read_manifest
from lambent_relight.batch.run import run_batch

folder = Path(sys.argv[1])
manifest = read_manifest({{
    "schema": "lambent-batch/1",
    "assets": ["ball"],
    "environments": ["sky.exr"],
    "cameras": [{{"turntable": {FRAMES}, "size": {SIDE}}}],
    "settings": {{"spp": 2, "antialias": 1, "indirect": False}},
    "output": {{"files": ["png"]}},
}}, folder)
plan = make_plan(manifest)
me = psutil.Process()
with open_journal(folder / "out") as journal:
    for number, result in enumerate(run_batch(plan, manifest.files, journal), 1):
        assert result.state == "made", result
        if number in ({WARM}, {FRAMES}):
            print(number, me.memory_info().rss, flush=True)
"""


def test_five_hundred_frames_need_the_memory_of_sixty(tmp_path):
    write_analytic_bundle(tmp_path / "ball", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))
    write_environment(tmp_path / "sky.exr", np.ones((8, 16, 3), np.float32))
    command = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=580, check=False)
    assert done.returncode == 0, done.stderr
    resident = {int(line.split()[0]): int(line.split()[1]) for line in done.stdout.splitlines()}
    growth = resident[FRAMES] - resident[WARM]
    # A cached view would keep its camera rays and their hits, 70 bytes each.
    one_view = 70 * SIDE * SIDE
    grown = f"{growth / 2**20:.1f} MiB more than after {WARM} frames"
    assert growth < 0.2 * one_view * (FRAMES - WARM), grown

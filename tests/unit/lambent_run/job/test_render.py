"""The kinds render and batch of a run: pictures of bundles, resumed, split, and reported."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from lambent_core.errors import IncompleteError, Stopped, UsageError
from lambent_core.pictures import RenderQuality, RenderSpec
from lambent_proto.v1 import render_pb2, worker_pb2
from lambent_relight import cameras_json, turntable, write_environment
from lambent_relight.batch.manifest import Cameras, Files
from lambent_relight.batch.plan import make_plan
from lambent_run.job import render as render_job
from lambent_run.job.order import Order
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere
from support.recording_reporter import RecordingReporter

ASSET = {
    "name": "ball",
    "bundle_id": "bundle_1",
    "material": {"albedo_gain": [1, 1, 1], "roughness_scale": 1},
}
LIGHT = {"name": "sky", "environment_id": "env_1", "axes": "blender"}
QUALITY = {
    "name": "quick",
    "quality": "refined",
    "spp": 2,
    "antialias": 1,
    "indirect": True,
    "background": "transparent",
}


@pytest.fixture
def inputs(tmp_path):
    """Return the folder of what a run was given: one bundle and one map."""
    folder = tmp_path / "inputs"
    (folder / "bundles").mkdir(parents=True)
    write_analytic_bundle(folder / "bundles" / "bundle_1", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))
    write_environment(folder / "environments" / "env_1.exr", np.ones((4, 8, 3), np.float32))
    return folder


def spec(**changes):
    """Return an order of three small pictures."""
    document = {
        "name": "spring",
        "assets": [ASSET],
        "environments": [LIGHT],
        "cameras": [{"turntable": 3, "size": 8}],
        "qualities": [QUALITY],
        "output": {"files": ["png", "exr"], "passes": ["normal"], "half": True},
    }
    return RenderSpec.model_validate({**document, **changes}).model_dump_json()


def order_of(inputs, run_dir, reporter, order=None, shard=0, num_shards=1):
    """Return what a run is given."""
    run_dir.mkdir(parents=True, exist_ok=True)
    return Order(
        start=worker_pb2.StartResponse(
            kind="batch",
            device="cpu",
            render=render_pb2.RenderTask(spec=order or spec(), shard=shard, num_shards=num_shards),
        ),
        scene_dir=inputs,
        run_dir=run_dir,
        reporter=reporter,
    )


def artifacts(reporter):
    return {fields["name"]: fields["path"] for fields in reporter.named("artifact")}


def test_an_order_becomes_the_manifest_that_it_means(inputs):
    cameras = [
        {"name": "low", "turntable": 2, "elevation_deg": 0.0, "size": 8},
        {"views": ["turntable_001"]},
        {"all_views": True},
        {"poses": json.loads(cameras_json(turntable(1, radius=3.0, width=4, height=4)))["cameras"]},
    ]
    material = {"albedo_gain": [1, 2, 1], "albedo": [0, 0, 0], "roughness_scale": 0}
    found = render_job.manifest_of(
        spec(
            cameras=cameras,
            assets=[{**ASSET, "material": material}],
            output={"files": ["exr"], "passes": ["normal"], "half": False, "path": "{camera}"},
        ),
        inputs,
    )
    low, named, every, given = found.cameras
    assert low == Cameras(name="low", turntable=2, elevation_deg=0.0, size=8)
    assert named == Cameras(views=["turntable_001"])
    assert every == Cameras(all_views=True)
    assert given.poses[0].width == 4
    (asset,) = found.assets
    assert asset.bundle == inputs / "bundles" / "bundle_1"
    assert asset.edit.albedo == (0.0, 0.0, 0.0), "black is a colour, not none"
    assert asset.edit.roughness_scale == 0.0
    assert found.environments[0].map == inputs / "environments" / "env_1.exr"
    assert found.qualities == [RenderQuality(name="quick", spp=2, antialias=1)]
    assert found.files == Files(files=["exr"], passes=["normal"], half=False, path="{camera}")


def test_pictures_table_sheet_and_records_are_artifacts(inputs, tmp_path):
    reporter = RecordingReporter()
    assert render_job.render_pictures(order_of(inputs, tmp_path / "run", reporter)) is None
    found = artifacts(reporter)
    assert set(found) == {
        *(f"ball/sky/quick/turntable_00{n}.{suffix}" for n in range(3) for suffix in ("png", "exr")),
        "pictures.csv",
        "pictures.jsonl",
        "contact_sheet.png",
    }
    with Image.open(found["ball/sky/quick/turntable_001.png"]) as image:
        assert image.size == (8, 8)
    last = reporter.named("progress")[-1]
    assert (last["stage"], last["step"], last["num_steps"], last["fraction"]) == ("render", 3, 3, 1.0)
    assert [fields["name"] for fields in reporter.named("preview")][-1] == "ball/sky/quick/turntable_002"
    assert not reporter.named("finding")


def test_what_sums_up_the_parts_makes_the_table_and_sheet_of_one_run(inputs, tmp_path):
    """Whatever number of parts: pixels and lines are those of the same order in one piece."""
    (inputs / "environments" / "env_2.exr").write_bytes(b"no picture")
    order = spec(environments=[LIGHT, {**LIGHT, "name": "bad", "environment_id": "env_2"}])
    alone = RecordingReporter()
    render_job.render_pictures(order_of(inputs, tmp_path / "alone", alone, order))
    failures = []
    for shard in range(2):
        part = RecordingReporter()
        given = order_of(inputs, tmp_path / f"part-{shard}", part, order, shard, 2)
        if shard == 0:
            render_job.render_pictures(given)
        else:
            with pytest.raises(UsageError, match=r"render\.all_failed"):
                render_job.render_pictures(given)
        found = artifacts(part)
        assert not {"contact_sheet.png", "pictures.csv"} & set(found), "a part makes no summary"
        for name in {"pictures.jsonl", "tiles.zip"} & set(found):
            target = tmp_path / "last" / "parts" / f"{shard:03d}" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(found[name].read_bytes())
        failures += [
            render_pb2.RenderFailure(path=each["subject"], code=each["code"], message=each["message"])
            for each in part.named("finding")
        ]
    shutil.copytree(inputs / "environments", tmp_path / "last" / "environments")
    whole = RecordingReporter()
    last = order_of(tmp_path / "last", tmp_path / "run", whole, order, 2, 2)
    last.start.render.failures.extend(failures)
    with pytest.raises(IncompleteError, match=r"render\.parts_failed: 1 of 2 parts"):
        render_job.render_pictures(last)
    one, several = artifacts(alone), artifacts(whole)
    assert set(several) == {"contact_sheet.png", "pictures.csv"}
    assert several["contact_sheet.png"].read_bytes() == one["contact_sheet.png"].read_bytes()
    assert _lines(several["pictures.csv"]) == _lines(one["pictures.csv"])
    assert len(_lines(one["pictures.csv"])) == 6


def _lines(path):
    """Return the lines of a table without what differs between two runs of the same."""
    with path.open(newline="") as file:
        return [{**line, "seconds": ""} for line in csv.DictReader(file)]


@pytest.mark.parametrize("num_shards", [1, 2, 3])
def test_parts_are_the_whole_without_overlap(inputs, num_shards):
    plan = make_plan(render_job.manifest_of(spec(), inputs))
    parts = [render_job.part_of(plan, shard, num_shards) for shard in range(num_shards)]
    assert [row.path for part in parts for row in part.rows] == [row.path for row in plan.rows]
    assert max(len(part.rows) for part in parts) - min(len(part.rows) for part in parts) <= 1


def test_what_fails_is_a_finding_and_stops_no_other(inputs, tmp_path):
    (inputs / "environments" / "env_2.exr").write_bytes(b"no picture")
    order = spec(environments=[LIGHT, {**LIGHT, "name": "bad", "environment_id": "env_2"}])
    reporter = RecordingReporter()
    render_job.render_pictures(order_of(inputs, tmp_path / "run", reporter, order))
    assert [fields["subject"] for fields in reporter.named("finding")] == [
        f"ball/bad/quick/turntable_00{n}" for n in range(3)
    ]
    assert "ball/sky/quick/turntable_000.png" in artifacts(reporter)


def test_an_order_of_which_nothing_can_be_made_fails(inputs, tmp_path):
    (inputs / "environments" / "env_1.exr").write_bytes(b"no picture")
    with pytest.raises(UsageError, match=r"render\.all_failed"):
        render_job.render_pictures(order_of(inputs, tmp_path / "run", RecordingReporter()))


def test_what_sums_up_parts_that_have_all_failed_fails_as_they_did(inputs, tmp_path):
    reporter = RecordingReporter()
    last = order_of(inputs, tmp_path / "run", reporter, spec(), 2, 2)
    for shard in range(2):
        last.start.render.failures.add(path=f"job_{shard}/*", code="environment.x", message="broken")
    with pytest.raises(UsageError, match=r"render\.all_failed: .*environment\.x: broken"):
        render_job.render_pictures(last)
    assert not artifacts(reporter), "a table and a sheet of nothing are not made"


def test_inputs_in_a_relative_folder_are_found(inputs, tmp_path, monkeypatch):
    """A path in a manifest would be relative to the inputs themselves."""
    monkeypatch.chdir(tmp_path)
    reporter = RecordingReporter()
    render_job.render_pictures(order_of(Path("inputs"), Path("run"), reporter))
    assert "ball/sky/quick/turntable_000.png" in artifacts(reporter)
    assert not reporter.named("finding")


def test_an_order_that_no_manifest_may_hold_fails(inputs, tmp_path):
    order = spec().replace('"spp":2', '"spp":1')
    with pytest.raises(UsageError, match=r"render\.spec_invalid"):
        render_job.render_pictures(order_of(inputs, tmp_path / "run", RecordingReporter(), order))


def test_a_stopped_run_goes_on_from_its_checkpoints(inputs, tmp_path, monkeypatch):
    """The next run gets the files of the checkpoints, as the server sends them, and nothing else."""
    monkeypatch.setattr(render_job, "CHECKPOINT_S", 0.0)
    calls = []
    make = render_job.run_batch.__globals__["run_tasks"].__globals__["Studio"].make

    def counted(self, row, suffixes, progress=None):
        calls.append(row.path)
        return make(self, row, suffixes, progress)

    monkeypatch.setattr("lambent_relight.batch.studio.Studio.make", counted)
    first = RecordingReporter()
    first.should_stop = lambda: len(first.named("checkpoint")) >= 2
    with pytest.raises(Stopped):
        render_job.render_pictures(order_of(inputs, tmp_path / "one", first))
    saved = first.named("checkpoint")
    assert len({fields["stage"] for fields in saved}) == len(saved) == 2
    assert not artifacts(first)
    for fields in saved:
        shutil.copytree(fields["folder"], tmp_path / "two" / fields["folder"].relative_to(tmp_path / "one"))
    before = len(calls)
    second = RecordingReporter()
    render_job.render_pictures(order_of(inputs, tmp_path / "two", second))
    assert len(calls) - before == 1, "two of three were there"
    assert len([name for name in artifacts(second) if name.endswith(".exr")]) == 3
    assert [fields["stage"] for fields in second.named("checkpoint")] == ["render-000003"]

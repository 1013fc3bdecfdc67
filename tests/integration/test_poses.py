"""Cameras are found for photographs whose cameras are known, up to a similarity."""

import json

import numpy as np
import pytest
import typer
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.poses.capture import solve_capture
from lambent_core.errors import SceneRefusedError
from lambent_core.messages import read_message
from lambent_proto.v1 import scene_pb2
from lambent_run.commands import poses as poses_cli
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.spec import RunSpec
from PIL import Image
from support.recording_reporter import RecordingReporter
from support.textured_box import box_cameras, write_photographs
from typer.testing import CliRunner

from benchmarks.pose_errors import pose_errors

pytestmark = pytest.mark.slow

COUNT = 10


def call(command, *arguments):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(command)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def poses_of(scene):
    """Return camera to world by photograph."""
    return {
        frame.name: np.array(frame.camera.camera_to_world).reshape(4, 4)
        for frame in describe_scene(scene).frames
    }


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Return the folder of a solved capture, with masks, and the true poses."""
    folder = tmp_path_factory.mktemp("poses")
    cameras = box_cameras(COUNT, arc_deg=150.0)
    true = write_photographs(folder / "photographs", cameras, masks=folder / "cut")
    result = call(poses_cli.poses, folder / "photographs", "-o", folder / "scene", "--masks", folder / "cut")
    assert result.exit_code == 0, result.output
    assert f"cameras for {COUNT} of {COUNT} photographs" in result.stdout
    return folder, true


def test_cameras_are_where_they_were_up_to_a_similarity(solved):
    folder, true = solved
    manifest = describe_scene(folder / "scene")
    assert manifest.layout == "colmap"
    found = {frame.images[0].path.removeprefix("images/"): frame for frame in manifest.frames}
    poses = [np.array(found[name].camera.camera_to_world).reshape(4, 4) for name in true]
    rotation_deg, centre_share = pose_errors(np.array(poses), np.array(list(true.values())))
    assert "scene.poses_lens" not in (folder / "scene" / "poses.json").read_text()
    assert rotation_deg.max() < 0.5
    assert centre_share.max() < 0.01
    focal = manifest.frames[0].camera.focal_x
    assert focal == pytest.approx(400.0, rel=0.05)


def test_a_run_finds_the_same_cameras_and_leaves_the_photographs_where_they_are(solved, tmp_path):
    folder, _ = solved
    run, reporter = tmp_path / "run", RecordingReporter()
    spec = RunSpec.from_options(folder / "photographs", preset="tiny", masks=folder / "cut")
    run_pipeline(spec, run, "cpu", reporter, ("cameras", "ingest"))
    told = {call["code"]: call["message"] for call in reporter.named("finding")}
    assert told["scene.poses_solved"].startswith(f"cameras for {COUNT} of {COUNT} photographs")
    assert sorted(path.name for path in (run / "cameras").iterdir()) == ["cameras.json", "sparse"]
    manifest = read_message(run / "scene" / "manifest.json", scene_pb2.SceneManifest())
    assert manifest.layout == "photographs"
    assert all((folder / "photographs" / frame.images[0].path).is_file() for frame in manifest.frames)
    first = poses_of(folder / "scene")
    second = {frame.name: np.array(frame.camera.camera_to_world).reshape(4, 4) for frame in manifest.frames}
    assert first.keys() == second.keys()
    # Photographs fix a world up to a similarity, and COLMAP's own order of sums differs from run to run.
    found = np.array([second[name] for name in first])
    rotation_deg, centre_share = pose_errors(found, np.array(list(first.values())))
    assert rotation_deg.max() < 0.5
    assert centre_share.max() < 0.01


def test_masks_travel_with_the_capture(solved):
    folder, _ = solved
    manifest = describe_scene(folder / "scene")
    assert all(frame.mask.startswith("masks/") for frame in manifest.frames)
    first = folder / "scene" / "masks" / "photo_03.png.png"
    with Image.open(first) as mine, Image.open(folder / "cut" / "photo_03.png") as given:
        assert np.array_equal(np.asarray(mine), np.asarray(given))


def test_what_was_solved_is_not_solved_again(solved):
    folder, _ = solved
    model = folder / "scene" / "sparse" / "0" / "images.bin"
    before = model.stat().st_mtime_ns
    again = solve_capture(folder / "photographs", folder / "scene", folder / "cut")
    assert model.stat().st_mtime_ns == before
    assert again["registered"] == COUNT


def test_the_gap_behind_the_object_is_named(solved):
    folder, _ = solved
    record = json.loads((folder / "scene" / "poses.json").read_text())
    (finding,) = record["findings"]
    assert finding["code"] == "scene.poses_gap"
    assert "photo_09.png" in finding["message"]
    assert "photo_00.png" in finding["message"]


def test_photographs_without_texture_are_refused_with_what_to_do(tmp_path):
    for number in range(4):
        (tmp_path / "photographs").mkdir(exist_ok=True)
        Image.new("RGB", (160, 120), (90 + number, 90, 90)).save(tmp_path / "photographs" / f"{number}.png")
    with pytest.raises(SceneRefusedError, match=r"scene\.poses_none: .*too few points.*printed paper"):
        solve_capture(tmp_path / "photographs", tmp_path / "scene")
    assert not (tmp_path / "scene").exists()

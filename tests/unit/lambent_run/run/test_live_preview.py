"""Previews of a training: where their camera stands, how often they come, and that they change nothing."""

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.presets import tiny
from flashcache.training.stage_one import StageOne
from lambent_core.scene import View
from lambent_relight.cameras import look_at
from lambent_run.run.live_preview import (
    INTERVAL_S,
    LONGEST_S,
    SIDES,
    STEP_DEG,
    LivePreview,
    Orbit,
    photographed_arc,
    seen_middle,
)
from lambent_run.run.tasks.training import drive, new_model, previews_for
from PIL import Image
from support.lit_sphere import lit_sphere
from support.recording_reporter import RecordingReporter
from support.task_context import task_context

SCENE = lit_sphere(num_views=3)


class Clock:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.at = 100.0

    def __call__(self) -> float:
        return self.at


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch):
    """Return a clock, and a preview whose pictures take `cost` seconds for each of a thousand pixels."""
    clock = Clock()
    preview = LivePreview(orbit=Orbit.around(SCENE), reporter=RecordingReporter(), task="cache", clock=clock)

    def picture(model: float, camera):
        clock.at += model * camera.width**2 / 1000.0
        return np.zeros((camera.height, camera.width, 3))

    monkeypatch.setattr("lambent_run.run.live_preview.turned_picture", picture)
    return clock, preview


@pytest.mark.parametrize("cost", [1e-4, 0.01, 0.05, 0.3])
def test_previews_come_often_and_take_their_share_of_the_time_at_most(slow, cost):
    clock, preview = slow
    began, times = clock.at, []
    while clock.at < began + 3000.0:
        before = preview.number
        preview.show(cost)
        if preview.number > before:
            times.append(clock.at)
        clock.at += 0.5
    assert np.diff(times).max() <= 30.0
    assert preview.seconds / (clock.at - began) < 0.05
    assert SIDES[0] <= preview.side <= SIDES[1]
    # A machine that could do more makes larger ones, not more of them.
    assert len(times) <= 3000.0 / INTERVAL_S + 1
    if cost < 0.01:
        assert preview.side == SIDES[1]


def test_the_camera_goes_once_around_where_photographs_do():
    orbit = Orbit.around(SCENE)
    everywhere = replace(orbit, arc_deg=None)
    azimuths = [everywhere.azimuth_deg(number) for number in range(25)]
    assert np.diff(azimuths) == pytest.approx(STEP_DEG)
    camera = everywhere.camera(6, 32)
    offset = camera.position - np.array(orbit.target)
    assert np.linalg.norm(offset) == pytest.approx(orbit.distance)
    assert np.degrees(np.arctan2(offset[1], offset[0])) == pytest.approx(90.0)
    assert -camera.camera_to_world[:3, 2] @ offset == pytest.approx(-orbit.distance)


def cut(view: View, left: float, top: float, width: int, height: int) -> View:
    """Return the view with the camera of this part of its frame, pixels; its pictures stay whole."""
    camera = view.camera
    moved = {"centre_x": camera.centre_x - left, "centre_y": camera.centre_y - top}
    return replace(view, camera=replace(camera, width=width, height=height, **moved))


def test_the_camera_looks_where_the_middle_of_the_photographs_is():
    box = np.array(SCENE.bounds_min), np.array(SCENE.bounds_max)
    assert Orbit.around(SCENE).target == pytest.approx((box[0] + box[1]) / 2.0, abs=1e-6)
    # Each frame is cut around a point below the middle of the box, as it would be around an object there.
    point = np.array([0.1, -0.2, -0.4])
    views = []
    for view in SCENE.train:
        camera = view.camera
        local = camera.camera_to_world[:3, :3].T @ (point - camera.position)
        column = camera.centre_x + camera.focal_x * local[0] / -local[2]
        row = camera.centre_y - camera.focal_y * local[1] / -local[2]
        views.append(cut(view, column - 5, row - 4, 10, 8))
    assert Orbit.around(replace(SCENE, train=tuple(views))).target == pytest.approx(point, abs=1e-6)


def test_where_photographs_do_not_say_how_far_they_look_it_is_the_middle_of_the_box():
    box = np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 3.0])
    camera = SCENE.train[0].camera

    def looking(position, target):
        return replace(camera, camera_to_world=look_at(list(position), target))

    assert seen_middle([looking((0.5, -4.0, 1.5), (0.5, 0.0, 1.5))], *box) == pytest.approx([0.0, 0.0, 1.0])
    outside = [looking((9.0, -4.0, 1.0), (9.0, 0.0, 1.0)), looking((4.0, 0.0, 1.0), (9.0, 0.0, 1.0))]
    assert seen_middle(outside, *box) == pytest.approx([1.0, 0.0, 1.0])


def test_the_camera_swings_where_a_side_was_not_photographed():
    arc = photographed_arc(np.array([350.0, 20.0, 80.0, -30.0]))
    assert arc == pytest.approx((330.0, 440.0))
    orbit = replace(Orbit.around(SCENE), arc_deg=arc)
    azimuths = [orbit.azimuth_deg(number) for number in range(30)]
    assert min(azimuths) == pytest.approx(330.0)
    assert max(azimuths) == pytest.approx(440.0)
    assert np.abs(np.diff(azimuths)).max() < 1.1 * STEP_DEG
    assert azimuths[0] == azimuths[14]
    assert photographed_arc(np.arange(0.0, 360.0, 30.0)) is None
    assert photographed_arc(np.array([10.0])) == (10.0, 10.0)


def trained(tmp_path, *, shown: bool) -> tuple[StageOne, RecordingReporter]:
    one = replace(tiny().stage_one, num_steps=4, num_rays=32, warmup_steps=0)
    context = task_context(tmp_path / f"{shown}", replace(tiny(), stage_one=one), "cache")
    pixels = TrainingPixels(SCENE, context.spec.config.pixels, torch.device("cpu"))
    stage = StageOne(new_model(context, SCENE), pixels, one, seed=0)
    preview = previews_for(context, SCENE)
    if shown:
        # Due after every step.
        preview.clock = lambda: next(ticks) * (LONGEST_S + 1.0)
    ticks = iter(range(1000))
    drive(context, stage, preview if shown else None)
    return stage, context.reporter


def test_a_run_is_the_same_with_previews_and_without(tmp_path):
    with_them, told = trained(tmp_path, shown=True)
    without, silent = trained(tmp_path, shown=False)
    assert len(told.named("preview")) == 4
    assert not silent.named("preview")
    for ours, theirs in zip(
        with_them.model.state_dict().values(), without.model.state_dict().values(), strict=True
    ):
        assert torch.equal(ours, theirs)


def test_a_preview_is_a_small_picture_named_like_its_stage(tmp_path):
    _, told = trained(tmp_path, shown=True)
    shown = told.named("preview")[0]
    assert shown["name"] == "turning_cache"
    with Image.open(io.BytesIO(shown["png"])) as image:
        assert image.format == "PNG"
        assert image.size[0] == image.size[1] <= SIDES[1]
    (made,) = told.named("previews.made")
    assert made["number"] == 4


def test_a_preview_that_cannot_be_made_does_not_end_the_training(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        raise MemoryError("no room for a picture")

    monkeypatch.setattr("lambent_run.run.live_preview.LivePreview.show", fail)
    stage, told = trained(tmp_path, shown=True)
    assert stage.finished
    # It is logged once, and not tried again.
    (failed,) = told.named("previews.failed")
    assert "no room" in failed["reason"]

"""The built-in masks before backgrounds whose truth is known; and when they are not believed."""

from pathlib import Path

import numpy as np
import pytest
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.estimate import EstimateSettings, estimate_masks
from lambent_core.errors import SceneRefusedError
from support.ball_views import ball_hits, ball_views

from benchmarks.painted_scene import overlap, paint, plain, surroundings

SETTINGS = EstimateSettings()


SAMPLE = Path(__file__).parents[3] / "data" / "still_life"


def overlaps(background) -> np.ndarray:
    painted = paint(SAMPLE, background, every=3)
    found = estimate_masks(painted.views, SETTINGS)
    assert np.median(found.separation) > 0.95
    return np.array(
        [overlap(mine, true) for mine, true in zip(found.coverages, painted.coverages, strict=True)]
    )


@pytest.mark.slow
@pytest.mark.parametrize("colour", [(0.9, 0.9, 0.9), (0.05, 0.4, 0.1), (0.02, 0.02, 0.03)])
def test_the_object_is_found_before_a_plain_background(colour):
    found = overlaps(plain(*colour))
    assert found.mean() >= 0.95
    assert found.min() >= 0.85


@pytest.mark.slow
def test_the_object_is_found_before_far_surroundings():
    found = overlaps(surroundings(SAMPLE / "envmaps" / "morning.hdr"))
    assert found.mean() >= 0.93
    assert np.median(found) >= 0.95


def ball_pictures(background: np.ndarray | None, count: int = 12) -> tuple[list[MaskView], list[np.ndarray]]:
    """Return pictures of a checkered ball before a colour, or before noise."""
    views, masks = [], []
    generator = np.random.default_rng(0)
    for number, silhouette in enumerate(ball_views(count)):
        hit, points = ball_hits(silhouette.camera, np.zeros(3), 0.6)
        checks = np.sign(np.sin(9.0 * points)).prod(axis=-1)[..., None] > 0.0
        ball = np.where(checks, [200, 60, 40], [240, 220, 180])
        around = generator.integers(0, 256, ball.shape) if background is None else background
        noisy = np.where(hit[..., None], ball, around) + generator.normal(size=ball.shape)
        views.append(MaskView(f"v{number}", np.clip(noisy, 0, 255).astype(np.uint8), silhouette.camera))
        masks.append(hit)
    return views, masks


def test_a_ball_before_grey_is_found_almost_exactly():
    views, masks = ball_pictures(np.array([120, 125, 130]))
    found = estimate_masks(views, SETTINGS)
    assert min(overlap(mine, true) for mine, true in zip(found.coverages, masks, strict=True)) > 0.93
    assert all(mine.shape == true.shape for mine, true in zip(found.coverages, masks, strict=True))


def refusal(views) -> str:
    with pytest.raises(SceneRefusedError) as caught:
        estimate_masks(views, SETTINGS)
    (finding,) = caught.value.report.findings
    assert finding.code == "scene.mask_missing"
    return finding.message


def test_pictures_of_nothing_are_refused():
    views, _ = ball_pictures(np.array([120, 125, 130]))
    empty = [MaskView(view.name, np.full_like(view.image_srgb, 128), view.camera) for view in views]
    assert "--masks" in refusal(empty)


def test_pictures_of_something_else_in_each_view_are_refused():
    generator = np.random.default_rng(1)
    views, _ = ball_pictures(None)
    noise = [
        MaskView(view.name, generator.integers(0, 256, view.image_srgb.shape, dtype=np.uint8), view.camera)
        for view in views
    ]
    refusal(noise)


def test_an_object_that_is_not_where_the_cameras_say_is_refused():
    views, _ = ball_pictures(np.array([120, 125, 130]))
    shifted = [
        MaskView(view.name, np.roll(view.image_srgb, ((-1) ** number * 16, 14), axis=(0, 1)), view.camera)
        for number, view in enumerate(views)
    ]
    refusal(shifted)


def test_a_few_views_are_not_enough_to_tell():
    views, _ = ball_pictures(np.array([120, 125, 130]))
    assert "7 views are too few" in refusal(views[:7])

"""Pictures of an untrained model: frames, determinism and what an empty ray shows."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.evaluation.views import PictureSamples, render_gbuffer, render_physical, render_relit
from flashcache.physical.model import Domain, InverseModel
from flashcache.presets import tiny
from support.lit_sphere import camera, lit_sphere

SCENE = lit_sphere()
CAMERA = camera(0.4, 0.3, side=12)
SKY = np.ones((8, 16, 3), np.float32)


@pytest.fixture(scope="module")
def model() -> InverseModel:
    torch.manual_seed(0)
    domain = Domain(
        bounds_min=SCENE.bounds_min,
        bounds_max=SCENE.bounds_max,
        primary=SCENE.primary,
        secondary=SCENE.secondary,
        contraction_radius=SCENE.contraction_radius,
        lights=SCENE.lights,
    )
    return InverseModel(tiny().model, domain).requires_grad_(False)


def test_the_gbuffer_is_deterministic_and_in_range(model: InverseModel):
    first, second = render_gbuffer(model, CAMERA), render_gbuffer(model, CAMERA)
    assert np.array_equal(first.albedo, second.albedo)
    assert first.opacity.shape == (12, 12, 1)
    assert first.opacity.min() >= 0.0
    assert first.opacity.max() <= 1.0
    np.testing.assert_allclose(np.linalg.norm(first.normal, axis=-1), 1.0, atol=1e-5)
    hit = first.opacity[..., 0] > 0.01
    assert (first.distance[hit] > SCENE.primary[0]).all()
    assert (first.distance[hit] < SCENE.primary[1]).all()


def test_rays_that_miss_the_scenes_box_are_empty_and_face_up(model: InverseModel):
    away = replace(CAMERA, camera_to_world=CAMERA.camera_to_world @ np.diag([1.0, -1.0, -1.0, 1.0]))
    found = render_gbuffer(model, away)
    assert not found.opacity.any()
    assert not render_physical(model, away, PictureSamples(num_directions=8)).rgb.any()
    assert (found.normal == [0.0, 0.0, 1.0]).all()


def test_a_seed_repeats_a_picture_and_another_one_does_not(model: InverseModel):
    samples = PictureSamples(num_directions=8)
    pictures = [render_physical(model, CAMERA, samples, seed=seed).rgb for seed in (0, 0, 1)]
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_repeats_lower_the_standard_error_as_their_root(model: InverseModel):
    """In the mean of its square, over several seeds: that of two repeats alone differs by a third."""

    def squared(num_repeats: int, seed: int) -> float:
        samples = PictureSamples(num_directions=8, num_repeats=num_repeats)
        found = render_physical(model, CAMERA, samples, seed=seed)
        return float((found.standard_error**2).mean())

    few = np.mean([squared(2, seed) for seed in range(12)])
    assert squared(18, 0) == pytest.approx(few / 9.0, rel=0.2)


def test_relit_pictures_are_proportional_to_the_light(model: InverseModel):
    samples = PictureSamples(num_directions=8)
    dim, bright = (render_relit(model, CAMERA, level * SKY, samples).rgb for level in (1.0, 2.0))
    np.testing.assert_allclose(bright, 2.0 * dim, rtol=1e-3, atol=1e-5)

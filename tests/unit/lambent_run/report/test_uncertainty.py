"""The measured uncertainty is finite, repeatable, largest where no photograph looks, kept with its run."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.evaluation.ambiguity import Priors
from flashcache.evaluation.monte_carlo import RenderRule
from flashcache.evaluation.radiance_derivatives import Noise
from flashcache.evaluation.surface_points import SurfacePoints
from flashcache.polish.confidence import FILE, Confidence
from flashcache.presets import tiny
from lambent_relight.bundle.uncertainty import CHANNELS
from lambent_run.report.uncertainty import (
    MeasuredPoints,
    grid_of,
    measure_points,
    measure_uncertainty,
    residual,
    uncertainty_map,
    with_confidence,
)
from lambent_run.run.folder import finish_task, task_folder
from lambent_run.run.uncertainty import keep_uncertainty, kept_uncertainty, polished_confidence
from support.lit_sphere import camera, lit_sphere
from support.sphere_model import RADIUS, sphere_model
from support.task_context import task_context

# All cameras stand above the object.
ABOVE = replace(
    lit_sphere(8, side=16),
    train=tuple(
        replace(view, camera=camera(0.8 * number, 0.9, side=16))
        for number, view in enumerate(lit_sphere(8, side=16).train)
    ),
)
RULE = RenderRule()


def measured(model, normal: torch.Tensor, level: float, rule: RenderRule = RULE) -> np.ndarray:
    """Return what photographs with this noise leave open where the ball has these normals."""
    points = SurfacePoints(RADIUS * normal, normal)
    noise = Noise(absolute=level)
    return measure_points(model, points, ABOVE, noise=noise, rule=rule, priors=Priors(), seed=0).values


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=("sky",)).requires_grad_(False)


@pytest.fixture(scope="module")
def grid(model):
    found = measure_uncertainty(model, ABOVE, seed=0, rule=RULE, num_points=120)
    assert found is not None
    return found


def test_values_are_finite_and_no_larger_than_the_priors(grid):
    assert np.isfinite(grid.values).all()
    priors = Priors()
    for name, bound in (
        ("metalness", priors.metalness),
        ("perceptual_roughness", priors.perceptual_roughness),
    ):
        values = grid.values[..., CHANNELS.index(name)]
        assert values.min() > 0.0
        assert values.max() <= bound * 1.001
    assert (grid.values[..., 0] >= grid.values[..., 1]).all()


def test_the_same_seed_measures_the_same(model, grid):
    again = measure_uncertainty(model, ABOVE, seed=0, rule=RULE, num_points=120)
    assert again is not None
    np.testing.assert_array_equal(again.values, grid.values)


def test_what_no_photograph_shows_is_as_uncertain_as_before(model):
    normal = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    priors = Priors()
    found = measured(model, normal, 0.01, RenderRule(shadows="nerf"))
    top, bottom = (dict(zip(CHANNELS, row, strict=True)) for row in found)
    assert top["views"] > 1.0
    assert bottom["views"] == 0.0
    assert bottom["albedo"] == pytest.approx(priors.log_albedo)
    assert bottom["metalness"] == pytest.approx(priors.metalness)
    assert top["albedo"] < 0.7 * bottom["albedo"]


def test_noisier_photographs_leave_more_open(model):
    normal = torch.randn(8, 3, generator=torch.Generator().manual_seed(1))
    normal = torch.nn.functional.normalize(normal.abs(), dim=-1)
    assert (measured(model, normal, 0.1)[:, 0] > measured(model, normal, 0.01)[:, 0]).all()


def test_a_model_without_a_fast_cache_is_asked_through_the_nerf_cache(model, monkeypatch):
    monkeypatch.setattr(type(model), "fast_source", lambda self: pytest.fail("asked the fast cache"))
    rule = RenderRule(control_variate="off")
    assert measure_uncertainty(model, ABOVE, seed=0, rule=rule, num_points=20) is not None


def test_a_model_without_a_surface_has_no_uncertainty(monkeypatch):
    empty = sphere_model(lights=("sky",)).requires_grad_(False)
    for field in (empty.nerf.density, *empty.nerf.proposals):
        field.head.bias.fill_(-100.0)
    assert measure_uncertainty(empty, ABOVE, seed=0, rule=RULE, num_points=40) is None


def test_the_noise_of_photographs_is_at_least_a_step_of_eight_bits(model):
    assert residual(model, ABOVE, seed=0) >= 1.0 / 255.0


def test_photographs_of_nothing_are_not_trusted(model):
    blank = tuple(replace(view, images={"sky": np.zeros((16, 16, 4), np.float32)}) for view in ABOVE.train)
    assert residual(model, replace(ABOVE, train=blank), seed=0) == 1.0


def test_without_training_photographs_there_is_nothing_to_measure(model):
    assert measure_uncertainty(model, replace(ABOVE, train=()), seed=0, rule=RULE) is None


def test_a_grid_passes_through_its_points():
    generator = np.random.default_rng(0)
    positions = generator.uniform(-1.0, 1.0, (300, 3)).astype(np.float32)
    values = np.repeat((positions @ [1.0, 0.5, -0.5])[:, None], len(CHANNELS), axis=1).astype(np.float32)
    found = grid_of(MeasuredPoints(positions, values))
    error = np.abs(found.at(positions) - values)
    assert max(found.values.shape[:3]) == 40
    assert error.mean() < 0.05
    assert found.values.min() >= values.min()
    assert found.values.max() <= values.max()


def test_a_flat_object_gets_a_flat_grid():
    positions = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3)).astype(np.float32)
    positions[:, 2] = 0.0
    found = grid_of(MeasuredPoints(positions, np.ones((50, len(CHANNELS)), np.float32)))
    assert found.values.shape[2] <= 3
    np.testing.assert_allclose(found.values, 1.0, rtol=1e-5)


def test_a_map_looks_up_the_surface_that_pixels_show(model, grid):
    view = ABOVE.train[0].camera
    eye = view.position
    distance = np.zeros((16, 16, 1))
    distance[8, 8] = np.linalg.norm(eye) - RADIUS
    found = uncertainty_map(model, grid, view, distance)
    assert found.shape == (16, 16, len(CHANNELS))
    seen = found[8, 8]
    np.testing.assert_allclose(seen, grid.at(RADIUS * eye / np.linalg.norm(eye)), rtol=0.2)
    found[8, 8] = 0.0
    assert not found.any()


def test_a_run_keeps_what_was_measured_until_it_is_trained_again(tmp_path, grid):
    (tmp_path / "evaluation").mkdir()
    (tmp_path / "tasks").mkdir()
    finish_task(tmp_path, "joint", "one")
    assert kept_uncertainty(tmp_path) is None
    keep_uncertainty(tmp_path, grid)
    found = kept_uncertainty(tmp_path)
    assert found is not None
    np.testing.assert_array_equal(found.values, grid.values)
    finish_task(tmp_path, "joint", "two")
    assert kept_uncertainty(tmp_path) is None


def polished(places: list[list[float]]) -> Confidence:
    count = len(places)
    return Confidence(
        torch.tensor(places),
        0.1,
        torch.tensor([[0.1, 0.2, 0.2]]).repeat(count, 1),
        torch.full((count,), 0.05),
        torch.full((count,), 0.02),
    )


def test_elements_of_a_polish_take_the_place_of_points_near_them():
    places = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]], np.float32)
    points = MeasuredPoints(
        places, np.array([[0.5, 0.4, 0.3, 0.3, 7.0], [1.0, 0.0, 0.3, 0.3, 0.0]], np.float32)
    )
    found = with_confidence(points, polished([[0.0, 0.0, 0.01]]))
    np.testing.assert_allclose(found.positions, [[0.0, 0.0, 0.01], [5.0, 0.0, 0.0]])
    # Root mean square of the channels, and what the unknown light adds.
    np.testing.assert_allclose(
        found.values, [[np.sqrt(0.03 + 0.16), 0.4, 0.02, 0.05, 7.0], points.values[1]], rtol=1e-3
    )


def test_the_map_of_a_polished_model_has_the_same_channels_and_what_it_says(model, grid):
    direction = torch.nn.functional.normalize(
        torch.randn(400, 3, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    whole = polished((RADIUS * direction).tolist())
    found = measure_uncertainty(model, ABOVE, seed=0, rule=RULE, num_points=120, confidence=whole)
    assert found.channels == grid.channels
    assert np.isfinite(found.values).all()
    above = RADIUS * direction[direction[:, 2] > 0.5].numpy()
    np.testing.assert_allclose(found.channel("perceptual_roughness", above), 0.05, rtol=0.05)
    assert (found.channel("albedo", above) >= found.channel("albedo_from_light", above)).all()


def test_confidence_is_used_where_a_finished_polish_has_left_it(tmp_path):
    on = task_context(tmp_path, replace(tiny(), polish="on"), "evaluate")
    folder = task_folder(on.run_dir, "polish")
    folder.mkdir(parents=True)
    (on.run_dir / "tasks").mkdir()
    polished([[0.0, 0.0, 0.0]]).save(folder / FILE)
    assert polished_confidence(on) is None
    finish_task(on.run_dir, "polish", "inputs")
    assert polished_confidence(on).size == 0.1
    off = replace(on, spec=replace(on.spec, config=tiny()))
    assert polished_confidence(off) is None
    (folder / FILE).unlink()
    assert polished_confidence(on) is None

"""The standard error of a picture is the spread that independent pictures really have."""

import numpy as np
import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.evaluation.monte_carlo import RenderRule, Spread, variance_of_mean
from flashcache.evaluation.views import PictureSamples, render_physical, render_relit
from support.lit_sphere import camera
from support.sphere_model import sphere_model
from support.statistics import assert_mean

CAMERA = camera(0.4, 0.3, side=6)
SKY = np.linspace(0.1, 3.0, 8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
MEANS = torch.tensor([0.0, 1.0, 2.0, 4.0])[:, None]
WIDTHS = torch.tensor([0.5, 1.0, 0.1, 2.0])[:, None]


@pytest.fixture(scope="module")
def model():
    return sphere_model().requires_grad_(False)


def estimated(means, repeats, *, num_pixels=20_000):
    """Return variances estimated from normal values whose strata have `means` and `WIDTHS`."""
    generator = torch.Generator().manual_seed(3)

    def values():
        return means + WIDTHS * torch.randn(num_pixels, 4, 3, generator=generator)

    spread = Spread(values())
    for _ in range(repeats - 1):
        spread.add(values())
    return variance_of_mean(spread), spread


@pytest.mark.parametrize("repeats", [2, 5])
def test_repeats_give_an_unbiased_variance_whatever_the_strata_are(repeats):
    variance, _ = estimated(MEANS, repeats)
    assert_mean(variance, float(WIDTHS.square().sum()) / (16 * repeats))


def test_one_repeat_gives_an_unbiased_variance_where_strata_agree():
    variance, _ = estimated(torch.zeros_like(MEANS), 1)
    assert_mean(variance, float(WIDTHS.square().sum()) / 16)


def test_one_repeat_gives_a_larger_variance_where_neighbouring_strata_differ():
    variance, _ = estimated(MEANS, 1)
    gap = 1.0**2 + 2.0**2
    assert_mean(variance, (float(WIDTHS.square().sum()) + gap) / 16)


@pytest.mark.parametrize("strata", [2, 3, 4, 5, 7])
def test_any_number_of_strata_can_be_compared(strata):
    values = torch.randn(20_000, strata, 1, generator=torch.Generator().manual_seed(strata))
    assert_mean(variance_of_mean(Spread(values.expand(-1, -1, 3))), 1.0 / strata)


def test_a_single_value_has_an_unknown_error():
    assert variance_of_mean(Spread(torch.ones(5, 1, 3))).isnan().all()


def test_running_moments_survive_a_large_mean():
    generator = torch.Generator().manual_seed(0)
    values = [3000.0 + torch.randn(2000, 1, 3, generator=generator) for _ in range(8)]
    spread = Spread(values[0])
    for more in values[1:]:
        spread.add(more)
    exact = torch.stack(values).double().var(dim=0)[:, 0] / 8
    np.testing.assert_allclose(variance_of_mean(spread), exact, rtol=0.01)


def pairs_of(render, count=40):
    """Return predicted and observed variances of pictures [count], each relative to their common mean.

    Half the squared difference of two independent pictures has exactly the variance as its mean.
    """
    predicted, observed = [], []
    for number in range(count):
        first, second = render(2 * number), render(2 * number + 1)
        seen = first.opacity[..., 0] > 0.5
        both = np.stack([first.standard_error[seen], second.standard_error[seen]])
        predicted.append(np.square(both, dtype=np.float64).mean())
        observed.append(0.5 * np.square(first.rgb[seen] - second.rgb[seen], dtype=np.float64).mean())
    level = np.mean(observed)
    return np.array(predicted) / level, np.array(observed) / level


def assert_not_less(predicted, observed, *, at_most=2.5):
    """Points of a picture avoid each other's directions, so its noise is below what independent ones have."""
    excess = predicted - observed
    assert excess.mean() > -4.0 * excess.std() / np.sqrt(len(excess))
    assert predicted.mean() < at_most * observed.mean()


@pytest.mark.slow
@pytest.mark.parametrize("rule", [RenderRule(), RenderRule(control_variate="off", sampler="none")])
def test_the_predicted_variance_of_a_physical_picture_is_not_less_than_the_observed_one(model, rule):
    assert_not_less(
        *pairs_of(
            lambda seed: render_physical(
                model, CAMERA, PictureSamples(num_directions=16, num_repeats=2), seed=seed, rule=rule
            )
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize(("shadows", "antialias"), [("fast", 1), ("nerf", 1), ("fast", 2)])
def test_the_predicted_variance_of_a_relit_picture_is_not_less_than_the_observed_one(
    model, shadows, antialias
):
    samples = PictureSamples(num_directions=16, num_repeats=2, antialias=antialias)
    rule = RenderRule(shadows=shadows)
    assert_not_less(
        *pairs_of(lambda seed: render_relit(model, CAMERA, SKY, samples, seed=seed, rule=rule)),
        at_most=4.0,
    )


@pytest.mark.slow
def test_one_repeat_does_not_promise_less_noise_than_there_is(model):
    predicted, observed = pairs_of(
        lambda seed: render_relit(model, CAMERA, SKY, PictureSamples(num_directions=16), seed=seed)
    )
    assert_not_less(predicted, observed, at_most=np.inf)


def test_a_picture_needs_a_repeat_and_a_point(model):
    with pytest.raises(ConfigError, match="at least one repeat"):
        render_physical(model, CAMERA, PictureSamples(num_repeats=0))


def test_a_model_without_a_trained_fast_cache_casts_shadows_with_the_nerf_cache():
    assert RenderRule(control_variate="off").shadow_cache == "nerf"
    assert RenderRule().shadow_cache == "fast"
    assert RenderRule(shadows="nerf").shadow_cache == "nerf"


def test_shading_at_one_depth_uses_the_same_point_every_time(model, monkeypatch):
    from flashcache.evaluation import monte_carlo

    seen = []
    monkeypatch.setattr(
        monte_carlo, "draw_points", lambda *_: pytest.fail("drew a point although the depth was asked for")
    )

    def shade(points, _generator):
        seen.append(points.positions)
        return points.positions

    picture = monte_carlo.monte_carlo(
        model,
        CAMERA,
        shade,
        PictureSamples(num_repeats=2),
        light=0,
        seed=0,
        purpose="test",
        points="depth",
    )
    assert torch.equal(seen[0], seen[1])
    assert not picture.standard_error.any()

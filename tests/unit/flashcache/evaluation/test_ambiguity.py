"""The posterior of materials under an unknown light is the one of the whole linear model, and behaves."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.evaluation.ambiguity import (
    Elimination,
    LinearModel,
    Priors,
    eliminate,
    light_covariance,
    material_uncertainty,
)

ALONE = Priors(log_albedo=1e3, independent_points=1e-9)
"""Hardly any prior on albedo, and points that teach nothing about the light."""


def lambertian(shares: torch.Tensor, views: int, sigma: float = 0.01, level: float = 0.5) -> LinearModel:
    """Return diffuse points of radiance `level`, of which patch b sends `shares[x, b]`, in every channel.

    Only log albedo and the light matter: the other parameters have no effect.
    """
    points, patches = shares.shape
    local = torch.zeros(points, views, 3, 10)
    light = torch.zeros(points, views, 3, patches, 3)
    for channel in range(3):
        local[:, :, channel, channel] = level
        light[:, :, channel, :, channel] = level * shares[:, None]
    weight = torch.full((points, views * 3), sigma**-2)
    return LinearModel(local.flatten(1, 2), light.reshape(points, views * 3, -1), weight)


def random_model(points: int = 5) -> LinearModel:
    generator = torch.Generator().manual_seed(1)
    local = torch.randn(points, 6, 10, generator=generator)
    light = torch.randn(points, 6, 8, generator=generator)
    return LinearModel(local, light, torch.rand(points, 6, generator=generator) * 50.0)


def test_eliminating_the_light_gives_the_posterior_of_the_whole_linear_model():
    model, priors = random_model(), Priors(independent_points=1e9)
    points, rows, patches = model.light.shape
    size = 10 * points + patches
    precision = np.zeros((size, size))
    for x in range(points):
        for r in range(rows):
            row = np.zeros(size)
            row[10 * x : 10 * x + 10] = model.local[x, r]
            row[10 * points :] = model.light[x, r]
            precision += float(model.weight[x, r]) * np.outer(row, row)
        widths = priors.local(model.local).numpy()
        precision[10 * x : 10 * x + 10, 10 * x : 10 * x + 10] += np.diag(widths**-2.0)
    precision[10 * points :, 10 * points :] += np.eye(patches) / priors.log_light**2
    covariance = np.linalg.inv(precision)
    found = eliminate(model, priors)
    light = light_covariance(found, priors)
    np.testing.assert_allclose(light, covariance[10 * points :, 10 * points :], rtol=1e-5, atol=1e-8)
    theta = found.inverse + found.gain @ light @ found.gain.transpose(1, 2)
    for x in range(points):
        block = covariance[10 * x : 10 * x + 10, 10 * x : 10 * x + 10]
        np.testing.assert_allclose(theta[x], block, rtol=1e-5, atol=1e-8)


def test_batches_of_points_can_be_joined():
    model, priors = random_model(6), Priors()
    parts = [
        eliminate(
            LinearModel(model.local[i : i + 2], model.light[i : i + 2], model.weight[i : i + 2]), priors
        )
        for i in (0, 2, 4)
    ]
    joined, whole = Elimination.join(parts), eliminate(model, priors)
    np.testing.assert_allclose(
        material_uncertainty(joined, priors).albedo, material_uncertainty(whole, priors).albedo, rtol=1e-6
    )


@pytest.mark.parametrize("views", [1, 4, 25])
def test_under_a_known_light_albedo_is_as_uncertain_as_the_mean_of_the_photographs(views):
    model = replace_light(lambertian(torch.ones(3, 1), views, sigma=0.02), 0.0)
    found = material_uncertainty(eliminate(model, ALONE), ALONE)
    np.testing.assert_allclose(found.albedo, 0.02 / (0.5 * views**0.5), rtol=1e-4)
    assert not found.albedo_from_light.any()


def replace_light(model: LinearModel, factor: float) -> LinearModel:
    return LinearModel(model.local, factor * model.light, model.weight)


def test_a_factor_common_to_all_points_is_not_counted():
    shares = torch.tensor([[0.3, 0.7]]).expand(6, 2)
    found = material_uncertainty(eliminate(lambertian(shares, 4), ALONE), ALONE)
    assert found.albedo_from_light.max() < 1e-5


def test_points_that_see_other_light_than_the_rest_are_ambiguous():
    shares = torch.tensor([[0.5, 0.5]] * 8 + [[1.0, 0.0]])
    found = material_uncertainty(eliminate(lambertian(shares, 4), ALONE), ALONE)
    # Log albedo gives way by minus the sum of shares times changes of the light, relative to the mean.
    offset = shares - shares.mean(dim=0)
    expected = ALONE.log_light * offset.norm(dim=1)
    np.testing.assert_allclose(found.albedo_from_light, expected[:, None].expand(-1, 3), rtol=1e-3)
    assert found.albedo_from_light[-1, 0] > 7.0 * found.albedo_from_light[0, 0]


def test_many_points_of_unrelated_albedo_teach_the_light():
    generator = torch.Generator().manual_seed(0)
    shares = torch.softmax(2.0 * torch.randn(400, 4, generator=generator), dim=1)
    model = lambertian(shares, 4)
    few, many = (
        material_uncertainty(eliminate(model, priors), priors).albedo_from_light.mean()
        for priors in (Priors(independent_points=1.0), Priors(independent_points=400.0))
    )
    assert many < 0.4 * few


def test_a_point_that_no_photograph_sees_has_its_priors():
    model = lambertian(torch.ones(2, 1), 3)
    model.weight[1] = 0.0
    priors = Priors()
    found = material_uncertainty(eliminate(model, priors), priors)
    assert found.albedo[0].max() < 0.05
    np.testing.assert_allclose(found.albedo[1], priors.log_albedo)
    assert float(found.metalness[1]) == pytest.approx(priors.metalness)
    assert float(found.perceptual_roughness[1]) == pytest.approx(priors.perceptual_roughness)


def test_more_photographs_never_make_anything_less_certain():
    model, priors = random_model(4), Priors()
    fewer = LinearModel(model.local, model.light, model.weight.clone())
    fewer.weight[:, 3:] = 0.0
    less, more = (eliminate(part, priors) for part in (fewer, model))
    light_less, light_more = (light_covariance(part, priors) for part in (less, more))
    assert torch.linalg.eigvalsh(light_less - light_more).min() > -1e-9
    for x in range(4):
        total = [
            part.inverse[x] + part.gain[x] @ light @ part.gain[x].T
            for part, light in ((less, light_less), (more, light_more))
        ]
        assert torch.linalg.eigvalsh(total[0] - total[1]).min() > -1e-9


def test_a_prior_without_a_width_is_refused():
    with pytest.raises(ConfigError, match="tilt must be positive"):
        replace(Priors(), tilt=0.0)

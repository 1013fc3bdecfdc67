"""The statements about estimators as functions, so that tests can also show that broken code breaks them.

Every row of a case is an independent estimate of the same point; `QUADRATURE` bounds the error of the
reference.
"""

from dataclasses import replace

import torch
from flashcache.losses.photometric import physical_photometric
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.incident import LightSources
from flashcache.physical.shading import Estimate, ShadingPoints
from support.shading import (
    LIMITS,
    NORMAL,
    Case,
    blurred,
    case,
    environment,
    nerf,
    peaked_mixture,
    reflected,
    unit,
)
from support.statistics import assert_mean

COUNTS = DirectionCounts(cosine=1, sampler=1, specular=2)
QUADRATURE = 1e-5


def estimates(
    given: Case,
    *,
    seed: int = 0,
    cache=blurred,
    sampler: str = "vmf",
    gradients: float = 0.0,
    light=environment,
    generator: torch.Generator | None = None,
    with_variance: bool = False,
    **settings,
) -> Estimate:
    """Return one estimate per row of `given`."""
    defaults = {"fast": COUNTS, "exact": COUNTS, "control_variate": "on"}
    config = EstimatorConfig(**(defaults | settings), sampler=sampler, normal_gradient=gradients)
    return control_variate(
        given.points,
        given.materials,
        LightSources(nerf, light, LIMITS, cache),
        mixture=peaked_mixture(given.rows, unit(0.5, -0.1, 0.8)) if sampler == "vmf" else None,
        config=config,
        generator=generator or torch.Generator().manual_seed(seed),
        with_variance=with_variance,
    )


def assert_estimates_agree_with_quadrature(given: Case, **settings) -> None:
    """Assert that the mean of every part of the estimate is its integral."""
    estimate = estimates(given, **settings)
    expected = reflected(given)
    for part in ("diffuse", "specular", "irradiance", "rgb"):
        assert_mean(getattr(estimate, part), expected[part], expected_error=QUADRATURE)


def with_gradients(given: Case) -> Case:
    """Return a case whose rows have a normal and materials of their own to be differentiated by."""

    def leaf(values: torch.Tensor) -> torch.Tensor:
        return values.detach().clone().requires_grad_()

    materials = Materials(
        leaf(given.materials.albedo), leaf(given.materials.alpha), leaf(given.materials.metalness)
    )
    points = ShadingPoints(*given.points)._replace(normal=leaf(given.points.normal))
    return replace(given, points=points, materials=materials)


def assert_gradients_agree_with_quadrature(rows: int, alpha: float, **settings) -> None:
    """Assert that the mean gradient by materials and normal is that of the integral."""
    given = with_gradients(case(rows, alpha=alpha))
    estimates(given, gradients=1.0, **settings).rgb.sum().backward()
    single = with_gradients(case(1, alpha=alpha))
    reflected(single)["rgb"].sum().backward()
    assert_mean(given.materials.albedo.grad, single.materials.albedo.grad[0], expected_error=QUADRATURE)
    assert_mean(given.materials.metalness.grad, single.materials.metalness.grad[0], expected_error=QUADRATURE)
    assert_mean(given.materials.alpha.grad, single.materials.alpha.grad[0], expected_error=QUADRATURE)
    tangents = torch.stack([unit(0.9, 0.0, -0.3), torch.linalg.cross(NORMAL, unit(0.9, 0.0, -0.3))], dim=1)
    assert_mean(
        given.points.normal.grad @ tangents,
        single.points.normal.grad[0] @ tangents,
        expected_error=10.0 * QUADRATURE,
    )


def assert_two_passes_minimise_the_error_of_the_mean(rows: int, *, independent: bool = True) -> None:
    """Assert that the loss of two passes has the gradient of the squared error of the mean picture."""
    given = with_gradients(case(rows))
    photograph = torch.tensor([1.2, 0.5, 0.3], dtype=torch.float64).expand(rows, 3)
    cache = torch.tensor([1.0, 0.6, 0.2], dtype=torch.float64).expand(rows, 3)
    passes = [estimates(given, seed=seed, sampler="none") for seed in (1, 2)]
    first, second = passes if independent else (passes[0], passes[0])
    weight = torch.ones(rows, dtype=torch.float64)
    # The loss is a mean over rows; each row's own gradient is one sample.
    (rows * physical_photometric(photograph, first.rgb, second.rgb, cache, weight)).backward()
    single = with_gradients(case(1))
    exact = reflected(single)["rgb"]
    scale = torch.maximum(photograph, cache)[0] + 0.01
    ((photograph[0] - exact).square() / scale).mean().backward()
    assert_mean(given.materials.alpha.grad, single.materials.alpha.grad[0], expected_error=QUADRATURE)
    assert_mean(given.materials.albedo.grad, single.materials.albedo.grad[0], expected_error=QUADRATURE)

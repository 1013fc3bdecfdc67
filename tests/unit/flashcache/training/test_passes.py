"""One pass over a few points of a ray estimates the dense quadrature of the volume."""

from dataclasses import replace

import pytest
import torch
from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch
from flashcache.geometry.rays import Rays
from flashcache.physical.brdf import Materials
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.passes import shade
from flashcache.volume.proposal_sampling import RaySamples
from support.shading import LIMITS, blurred, case, environment, nerf, reflected, unit
from support.statements import COUNTS, QUADRATURE
from support.statistics import assert_mean

WEIGHTS = (0.2, 0.35, 0.15)
"""Render weights of the three points of every ray: 0.7 of it is opaque."""
POSITIONS = torch.stack([unit(0.1, 0.2, 0.3), unit(-0.3, 0.1, 0.2), unit(0.5, -0.4, 0.1)])
NORMALS = torch.stack([unit(0.3, -0.2, 0.9), unit(-0.1, 0.1, 1.0), unit(0.2, 0.4, 0.8)])
SPECULAR = {"alpha": 0.4, "metalness": 0.6}
VIEWERS = (unit(0.6, 0.3, 0.8), unit(-0.5, 0.2, 0.9))
"""Rays alternate between these two, and between two lights."""


def lights(directions: torch.Tensor, light_index: torch.Tensor) -> torch.Tensor:
    """Return light of which the second has twice the first."""
    return environment(directions) * (1.0 + light_index.to(directions.dtype))[:, None]


class Toy(InverseModel):
    """A model with one material, caches in closed form and two lights."""

    def __init__(self) -> None:
        torch.nn.Module.__init__(self)
        self.limits = LIMITS

    def materials(self, positions: torch.Tensor) -> Materials:
        return case(len(positions), **SPECULAR).materials

    def environment(self, directions: torch.Tensor, light_index: torch.Tensor) -> torch.Tensor:
        return lights(directions, light_index)

    def nerf_source(self, generator: torch.Generator, *, jitter: bool = False):
        return nerf

    def fast_source(self):
        return blurred


def seen(rows: int) -> tuple[RayBatch, Geometry]:
    """Return `rows` rays with three points each, of two kinds in turn."""
    kind = torch.arange(rows) % 2
    directions = -torch.stack(VIEWERS)[kind]
    ends = torch.ones(rows, dtype=torch.float64)
    edges = torch.linspace(0.0, 1.0, 4, dtype=torch.float64).expand(rows, 4)
    positions = POSITIONS.expand(rows, 3, 3)
    batch = RayBatch(Rays(-directions, directions, 0.0 * ends, ends), positions[:, 0], ends, kind)
    weights = torch.tensor(WEIGHTS, dtype=torch.float64).expand(rows, 3)
    normal = NORMALS.expand(rows, 3, 3).reshape(-1, 3)
    samples = RaySamples(edges, edges, positions, ())
    return batch, Geometry(samples, weights, torch.zeros(3 * rows, 1), normal, None)


def config_without_sampler() -> StageTwoConfig:
    config = tiny().stage_two
    estimator = replace(config.estimator, fast=COUNTS, exact=COUNTS, sampler="none")
    return replace(config, estimator=estimator, points_per_ray=1)


@pytest.mark.parametrize(("passes", "points_per_ray"), [(1, 1), (1, 2), (2, 1), (2, 2)])
def test_every_pass_over_few_points_has_the_mean_of_the_half_transparent_volume(passes, points_per_ray):
    batch, geometry = seen(8000)
    config = replace(config_without_sampler(), points_per_ray=points_per_ray)
    generator = torch.Generator().manual_seed(0)
    pictures = shade(Toy(), config, batch, geometry, generator, passes=passes).pictures
    assert len(pictures) == passes
    for kind, viewer in enumerate(VIEWERS):
        expected = torch.zeros(3, dtype=torch.float64)
        for weight, position, normal in zip(WEIGHTS, POSITIONS, NORMALS, strict=True):
            given = case(1, normal=normal, omega_o=viewer, **SPECULAR)
            given = replace(given, points=given.points._replace(positions=position[None]))
            light = lambda directions, index, kind=kind: lights(directions, index + kind)  # noqa: E731
            expected += weight * reflected(given, light=light)["rgb"]
        for picture in pictures:
            assert_mean(picture[kind::2], expected, expected_error=QUADRATURE)


def test_the_points_of_a_pass_say_nothing_about_those_of_the_other():
    batch, geometry = seen(8000)
    generator = torch.Generator().manual_seed(0)
    index = shade(Toy(), config_without_sampler(), batch, geometry, generator, passes=2).index
    of_ray = (index.reshape(2, -1) - 3 * torch.arange(8000)).double()
    one, other = of_ray - of_ray.mean(dim=1, keepdim=True)
    assert_mean(one * other, 0.0)


def test_the_depth_estimator_shades_the_same_point_in_both_passes():
    batch, geometry = seen(16)
    config = replace(config_without_sampler(), points="depth")
    found = shade(Toy(), config, batch, geometry, torch.Generator().manual_seed(0), passes=2)
    assert torch.equal(found.index[:16], found.index[16:])
    assert not torch.equal(*found.pictures)

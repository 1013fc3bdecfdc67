"""Derivatives of radiance agree with differences, and patches of the light add up to the whole."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from flashcache.color import alpha_from_perceptual_roughness
from flashcache.evaluation.radiance_derivatives import (
    NUM_PATCHES,
    Noise,
    SeenPoints,
    hemisphere,
    linear_model,
    patch_of,
)
from flashcache.geometry.directions import normalize
from flashcache.physical.brdf import Materials
from flashcache.physical.incident import Incident, RayLimits
from flashcache.physical.model import Domain
from support.statistics import assert_mean

BOX = {"bounds_min": (-1.0,) * 3, "bounds_max": (1.0,) * 3}
SPACE = {"primary": (1.0, 4.0), "secondary": (0.05, 2.0), "contraction_radius": 1.0}
NOISE = Noise(absolute=0.1, saturation=1e9)


@dataclass
class Uniform:
    """Stands for a model: one material everywhere under a smooth sky."""

    albedo: tuple[float, float, float] = (0.6, 0.3, 0.1)
    metalness: float = 0.3
    perceptual_roughness: float = 0.6
    lights: tuple[str, ...] = ("day",)
    rotations_deg: tuple[float, ...] = ()
    known_lights: tuple[str, ...] = ()
    sky_of: object = None

    limits = RayLimits(near=0.05, far=2.0)

    @property
    def domain(self) -> Domain:
        return Domain(
            **BOX,
            **SPACE,
            lights=self.lights,
            rotations_deg=self.rotations_deg,
            known_lights=self.known_lights,
        )

    def materials(self, positions):
        one = torch.ones_like(positions[:, :1])
        alpha = alpha_from_perceptual_roughness(self.perceptual_roughness * one)
        return Materials(torch.tensor(self.albedo).expand_as(positions), alpha, self.metalness * one)

    def environment(self, directions, light_index):
        if self.sky_of is not None:
            return self.sky_of(directions, light_index)
        return (1.5 + directions) * (1.0 + light_index[:, None])


def half_hidden(rays):
    """Hide a quarter of the sky behind a surface that shines a little."""
    opacity = torch.full_like(rays.origins[:, 0], 0.25)
    return Incident(0.05 * torch.ones_like(rays.origins), opacity, opacity)


def points(count=4, views=3, lights=1, seed=0) -> SeenPoints:
    generator = torch.Generator().manual_seed(seed)
    normal = normalize(torch.randn(count, 3, generator=generator))
    omega_o = normalize(normal[:, None] + 0.6 * torch.randn(count, views, 3, generator=generator))
    omega_o = normalize(omega_o + 0.5 * normal[:, None])
    light_index = torch.arange(views).expand(count, views) % lights
    return SeenPoints(torch.zeros(count, 3), normal, omega_o, light_index, torch.ones(count, views))


def radiance(model, where, source=half_hidden):
    """Return radiance [points, rows]: the sum of its derivatives by the logarithms of all light."""
    found = linear_model(model, where, source, NOISE)
    return found.light.sum(dim=-1) + found.local[..., 7:].sum(dim=-1)


@pytest.mark.parametrize(
    ("column", "change"),
    [
        (3, {"metalness": 0.3}),
        (4, {"perceptual_roughness": 0.6}),
    ],
)
def test_derivatives_by_materials_are_those_of_differences(column, change):
    where, model, step = points(), Uniform(), 1e-3
    ((name, at),) = change.items()
    above, below = (radiance(replace(model, **{name: at + sign * step}), where) for sign in (1, -1))
    found = linear_model(model, where, half_hidden, NOISE).local[..., column]
    np.testing.assert_allclose(found, (above - below) / (2 * step), rtol=5e-3, atol=2e-4)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_the_derivative_by_log_albedo_is_that_of_a_difference(channel):
    where, model, step = points(), Uniform(), 1e-3
    factors = np.ones(3)
    factors[channel] = np.exp(step)
    above = radiance(replace(model, albedo=tuple(np.array(model.albedo) * factors)), where)
    found = linear_model(model, where, half_hidden, NOISE).local[..., channel]
    np.testing.assert_allclose(found, (above - radiance(model, where)) / step, rtol=5e-3, atol=3e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_derivative_by_a_tilt_is_that_of_a_turned_normal(axis):
    from flashcache.geometry.directions import tangent_frame

    where, model, step = points(), Uniform(perceptual_roughness=0.9, metalness=0.0), 0.05
    tangent = tangent_frame(where.normal)[axis]
    above, below = (
        radiance(model, replace(where, normal=normalize(where.normal + sign * step * tangent)))
        for sign in (1, -1)
    )
    found = linear_model(model, where, half_hidden, NOISE).local[..., 5 + axis]
    # The pattern of directions turns with the normal, so this holds as well as the pattern integrates.
    np.testing.assert_allclose(found, (above - below) / (2 * step), atol=0.03)


def test_a_white_surface_under_a_white_sky_reflects_all_of_it():
    white = Uniform((1.0, 1.0, 1.0), 0.0, 1.0, sky_of=lambda omega, _: torch.ones_like(omega))
    clear = lambda rays: Incident(  # noqa: E731
        torch.zeros_like(rays.origins), torch.zeros(len(rays)), torch.zeros(len(rays))
    )
    dielectric = radiance(white, points(), clear)
    # Diffuse reflection is complete; the specular lobe adds a few percent.
    assert dielectric.min() > 0.99
    assert dielectric.max() < 1.2


def test_light_columns_know_their_patch_light_and_channel():
    target = torch.tensor([0.3, -0.5, 0.8])
    patch = int(patch_of(target))

    def lamp(omega, light_index):
        lit = (patch_of(omega) == patch) & (light_index == 1)
        return lit[:, None] * torch.tensor([1.0, 2.0, 4.0])

    where = points(count=1, views=2, lights=2)
    where = replace(where, normal=normalize(target)[None], omega_o=normalize(target).expand(1, 2, 3))
    model = Uniform((0.5, 0.5, 0.5), 0.0, lights=("a", "b"), sky_of=lamp)
    light = linear_model(model, where, half_hidden, NOISE).light.reshape(2, 3, 2, NUM_PATCHES, 3)
    expected = torch.zeros(2, NUM_PATCHES, 3, 3)
    assert not light[0].any()
    shining = light[1, :, 1, patch]
    assert torch.equal(shining, torch.diag(shining.diagonal()))
    assert float(shining[2, 2] / shining[0, 0]) == pytest.approx(4.0, rel=1e-4)
    light[1, :, 1, patch] = 0.0
    assert torch.equal(light[1].permute(1, 2, 0, 3), expected)


def test_turned_lights_share_the_patches_of_one_environment():
    target = normalize(torch.tensor([0.9, 0.2, 0.3]))
    patch = int(patch_of(target))

    def turned(omega, light_index):
        quarter = torch.stack([omega[:, 1], -omega[:, 0], omega[:, 2]], dim=-1)
        base = torch.where((light_index == 1)[:, None], quarter, omega)
        return (patch_of(base) == patch)[:, None] * torch.ones(3)

    model = Uniform(lights=("sun_000", "sun_090"), rotations_deg=(0.0, 90.0), sky_of=turned)
    found = linear_model(model, points(count=6, views=4, lights=2), half_hidden, NOISE)
    light = found.light.reshape(6, 4, 3, NUM_PATCHES, 3)
    assert light[:, 1::2].sum() > 0.0
    assert light[:, ::2].sum() > 0.0
    light[:, :, :, patch] = 0.0
    assert not light.any()


@pytest.mark.parametrize("turned", [(), (0.0, 120.0)])
def test_a_known_light_leaves_nothing_to_learn_about_it(turned):
    where = points(views=2, lights=2)
    model = Uniform(lights=("a", "b"), rotations_deg=turned, known_lights=("b",))
    light = linear_model(model, where, half_hidden, NOISE).light.reshape(4, 2, -1)
    assert not light[:, 1].any()
    assert bool(light[:, 0].any()) == (not turned)


def test_clipped_photographs_and_unseen_points_carry_no_weight():
    where = points()
    where.visibility[1] = 0.0
    found = linear_model(Uniform(), where, half_hidden, Noise(absolute=0.1, saturation=0.2))
    seen = radiance(Uniform(), where)
    assert (found.weight[1] == 0.0).all()
    assert (seen > 0.2).any()
    assert (found.weight[seen > 0.2] == 0.0).all()
    others = (seen <= 0.2) & (torch.arange(4) != 1)[:, None]
    np.testing.assert_allclose(found.weight[others], 1.0 / (0.01 + (0.02 * seen[others]) ** 2), rtol=1e-3)


def test_the_pattern_covers_the_hemisphere_evenly():
    pattern = hemisphere(torch.zeros(1))
    assert pattern[:, 2].min() > 0.0
    np.testing.assert_allclose(pattern.norm(dim=1), 1.0, atol=1e-6)
    weight = 2.0 * math.pi / len(pattern)
    assert float(weight * pattern[:, 2].sum()) == pytest.approx(math.pi, rel=1e-4)
    np.testing.assert_allclose(weight * pattern[:, :2].sum(dim=0), 0.0, atol=0.02)


def test_patches_have_equal_solid_angles():
    omega = normalize(torch.randn(50_000, 3, generator=torch.Generator().manual_seed(2)))
    member = torch.nn.functional.one_hot(patch_of(omega), NUM_PATCHES).double()
    assert_mean(member, torch.full((NUM_PATCHES,), 1.0 / NUM_PATCHES, dtype=torch.float64))

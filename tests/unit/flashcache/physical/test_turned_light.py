"""A light that turns around the object: every part of the model agrees on where it is."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.caches.environment import Environment, EnvironmentConfig
from flashcache.caches.fast_cache import FastCache
from flashcache.config import DistilConfig, Rates, StageTwoConfig
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.data.space import SpaceConfig, domain_of
from flashcache.encoding.turns import LightTurns
from flashcache.errors import ConfigError
from flashcache.fields.appearance import AppearanceField
from flashcache.geometry.directions import look_up
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.incident import Incident, LightSources
from flashcache.physical.light_sampler import LightSampler
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from flashcache.training.stage_two import StageTwo
from support.shading import LIMITS, Case, case, reflected
from support.sphere_model import RADIUS as BALL
from support.sphere_model import make_ball, small_config
from support.statistics import assert_mean
from support.turning_light import ALBEDO, TURNS, about, flat, sky, sky_map, turntable

CONFIG = small_config(own_normal_grid=False, softplus_beta=None, distance_layers=2)
ROWS = 20000


def index(count: int, light: int) -> torch.Tensor:
    return torch.full((count,), light)


def directions(count: int = 50) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


def known_environment(turns: LightTurns) -> Environment:
    made = Environment(
        EnvironmentConfig(width=8, num_layers=1, last_width=8, known_height=16), 1, known=(0,), turns=turns
    )
    made.set_known(0, sky_map(16))
    return made


def fast_cache(turns: LightTurns | None, *, width: int = 12) -> FastCache:
    torch.manual_seed(0)
    made = FastCache(
        replace(CONFIG.fast, decoder_widths=(width, width)), 1.0, 1, (LIMITS.near, LIMITS.far), turns=turns
    )
    with torch.no_grad():
        made.feature_grid.table.normal_(std=0.5)
    return made


def single(given: Case, light: int) -> Case:
    points = ShadingPoints(*(part.float() for part in given.points[:3]), index(given.rows, light))
    kept = given.materials
    return Case(points, Materials(kept.albedo.float(), kept.alpha.float(), kept.metalness.float()))


@pytest.mark.parametrize("light", [1, 2])
@pytest.mark.parametrize("is_known", [True, False])
def test_the_environment_is_the_references_turned_with_the_photograph(light, is_known):
    turns = LightTurns(flat(TURNS))
    torch.manual_seed(0)
    made = known_environment(turns) if is_known else Environment(EnvironmentConfig(width=8), 1, turns=turns)
    omega = directions()
    turned = omega @ torch.from_numpy(TURNS[light - 1]).float().T
    torch.testing.assert_close(made(omega, index(50, light)), made(turned, index(50, 0)))
    assert not torch.allclose(made(omega, index(50, light)), made(omega, index(50, 0)), rtol=0.1)


@pytest.mark.parametrize("light", [0, 1, 2])
@pytest.mark.parametrize("mode", ["on", "off"])
def test_estimates_under_a_turned_light_agree_with_quadrature(light, mode):
    turns = LightTurns(flat(TURNS))
    rotation = torch.eye(3) if light == 0 else torch.from_numpy(TURNS[light - 1]).float()
    given = single(case(ROWS), light)

    def near(rays) -> Incident:
        """Return a half-transparent neighbour towards +x that shines in the colours of the lamp's side."""
        opacity = 0.5 + 0.4 * torch.tanh(3.0 * rays.directions[:, 0])
        return Incident(opacity[:, None] * sky((-rays.directions) @ rotation.to(opacity).T), opacity, opacity)

    def nerf(rays) -> Incident:
        assert bool((rays.light_index == light).all())
        return near(rays)

    torch.manual_seed(0)
    environment, fast = known_environment(turns), fast_cache(turns)
    sampler = LightSampler(CONFIG.light_sampler, 1.0, 1, turns)
    counts = DirectionCounts(cosine=1, sampler=1, specular=2)
    with torch.no_grad():
        estimate = control_variate(
            given.points,
            given.materials,
            LightSources(
                nerf, environment, LIMITS, lambda rays: fast(rays.origins, rays.directions, rays.light_index)
            ),
            mixture=sampler(given.points.positions, given.points.light_index),
            config=EstimatorConfig(fast=counts, exact=counts, control_variate=mode),
            generator=torch.Generator().manual_seed(0),
        )
    image = environment.known_images.double()

    def light_of(omega, _):
        return look_up(image, omega @ rotation.double().T, index(len(omega), 0))

    expected = reflected(case(1), near, light_of)
    for part in ("diffuse", "specular", "rgb"):
        assert_mean(getattr(estimate, part), expected[part], expected_error=2e-3)


def test_the_light_samplers_lobes_turn_with_the_light():
    torch.manual_seed(0)
    sampler = LightSampler(CONFIG.light_sampler, 1.0, 1, LightTurns(flat(TURNS)))
    torch.nn.init.zeros_(sampler.head.weight)
    torch.nn.init.normal_(sampler.head.bias)
    centre = torch.zeros(50, 3)
    omega = directions()
    for light, turn in enumerate(TURNS, start=1):
        turned = omega @ torch.from_numpy(turn).float().T
        here, there = sampler(centre, index(50, light)), sampler(centre, index(50, 0))
        torch.testing.assert_close(here.pdf(omega[:, None]), there.pdf(turned[:, None]), rtol=1e-4, atol=1e-6)


def test_the_light_samplers_amplitudes_depend_on_the_turn():
    torch.manual_seed(0)
    sampler = LightSampler(CONFIG.light_sampler, 1.0, 1, LightTurns(flat(TURNS)))
    place = torch.full((2, 3), 0.2)
    one, other = sampler(place, torch.tensor([0, 1])).log_amplitude
    assert not torch.allclose(one, other)


def test_a_fast_cache_for_one_turn_answers_as_the_whole_one_does_there():
    made = fast_cache(LightTurns(flat(TURNS)))
    origins, omega = 0.3 * directions(), directions().flip(0)
    whole, still = made(origins, omega, index(50, 2)), made.at_turn(2)(origins, omega, index(50, 0))
    torch.testing.assert_close(still.near_radiance, whole.near_radiance)
    other = made(origins, omega, index(50, 0))
    assert not torch.allclose(other.near_radiance, whole.near_radiance)
    assert torch.equal(other.opacity, whole.opacity)
    assert made.turns is not None


def lamp_error(turns: LightTurns | None, kind: str) -> float:
    """Return the error of a cache on turns that it was not shown, after learning a ball under a lamp."""
    seen = [about((0.0, 0.0, 1.0), 360.0 * k / 16) for k in range(16)]
    unseen = [about((0.0, 0.0, 1.0), 360.0 * (k + 0.5) / 16) for k in range(16)]
    every = [*seen, *unseen]
    lights = None if turns is None else LightTurns(flat(every))
    torch.manual_seed(0)
    if kind == "appearance":
        config = replace(CONFIG.nerf.appearance, reflection_width=32, bottleneck=16)
        made = AppearanceField(config, 2, 1.0, 1, turns=lights)
    else:
        made = fast_cache(lights, width=32)
    optimiser = torch.optim.Adam(made.parameters(), lr=1e-2)
    generator = torch.Generator().manual_seed(1)
    rotations = torch.from_numpy(np.stack(every)).float()
    lamp = torch.tensor([0.8, 0.1, 0.6])

    def compared(numbers: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        normal = torch.nn.functional.normalize(torch.randn(len(numbers), 3, generator=generator), dim=-1)
        toward = (rotations[numbers] @ normal[..., None])[..., 0] @ lamp
        wanted = 0.1 + toward.clamp_min(0.0)
        points = 0.5 * normal
        if kind == "appearance":
            found = made(
                points, torch.zeros(len(numbers), 2), normal, normal, numbers + 1, with_specular=False
            )
            return found.diffuse.mean(dim=-1), wanted
        # Rays from above the surface straight down onto it.
        answer = made(1.2 * points, -normal, numbers + 1)
        return answer.near_radiance.mean(dim=-1), wanted

    for _ in range(150):
        found, wanted = compared(torch.randint(16, (512,), generator=generator))
        optimiser.zero_grad()
        (found - wanted).square().mean().backward()
        optimiser.step()
    with torch.no_grad():
        found, wanted = compared(16 + torch.randint(16, (2048,), generator=generator))
        return float((found - wanted).square().mean().sqrt())


@pytest.mark.parametrize("kind", ["appearance", "fast"])
def test_a_cache_that_knows_the_turn_has_the_radiance_at_turns_it_was_not_shown(kind):
    knows, does_not = lamp_error(LightTurns(flat([])), kind), lamp_error(None, kind)
    assert knows < 0.35 * does_not


def test_training_pixels_carry_the_turn_of_their_photograph():
    scene = turntable(4)
    pixels = TrainingPixels(scene, PixelChoice(), torch.device("cpu"))
    batch = pixels.at(torch.tensor([0, 16 * 16, 3 * 16 * 16]))
    domain = domain_of(scene, SpaceConfig(), EnvironmentConfig())
    model_turns = torch.tensor(domain.turns).reshape(-1, 3, 3)
    assert batch.light_index.tolist() == [1, 2, 4]
    torch.testing.assert_close(
        model_turns[batch.light_index[2]], torch.from_numpy(scene.train[3].light_turn).float()
    )


def test_several_lights_cannot_turn():
    scene = replace(turntable(2), lights=("sky", "lamp"))
    with pytest.raises(ConfigError, match="train on one of them"):
        domain_of(scene, SpaceConfig(), EnvironmentConfig())


class BallNormals(torch.nn.Module):
    """Normals of a ball around the origin."""

    def forward(self, positions: torch.Tensor, hidden: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.normalize(positions, dim=-1)


def albedo_error(told: bool) -> float:
    """Return the relative error of a ball's albedo after training its materials under a given sky."""
    scene = turntable(told=told)
    sizes = replace(CONFIG, environment=replace(CONFIG.environment, known_height=16))
    torch.manual_seed(0)
    model = InverseModel(sizes, domain_of(scene, SpaceConfig(), sizes.environment, ("sky",)))
    model.environment.set_known(0, sky_map(16))
    for field in (model.nerf.density, *model.nerf.proposals):
        make_ball(field)
    model.nerf.normals = BallNormals()
    with torch.no_grad():
        model.fast.distance_head.bias[-1] = -50.0  # Nothing hides the sky from a ball.
    config = StageTwoConfig(
        num_steps=60,
        num_rays=256,
        estimator=EstimatorConfig(
            fast=DirectionCounts(cosine=6, sampler=0, specular=2),
            exact=DirectionCounts(cosine=0, sampler=0, specular=0),
            control_variate="fast_only",
            sampler="none",
        ),
        material_rates=Rates(grid=2e-2, network=2e-2),
        cache_rates=Rates(grid=0.0, network=0.0),
        physical_weight=1.0,
        normal_weight=0.0,
        consistency_weight=0.0,
        smoothness_weight=0.0,
        distil=DistilConfig(),
    )
    stage = StageTwo(model, TrainingPixels(scene, PixelChoice(), torch.device("cpu")), config, seed=0)
    while not stage.finished:
        stage.step()
    with torch.no_grad():
        found = model.materials(BALL * directions(200))
        seen = (found.albedo * (1.0 - found.metalness)).mean(dim=0)
    return float((seen / torch.tensor(ALBEDO)).log().abs().mean())


@pytest.mark.slow
def test_training_with_the_turns_recovers_the_albedo_better_than_without():
    assert albedo_error(told=True) < 0.6 * albedo_error(told=False)


def test_a_photograph_of_an_unknown_turn_gets_a_light_index_of_its_own():
    torch.manual_seed(0)
    model = InverseModel(CONFIG, domain_of(turntable(2), SpaceConfig(), EnvironmentConfig()))
    names = functools.partial(model.light_at, 0)
    assert names(None) == 0
    assert names(turntable(2).train[1].light_turn) == 2
    assert names(about((0.0, 0.0, 1.0), 33.0)) == 3
    assert math.isfinite(float(model.environment(directions(4), index(4, 3)).detach().sum()))

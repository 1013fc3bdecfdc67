from dataclasses import fields, replace

import pytest
from flashcache.caches.environment import EnvironmentConfig
from flashcache.data.space import SpaceConfig, domain_of, placed, rotations_of
from flashcache.errors import ConfigError
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from support.lit_sphere import lit_sphere

SCENE = lit_sphere(num_views=1, side=4)
ROTATED = EnvironmentConfig(lights="rotated")


def test_without_settings_a_scene_stays_where_its_capture_puts_it():
    found = placed(SCENE, SpaceConfig())
    assert all(getattr(found, item.name) == getattr(SCENE, item.name) for item in fields(SCENE))


def test_stated_distances_replace_those_of_the_capture():
    space = SpaceConfig(contraction_radius=2.0, primary=(2.0, 6.0), secondary=(0.05, 2.0), fast_radius=0.5)
    found = placed(SCENE, space)
    assert (found.contraction_radius, found.primary, found.secondary) == (2.0, (2.0, 6.0), (0.05, 2.0))
    assert (found.bounds_min, found.lights) == (SCENE.bounds_min, SCENE.lights)
    domain = domain_of(SCENE, space, EnvironmentConfig())
    assert (domain.contraction_radius, domain.secondary, domain.fast_radius) == (2.0, (0.05, 2.0), 0.5)
    assert (domain.rotations_deg, domain.known_lights) == ((), ())


def test_the_angles_of_rotated_lights_stand_in_their_names():
    assert rotations_of(("sunset_000", "sunset_120", "venice_sunset_240"), ROTATED) == (0.0, 120.0, 240.0)
    assert rotations_of(("sunset_000", "snow"), EnvironmentConfig()) == ()


def test_stated_angles_go_before_names():
    assert rotations_of(("a_120", "b"), replace(ROTATED, rotations_deg=(10.0, 20.5))) == (10.0, 20.5)
    with pytest.raises(ConfigError, match="one per light"):
        rotations_of(("a", "b"), replace(ROTATED, rotations_deg=(10.0,)))


def test_a_rotated_light_without_an_angle_is_named():
    with pytest.raises(ConfigError, match="snow has no angle"):
        rotations_of(("sunset_000", "snow"), ROTATED)


@pytest.mark.parametrize("settings", [{"primary": (3.0, 1.0)}, {"contraction_radius": -1.0}])
def test_impossible_distances_are_refused(settings):
    with pytest.raises(ConfigError, match="space"):
        SpaceConfig(**settings)


@pytest.mark.parametrize(
    ("near", "offset", "expected"), [(0.05, 0.0, 0.01), (0.2, 0.0, 0.04), (0.05, 0.02, 0.02)]
)
def test_secondary_rays_start_a_fifth_of_their_near_distance_above_the_surface(near, offset, expected):
    space = SpaceConfig(secondary=(near, 2.0), origin_offset=offset)
    model = InverseModel(tiny().model, domain_of(SCENE, space, EnvironmentConfig()))
    assert model.limits.origin_offset == pytest.approx(expected)
    assert (model.limits.near, model.limits.far) == (near, 2.0)

"""The gbuffer function's results on a ball."""

import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.export import reference
from flashcache.export.reference import GbufferRule
from support.sphere_model import sphere_model

BOX = {"box_min": (-0.8,) * 3, "box_max": (0.8,) * 3}
RULE = GbufferRule(**BOX, num_samples=256)


@pytest.fixture(scope="module")
def model():
    return sphere_model()


def look(
    model, origin: list[float], direction: list[float], rule: GbufferRule = RULE
) -> dict[str, torch.Tensor]:
    with torch.no_grad():
        return reference.gbuffer(model, rule, torch.tensor([origin]), torch.tensor([direction]))


def surface_distance(model) -> float:
    """Return the mean distance at which a ray from x = 3 along -x ends, from its transmittance."""
    x = torch.linspace(0.8, 0.0, 20000)
    with torch.no_grad():
        density = model.nerf.density.density(torch.stack([x, 0 * x, 0 * x], dim=-1))
    depth = (density * 0.8 / 20000).cumsum(dim=0)
    share = torch.exp(-depth)
    mean = torch.trapezoid(share, 0.8 - x) + 2.2
    return float(mean)


def test_a_ray_through_the_middle_is_opaque_at_the_balls_distance(model):
    seen = look(model, [3.0, 0.0, 0.0], [-1.0, 0.0, 0.0])
    assert seen["opacity"].item() == pytest.approx(1.0, abs=1e-5)
    assert seen["distance"].item() == pytest.approx(surface_distance(model), abs=0.004)


@pytest.mark.parametrize("height", [0.0, 0.3])
def test_values_are_the_means_that_many_ungrouped_samples_give(model, height):
    dense = GbufferRule(**BOX, num_samples=4096, group=1)
    seen = look(model, [3.0, 0.0, height], [-1.0, 0.0, 0.0])
    wanted = look(model, [3.0, 0.0, height], [-1.0, 0.0, 0.0], dense)
    for name in ("opacity", "distance", "albedo", "perceptual_roughness", "metalness"):
        assert torch.allclose(seen[name], wanted[name], atol=0.005), name
    assert (seen["normal"] * wanted["normal"]).sum() > 0.999


@pytest.mark.parametrize("origin", [[3.0, 0.0, 0.79], [3.0, 0.0, 2.0], [-3.0, 0.0, 0.0]])
def test_rays_that_pass_the_ball_the_box_or_look_away_see_nothing(model, origin):
    seen = look(model, origin, [-1.0, 0.0, 0.0])
    assert seen["opacity"].item() < 1e-3
    assert seen["normal"].norm().item() == pytest.approx(1.0, abs=1e-5)
    assert all(torch.isfinite(value).all() for value in seen.values())


def test_an_empty_ray_has_its_normal_upwards(model):
    assert torch.allclose(
        look(model, [3.0, 0.0, 2.0], [-1.0, 0.0, 0.0])["normal"], torch.tensor([[0.0, 0.0, 1.0]])
    )


def test_a_ray_that_starts_inside_the_box_sees_only_what_is_ahead(model):
    assert look(model, [0.7, 0.0, 0.0], [1.0, 0.0, 0.0])["opacity"].item() < 0.05
    ahead = look(model, [0.75, 0.0, 0.0], [-1.0, 0.0, 0.0])
    assert ahead["distance"].item() == pytest.approx(surface_distance(model) - 2.25, abs=0.004)


def test_rays_along_an_axis_are_as_good_as_others(model):
    straight = look(model, [0.1, 0.0, 3.0], [0.0, 0.0, -1.0])
    tilted = look(model, [0.1, 0.0, 3.0], [1e-7, 1e-7, -1.0])
    assert torch.allclose(straight["distance"], tilted["distance"], atol=1e-4)


def test_the_number_of_samples_must_fill_whole_groups():
    with pytest.raises(ConfigError, match="multiple of 4"):
        GbufferRule(**BOX, num_samples=130)


def test_opacity_of_the_material_function_grows_with_density(model):
    with torch.no_grad():
        seen = reference.material(model, torch.tensor([[0.0, 0.0, 0.0], [0.75, 0.0, 0.0]]))
    assert seen["opacity"][0] > 0.99
    assert seen["opacity"][1] < 0.01
    assert set(seen) == {"albedo", "perceptual_roughness", "metalness", "normal", "opacity"}


def test_the_fast_cache_function_is_the_fast_cache(model):
    origin, direction = torch.rand(5, 3), torch.nn.functional.normalize(torch.randn(5, 3), dim=-1)
    with torch.no_grad():
        seen = reference.fast_cache(model, 1, origin, direction)
        answer = model.fast(origin, direction, torch.ones(5, dtype=torch.long))
    assert torch.equal(seen["radiance"], answer.near_radiance)
    assert torch.equal(seen["distance"][:, 0], answer.distance)

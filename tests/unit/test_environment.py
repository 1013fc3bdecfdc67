import math

import pytest
import torch
from flashcache.caches.environment import Environment, EnvironmentConfig
from flashcache.errors import ConfigError
from flashcache.geometry.directions import environment_directions

TEXTURE = EnvironmentConfig(texture_height=8)


def texture(num_lights: int = 1) -> Environment:
    made = Environment(TEXTURE, num_lights)
    with torch.no_grad():
        made.texture.copy_(torch.randn(made.texture.shape, generator=torch.Generator().manual_seed(0)))
    return made


def lights(directions: torch.Tensor, light: int = 0) -> torch.Tensor:
    return torch.full((len(directions),), light)


def test_a_texture_answers_with_its_pixel_at_the_pixels_centre():
    made = texture()
    directions = environment_directions(8, 16).reshape(-1, 3).float()
    expected = torch.nn.functional.softplus(made.texture[0] - 1.0).permute(1, 2, 0).reshape(-1, 3)
    torch.testing.assert_close(made(directions, lights(directions)), expected, rtol=1e-4, atol=1e-4)


def test_radiance_does_not_jump_where_the_azimuth_wraps():
    angle = torch.tensor([math.pi - 1e-4, -math.pi + 1e-4])
    directions = torch.stack([angle.cos(), angle.sin(), torch.zeros(2)], dim=-1)
    left, right = texture()(directions, lights(directions))
    torch.testing.assert_close(left, right, rtol=0.0, atol=1e-2)


@pytest.mark.parametrize("config", [TEXTURE, EnvironmentConfig(width=8, num_layers=1, last_width=8)])
def test_the_picture_shows_each_direction_where_the_convention_puts_it(config: EnvironmentConfig):
    torch.manual_seed(0)
    made = texture() if config is TEXTURE else Environment(config, 1)
    directions = environment_directions(6, 12).float()
    flat = directions.reshape(-1, 3)
    torch.testing.assert_close(
        made.image(6).reshape(-1, 3), made(flat, lights(flat)).detach(), rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("config", [TEXTURE, EnvironmentConfig(width=8, num_layers=1, last_width=8)])
def test_lights_differ_and_are_positive(config: EnvironmentConfig):
    torch.manual_seed(0)
    made = texture(2) if config is TEXTURE else Environment(config, 2)
    directions = torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    first, second = made(directions, lights(directions)), made(directions, lights(directions, 1))
    assert not torch.allclose(first, second)
    assert min(first.min(), second.min()) > 0.0


def test_an_odd_number_of_rows_is_refused():
    with pytest.raises(ConfigError, match="even"):
        EnvironmentConfig(texture_height=7)

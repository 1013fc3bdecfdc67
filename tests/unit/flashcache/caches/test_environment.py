import math
from dataclasses import replace

import pytest
import torch
from flashcache.caches.environment import Environment, EnvironmentConfig
from flashcache.geometry.directions import environment_directions
from flashcache.geometry.octahedron import octahedral_directions

CONFIG = EnvironmentConfig(width=8, num_layers=1, last_width=8, known_height=8)


def given() -> Environment:
    made = Environment(CONFIG, 1, known=(0,))
    made.set_known(0, torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(0)))
    return made


def lights(directions: torch.Tensor, light: int = 0) -> torch.Tensor:
    return torch.full((len(directions),), light)


def test_radiance_does_not_jump_where_the_azimuth_wraps():
    angle = torch.tensor([math.pi - 1e-4, -math.pi + 1e-4])
    directions = torch.stack([angle.cos(), angle.sin(), torch.zeros(2)], dim=-1)
    left, right = given()(directions, lights(directions))
    torch.testing.assert_close(left, right, rtol=0.0, atol=1e-2)


@pytest.mark.parametrize("known", [(0,), ()])
def test_the_picture_shows_each_direction_where_the_convention_puts_it(known):
    torch.manual_seed(0)
    made = given() if known else Environment(CONFIG, 1)
    flat = environment_directions(6, 12).float().reshape(-1, 3)
    torch.testing.assert_close(
        made.image(6).reshape(-1, 3), made(flat, lights(flat)).detach(), rtol=1e-4, atol=1e-5
    )


def test_lights_differ_and_are_positive():
    torch.manual_seed(0)
    made = Environment(CONFIG, 2)
    directions = torch.nn.functional.normalize(torch.randn(20, 3), dim=-1)
    first, second = made(directions, lights(directions)), made(directions, lights(directions, 1))
    assert not torch.allclose(first, second)
    assert min(first.min(), second.min()) > 0.0


def turned(direction: torch.Tensor, degrees: float) -> torch.Tensor:
    """Return directions turned by `degrees` about +z, counter-clockwise from above."""
    angle = math.radians(degrees)
    x, y, z = direction.unbind(dim=-1)
    cosine, sine = math.cos(angle), math.sin(angle)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y, z], dim=-1)


def test_rotated_lights_are_one_environment_turned_about_the_vertical():
    torch.manual_seed(0)
    made = Environment(CONFIG, 3, rotations_deg=(0.0, 120.0, 240.0))
    alone = Environment(CONFIG, 1)
    alone.load_state_dict(made.state_dict())
    assert made.num_lights == 1
    directions = torch.nn.functional.normalize(torch.randn(40, 3), dim=-1)
    for light, degrees in enumerate((0.0, 120.0, 240.0)):
        # What shone from d shines from the turned d: L_deg(d) = L_0(R_z(-deg) d).
        found = made(turned(directions, degrees), lights(directions, light))
        torch.testing.assert_close(found, alone(directions, lights(directions)), rtol=1e-4, atol=1e-5)


def test_the_picture_of_a_rotated_light_is_shifted_to_the_left_by_a_positive_angle():
    # Azimuth decreases to the right, so light turned counter-clockwise moves to the left.
    made = Environment(CONFIG, 2, rotations_deg=(0.0, 90.0), known=(0,))
    made.known_images[0, 4, 8] = 5.0
    first, second = (made.image(8, light).sum(dim=-1) for light in (0, 1))
    assert int(first.argmax()) % 16 - int(second.argmax()) % 16 == 4


def test_a_known_environment_is_what_was_given_and_has_no_gradient():
    made = Environment(CONFIG, 2, known=(1,))
    image = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))
    made.set_known(1, image)
    torch.testing.assert_close(made.image(8, 1), image, rtol=1e-4, atol=1e-4)
    assert made.learned == (0,)
    directions = environment_directions(6, 12).reshape(-1, 3).float()
    made(directions, lights(directions, 1)).sum().backward()
    assert all(p.grad is None or not p.grad.any() for p in made.parameters())
    made(directions, lights(directions, 0)).sum().backward()
    assert any(p.grad is not None and p.grad.any() for p in made.parameters())


def test_each_ray_gets_the_environment_of_its_light_given_or_learned():
    made = Environment(replace(CONFIG, known_height=4), 3, known=(2, 0))
    with torch.no_grad():
        made.head.weight.zero_()
    made.set_known(0, torch.full((4, 8, 3), 3.0))
    made.set_known(2, torch.full((4, 8, 3), 5.0))
    up = torch.tensor([[0.0, 0.0, 1.0]]).expand(3, 3)
    found = made(up, torch.tensor([0, 1, 2]))[:, 0]
    torch.testing.assert_close(found, torch.tensor([3.0, math.log(1.0 + math.exp(-1.0)), 5.0]))


def test_a_known_environment_serves_all_rotated_lights_and_is_kept_in_the_state():
    made, copy = (Environment(CONFIG, 2, rotations_deg=(0.0, 90.0), known=(0,)) for _ in range(2))
    image = torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(1))
    made.set_known(1, image)
    assert made.learned == ()
    copy.load_state_dict(made.state_dict())
    torch.testing.assert_close(copy.image(8, 1), image.roll(-4, dims=1), rtol=1e-4, atol=1e-4)


def test_a_texture_takes_the_networks_place_where_the_directions_say():
    torch.manual_seed(0)
    made = Environment(CONFIG, 2)
    side = 12
    texture = torch.rand(2, side * side, 3)
    made.set_texture(texture)
    centres = octahedral_directions(side)
    for light in (0, 1):
        # At the centres of cells their own values.
        torch.testing.assert_close(
            made(centres, lights(centres, light)), texture[light], rtol=1e-4, atol=1e-4
        )
    again = Environment(CONFIG, 2)
    again.load_state_dict(made.state_dict())
    torch.testing.assert_close(again(centres, lights(centres)), made(centres, lights(centres)))


def test_a_state_without_a_texture_is_read_as_before():
    torch.manual_seed(0)
    made, other = Environment(CONFIG, 1), Environment(CONFIG, 1)
    assert not any("texture" in name for name in made.state_dict())
    other.set_texture(torch.rand(1, 16, 3))
    other.load_state_dict(made.state_dict())
    assert other.texture is None
    flat = environment_directions(6, 12).float().reshape(-1, 3)
    torch.testing.assert_close(other(flat, lights(flat)), made(flat, lights(flat)))


def test_a_known_light_stays_what_was_given_beside_a_texture():
    made = Environment(CONFIG, 2, known=(1,))
    made.set_known(1, torch.rand(8, 16, 3))
    flat = environment_directions(6, 12).float().reshape(-1, 3)
    before = made(flat, lights(flat, 1))
    made.set_texture(torch.rand(2, 16, 3))
    torch.testing.assert_close(made(flat, lights(flat, 1)), before)

"""A grey card brings albedo and light to their true level, and says where it cannot."""

import copy

import pytest
import torch
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.evaluation.gbuffer import camera_rays
from flashcache.geometry.directions import normalize
from flashcache.geometry.octahedron import octahedral_directions
from flashcache.geometry.rays import Rays
from flashcache.polish import polish as whole
from flashcache.polish import write
from flashcache.polish.grey_card import (
    Card,
    GreyCardError,
    albedo_at,
    card_factor,
    card_points,
    scale_to_card,
    settle_by_card,
)
from support import lit_sphere
from support.sphere_model import RADIUS, sphere_model

OFF = torch.tensor([1.0, 0.7, 0.5])
SIZE = 0.08


def cap(count: int = 60, radius: float = 0.45) -> torch.Tensor:
    """Return points on the side of a ball that faces +x."""
    drawn = torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
    return radius * normalize(torch.cat([4.0 * drawn[:, :1].abs() + 1.0, drawn[:, 1:]], dim=-1))


def towards(points: torch.Tensor) -> Rays:
    """Return rays from a camera at (3, 0, 0) through points."""
    eye = torch.tensor([3.0, 0.0, 0.0]).expand_as(points)
    return Rays(
        eye, normalize(points - eye), torch.full((len(points),), 2.0), torch.full((len(points),), 4.0)
    )


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=("day", "night")).requires_grad_(False)


def test_a_card_brings_back_an_albedo_that_is_off_by_a_factor_per_channel():
    generator = torch.Generator().manual_seed(1)
    truth = 0.05 + 0.6 * torch.rand(50, 3, generator=generator)
    truth[:9] = 0.18
    sky = torch.rand(2, 16, 3, generator=generator)
    factor = card_factor((truth * OFF)[:9], 0.18)
    torch.testing.assert_close(factor, 1.0 / OFF)
    found = scale_to_card(truth * OFF, sky / OFF, factor)
    torch.testing.assert_close(found.albedo, truth)
    torch.testing.assert_close(found.sky, sky)
    assert (found.values["card_clamped"], found.findings) == (0.0, ())


def test_a_minority_of_pixels_that_show_something_else_does_not_matter():
    seen = torch.full((11, 3), 0.3)
    seen[:5] = torch.tensor([0.9, 0.01, 0.5])
    torch.testing.assert_close(card_factor(seen, 0.6), torch.full((3,), 2.0))


def test_albedo_and_light_change_together_so_that_diffuse_pictures_stay():
    albedo, sky, factor = torch.rand(5, 3), torch.rand(3, 4, 3), torch.tensor([0.9, 0.5, 0.7])
    found = scale_to_card(albedo, sky, factor)
    torch.testing.assert_close(
        found.albedo[:, None, None] * found.sky, albedo[:, None, None] * sky.expand(1, 3, 4, 3)
    )


def test_nothing_reflects_more_than_arrives_and_a_bright_surface_is_told():
    albedo = torch.full((10, 3), 0.2)
    albedo[0, 1] = 0.9
    found = scale_to_card(albedo, torch.ones(1, 4, 3), torch.full((3,), 2.0))
    assert float(found.albedo.max()) == 1.0
    assert found.values["card_clamped"] == pytest.approx(0.1)
    ((code, message),) = found.findings
    assert code == "grey_card.brighter_than_white"
    assert "10 %" in message
    assert found.values["card_clamped"] == pytest.approx(0.1)
    albedo[0, 1] = 0.2
    assert scale_to_card(albedo, torch.ones(1, 4, 3), torch.full((3,), 2.0)).findings == ()


@pytest.mark.parametrize(
    ("albedo", "code"),
    [
        (torch.full((3, 3), 0.2), "grey_card.not_on_surface"),
        (torch.full((9, 3), 0.017), "grey_card.factor_absurd"),
        (torch.tensor([[0.18, 0.18, 1.9]]).expand(9, 3), "grey_card.factor_absurd"),
        (torch.zeros(9, 3), "grey_card.factor_absurd"),
        (torch.full((9, 3), float("nan")), "grey_card.factor_absurd"),
    ],
    ids=["few", "dark", "one channel", "black", "not finite"],
)
def test_a_card_that_cannot_be_one_is_an_error_with_a_code(albedo, code):
    with pytest.raises(GreyCardError) as caught:
        card_factor(albedo, 0.18)
    assert caught.value.code == code


def test_the_cards_pixels_are_followed_to_the_surface(model):
    wanted = cap()
    points = card_points(model, towards(wanted))
    assert len(points) == len(wanted)
    assert float((points - wanted).norm(dim=-1).median()) < 0.03
    beside = towards(cap(radius=1.1))
    assert len(card_points(model, beside)) < 60
    nowhere = Rays(beside.origins, -beside.directions, beside.near, 0.5 * beside.near)
    assert len(card_points(model, nowhere)) == 0


def test_a_pixel_has_the_albedo_of_the_nearest_element_within_reach():
    positions, albedo = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), torch.tensor([[0.1] * 3, [0.2] * 3])
    points = torch.tensor([[0.9, 0.0, 0.0], [0.1, 0.0, 0.0], [0.5, 0.0, 0.0]])
    assert albedo_at(points, positions, 0.1, albedo)[:, 0].tolist() == pytest.approx([0.2, 0.1])
    assert len(albedo_at(points[:0], positions, 0.1, albedo)) == 0


def test_the_albedo_under_the_card_decides_and_not_the_albedo_elsewhere(model):
    front = cap(200)
    positions = torch.cat([front, -front])
    albedo = torch.cat([torch.full((200, 3), 0.18) * OFF, torch.full((200, 3), 0.4) * OFF])
    sky = torch.ones(2, 16, 3)
    found = settle_by_card(model, Card(towards(cap(30)), 0.18), positions, SIZE, albedo, sky)
    torch.testing.assert_close(found.albedo[200:], torch.full((200, 3), 0.4))
    torch.testing.assert_close(found.sky, sky * OFF)
    assert found.values["card_blue"] == pytest.approx(2.0)


def test_a_card_that_cannot_be_used_changes_nothing_and_becomes_a_finding(model):
    front = cap(200)
    albedo, sky = torch.full((200, 3), 0.004), torch.ones(2, 16, 3)
    found = settle_by_card(model, Card(towards(cap(30)), 0.18), front, SIZE, albedo, sky)
    assert torch.equal(found.albedo, albedo)
    assert torch.equal(found.sky, sky)
    ((code, message),) = found.findings
    assert code == "grey_card.factor_absurd"
    assert "not used" in message
    away = settle_by_card(model, Card(towards(cap(30)), 0.18), -front, SIZE, albedo, sky)
    assert away.findings[0][0] == "grey_card.not_on_surface"


def test_a_polish_with_a_card_ends_at_its_reflectance(monkeypatch):
    """On a ball whose upper half is the card."""
    monkeypatch.setattr(whole, "ROUNDS", 1)
    # The ball's stage two is random numbers: nothing of it should stay beside the elements.
    monkeypatch.setattr(write, "MOST_REST", 0.0)
    monkeypatch.setattr(lit_sphere, "RADIUS", 0.8 * RADIUS)
    scene = lit_sphere.lit_sphere(num_views=14, side=40)
    pixels = TrainingPixels(scene, PixelChoice(clipped="at_least"), torch.device("cpu"))
    before = sphere_model(lights=("sky",)).requires_grad_(False)
    rays = camera_rays(before, lit_sphere.camera(0.3, 0.5, side=40), torch.device("cpu"))
    # A block of pixels above the middle of the picture.
    middle = torch.tensor([row * 40 + column for row in range(14, 18) for column in range(18, 22)])
    reports, models = [], []
    for card in (None, Card(rays.select(middle), 0.15)):
        models.append(copy.deepcopy(before))
        reports.append(whole.polish(models[-1], pixels, seed=0, card=card))
    assert [report.kept for report in reports] == ["", ""]
    assert not any(report.findings for report in reports)
    factor = torch.tensor([reports[1].values[f"card_{name}"] for name in ("red", "green", "blue")])
    points = card_points(before, rays.select(middle))
    without, found = (each.materials(points).albedo.median(dim=0).values for each in models)
    assert float((without - 0.15).abs().max()) > 0.1
    torch.testing.assert_close(found, torch.full((3,), 0.15), rtol=0.0, atol=0.03)
    skies = [each.environment.image(8) for each in models]
    ratio = (skies[1] / skies[0]).mean(dim=(0, 1))
    torch.testing.assert_close(ratio * factor, torch.ones(3), rtol=0.2, atol=0.0)


@pytest.mark.slow
def test_all_learned_environments_take_the_cards_level(model):
    darker = copy.deepcopy(model)
    directions = octahedral_directions(24)
    index = torch.zeros(len(directions), dtype=torch.long)
    before = torch.stack([darker.environment(directions, index + light) for light in range(2)])
    factor = torch.tensor([0.5, 1.0, 2.0])
    darker.environment.set_texture(scale_to_card(torch.rand(4, 3), before, factor).sky)
    after = torch.stack([darker.environment(directions, index + light) for light in range(2)])
    torch.testing.assert_close((after / before).mean(dim=1), (1.0 / factor).expand(2, 3), rtol=0.05, atol=0.0)

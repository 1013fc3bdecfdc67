"""The fit of materials to surface elements, against sums over all directions."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.fields.materials import Materials
from flashcache.geometry.directions import normalize
from flashcache.geometry.octahedron import octahedral_directions, octahedral_solid_angles
from flashcache.polish import light
from flashcache.polish.fit import ALPHAS, NO_TILT, Tilts, costs, costs_of_some
from flashcache.polish.incoming import SIDE, IncomingTables
from flashcache.polish.light import Prediction, Reflectance, fit_light
from flashcache.polish.materials import choose
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.normals import tilted
from flashcache.polish.polish import FINER
from support.polish_sphere import open_tables, sky_picture, sphere_elements

FINE = SIDE * FINER
BLUE, GOLD = (0.1, 0.25, 0.6), (0.9, 0.6, 0.3)


def alone(elements, albedo, alpha, metalness):
    count = len(elements)
    return Reflectance(
        torch.tensor(albedo).expand(count, 3).clone(),
        torch.full((count,), alpha),
        torch.full((count,), metalness),
        elements.normal,
    )


@pytest.mark.parametrize("side", [4, 20])
def test_cells_of_the_square_cover_the_sphere(side):
    directions, angles = octahedral_directions(side), octahedral_solid_angles(side)
    assert float(angles.sum()) == pytest.approx(4.0 * math.pi, rel=1e-2 / side)
    assert torch.allclose(directions.norm(dim=-1), torch.ones(side * side), atol=1e-6)
    assert (angles[:, None] * directions).sum(dim=0).abs().max() < 1e-4
    # The second moment of a sphere is the same along all axes.
    moments = torch.einsum("n,ni,nj->ij", angles, directions, directions)
    assert torch.allclose(moments, 4.0 * math.pi / 3.0 * torch.eye(3), atol=12.0 / side**2)


@pytest.mark.parametrize(
    ("albedo", "alpha", "metalness"),
    [(BLUE, 0.5, 0.0), (BLUE, 0.16, 0.0), (GOLD, 0.28, 1.0), (GOLD, 0.5, 0.5)],
)
def test_a_prediction_is_the_sum_over_all_directions(albedo, alpha, metalness, monkeypatch):
    monkeypatch.setattr(light, "DIRECTIONS", 64)
    elements = sphere_elements(albedo, alpha, metalness, count=120)
    found = Prediction(elements, open_tables(len(elements)), alone(elements, albedo, alpha, metalness), FINE)(
        sky_picture().numpy()
    )
    error = torch.from_numpy(found) - elements.colour
    assert float(error.mean().abs() / elements.colour.mean()) < 0.02
    assert float(error.square().mean().sqrt() / elements.colour.mean()) < 0.1


@pytest.mark.parametrize("lights", [1, 2])
def test_the_gradient_by_the_sky_is_that_of_the_predictions(lights, monkeypatch):
    monkeypatch.setattr(light, "ROWS", 64)  # The sum has several parts, and the last one is not full.
    elements = sphere_elements(GOLD, 0.28, 0.5, count=40)
    elements = replace(elements, light=torch.arange(len(elements.colour)) % lights)
    tables = open_tables(len(elements))
    tables = replace(tables, near=tables.near.expand(lights, -1, -1, -1).contiguous())
    prediction = Prediction(elements, tables, alone(elements, GOLD, 0.28, 0.5), FINE)
    generator = torch.Generator().manual_seed(0)
    sky = sky_picture().repeat(lights, 1, 1).double().numpy()
    residual = torch.randn(elements.colour.shape, generator=generator, dtype=torch.float64).numpy()
    change = torch.randn(sky.shape, generator=generator, dtype=torch.float64).numpy()
    by_sum = ((prediction(sky + change) - prediction(sky)) * residual).sum()
    assert (prediction.gradient(residual) * change).sum() == pytest.approx(by_sum, rel=1e-4)


def test_every_observation_is_predicted_in_the_light_of_its_photograph():
    elements = sphere_elements(GOLD, 0.28, 0.5, count=40)
    reflectance, tables = alone(elements, GOLD, 0.28, 0.5), open_tables(len(elements))
    bright = Prediction(elements, tables, reflectance, FINE)(sky_picture().numpy())
    both = torch.cat([sky_picture(), 3.0 * sky_picture()]).numpy()
    second = torch.arange(len(elements.colour)) % 2
    mixed = Prediction(
        replace(elements, light=second),
        replace(tables, near=tables.near.expand(2, -1, -1, -1).contiguous()),
        reflectance,
        FINE,
    )(both)
    np.testing.assert_allclose(mixed, bright * (1.0 + 2.0 * second[:, None].numpy()), rtol=1e-5)


@pytest.mark.parametrize(("alpha", "metalness"), [(0.09, 0.0), (0.28, 0.0), (0.09, 1.0), (0.28, 1.0)])
def test_the_least_cost_is_at_the_material_that_was_photographed(alpha, metalness):
    albedo = GOLD if metalness else BLUE
    elements = sphere_elements(albedo, alpha, metalness)
    found = costs(elements, open_tables(len(elements)), sky_picture())
    mean = found.cost.mean(dim=0)
    level, hypothesis = divmod(int(mean.argmin()), 2)
    assert (level, hypothesis) == (ALPHAS.index(alpha), int(metalness))
    assert torch.allclose(
        found.albedo[:, level, hypothesis].median(dim=0).values, torch.tensor(albedo), atol=0.03
    )


def test_a_tilt_undoes_the_error_of_a_normal_and_costs_what_it_should():
    elements = sphere_elements(GOLD, 0.16, 1.0)
    tilts = Tilts.grid((-0.2, 0.0, 0.2), 0.005)
    moved = tilted(elements.normal, torch.tensor([[0.2, 0.0]]).expand(len(elements), 2))
    tables, sky, level = open_tables(len(elements)), sky_picture(), ALPHAS.index(0.16)
    wrong = costs(elements, tables, sky, normal=moved, tilts=NO_TILT)
    free = costs(elements, tables, sky, normal=moved, tilts=tilts)
    assert free.cost[:, level, 1].mean() < 0.3 * wrong.cost[:, level, 1].mean()
    chosen = tilted(moved, tilts.moves[free.tilt[:, level, 1]])
    before = (moved * elements.normal).sum(dim=-1).arccos()
    after = (chosen * elements.normal).sum(dim=-1).clamp(-1.0, 1.0).arccos()
    assert float(after.median()) < 0.3 * float(before.median())
    centre = int((tilts.moves.abs().sum(dim=1) == 0).nonzero()[0, 0])
    assert float(tilts.cost[centre]) == 0.0


def test_costs_that_are_known_are_not_needed_again():
    elements = sphere_elements(GOLD, 0.16, 1.0, count=60)
    tilts = Tilts.rings((0.18, 0.4), 0.005)
    tables, sky = open_tables(len(elements)), sky_picture()
    normal = tilted(elements.normal, torch.tensor([[0.2, 0.1]]).expand(len(elements), 2))
    untilted = costs(elements, tables, sky, normal=normal)
    known = untilted.copy()
    whole = costs(elements, tables, sky, normal=normal, tilts=tilts)
    found = costs(elements, tables, sky, normal=normal, tilts=tilts, untilted=untilted)
    for name in ("cost", "tilt", "albedo"):
        assert torch.equal(getattr(found, name), getattr(whole, name)), name
        assert torch.equal(getattr(untilted, name), getattr(known, name)), name
    assert (found.tilt > 0).any()
    assert (found.tilt == 0).any()

    some = torch.arange(len(elements)) % 3 == 0
    mixed = costs_of_some(some, elements, tables, sky, elements.normal, untilted)
    other = costs(elements, tables, sky, normal=elements.normal)
    assert torch.equal(mixed.cost[some], other.cost[some])
    assert torch.equal(mixed.albedo[some], other.albedo[some])
    assert torch.equal(mixed.cost[~some], untilted.cost[~some])
    assert not torch.equal(other.cost[~some], untilted.cost[~some])


def test_rings_of_tilts_are_even_and_begin_with_none():
    tilts = Tilts.rings((0.2, 0.4), 0.5)
    assert tilts.moves.shape == (13, 2)
    assert not tilts.moves[0].any()
    torch.testing.assert_close(tilts.moves.sum(dim=0), torch.zeros(2), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(tilts.moves.norm(dim=1)[1:], torch.tensor([0.2] * 6 + [0.4] * 6))
    torch.testing.assert_close(tilts.cost, 0.5 * tilts.moves.square().sum(dim=1))


def test_clipped_channels_are_only_known_to_be_at_least_so_bright():
    elements = sphere_elements(BLUE, 0.16, 0.0)
    limit = elements.colour.quantile(0.9)
    clipped = elements.colour > limit
    # dataclasses.replace, written out: colours are cut at the limit.
    known = type(elements)(
        *(
            {"colour": elements.colour.clamp_max(limit), "clipped": clipped}.get(
                name, getattr(elements, name)
            )
            for name in type(elements).__slots__
        )
    )
    ignored = type(elements)(
        *(
            {"clipped": torch.zeros_like(clipped)}.get(name, getattr(known, name))
            for name in type(known).__slots__
        )
    )
    tables, sky, level = open_tables(len(elements)), sky_picture(), ALPHAS.index(0.16)
    touched = torch.zeros(len(elements), dtype=torch.bool)
    touched[elements.element[clipped.any(dim=1)]] = True
    told, untold = (costs(each, tables, sky).cost[touched, level, 0].mean() for each in (known, ignored))
    assert told < 0.5 * untold


@pytest.mark.parametrize(("albedo", "alpha", "metalness"), [(BLUE, 0.09, 0.0), (GOLD, 0.16, 1.0)])
def test_gloss_and_metal_are_found_from_what_a_training_leaves(albedo, alpha, metalness):
    elements = sphere_elements(albedo, alpha, metalness, count=300)
    count = len(elements)
    trained = Materials(
        torch.tensor(albedo).expand(count, 3) * 0.8, torch.full((count, 1), 0.28), torch.full((count, 1), 0.1)
    )
    found = choose(
        elements, open_tables(count), sky_picture(), [elements.normal], trained, Neighbours.of(elements)
    )
    assert float((found.metalness - metalness).abs().mean()) < 0.1
    assert float(found.alpha.log().mean().exp()) == pytest.approx(alpha, rel=0.25)
    assert torch.isfinite(found.albedo).all()
    assert (found.normal * elements.normal).sum(dim=-1).mean() > 0.99


def test_the_light_is_found_from_a_dim_and_even_one():
    elements = sphere_elements(GOLD, 0.09, 1.0, count=600, views=12)
    prediction = Prediction(elements, open_tables(len(elements)), alone(elements, GOLD, 0.09, 1.0), FINE)
    true = sky_picture()
    begun = true.mean(dim=1, keepdim=True).expand_as(true).contiguous()
    found, before, after = fit_light(prediction, begun, steps=80, rate=0.15, outlier=0.05, tether=1e-4)
    assert after < 0.4 * before

    def error(sky):
        weight = octahedral_solid_angles(FINE)[:, None]
        return float((((sky[0] + 0.05).log() - (true[0] + 0.05).log()).square() * weight).sum())

    assert error(found) < 0.5 * error(begun)
    assert found.max() > 3.0 * begun.max()


def test_pooling_keeps_a_constant_and_the_two_sides_of_a_sheet_apart():
    elements = sphere_elements(BLUE, 0.28, 0.0, count=300)
    graph, amount = Neighbours.of(elements), elements.counts.float()
    constant = torch.full((len(elements), 2), 3.0)
    assert torch.allclose(graph.pooled(constant, amount, 5), constant, atol=1e-4)
    side = (elements.normal[:, 0] > 0.0).float()[:, None]
    apart = graph.among_alike(side, 1e-3).pooled(side, amount, 10)
    assert torch.allclose(apart, side, atol=1e-4)
    assert torch.allclose(normalize(elements.normal), elements.normal, atol=1e-5)


def test_what_is_hidden_sends_nothing_and_what_hides_it_does():
    elements = sphere_elements(GOLD, 0.28, 0.5, count=60)
    count, cells = len(elements), SIDE * SIDE
    material = alone(elements, GOLD, 0.28, 0.5)
    # Half of the sky is hidden by something that sends a third of what the sky does.
    hidden = octahedral_directions(SIDE)[:, 0] > 0.0
    clear = torch.ones(count, cells)
    clear[:, hidden] = 0.0
    near = torch.zeros(1, count, cells, 3)
    near[:, :, hidden] = 0.2
    even = torch.full((1, FINE * FINE, 3), 0.6).numpy()
    whole = Prediction(elements, open_tables(count), material, FINE)(even)
    part = Prediction(elements, IncomingTables(clear, near), material, FINE)(even)
    away = elements.normal[elements.element][:, 0] < -0.9
    towards = elements.normal[elements.element][:, 0] > 0.9
    assert part[towards].sum() == pytest.approx(whole[towards].sum() / 3.0, rel=0.1)
    assert part[away].sum() == pytest.approx(whole[away].sum(), rel=0.1)
    found = costs(elements, IncomingTables(clear, near), torch.from_numpy(even))
    seen = costs(elements, open_tables(count), torch.from_numpy(even))
    facing = elements.normal[:, 0] > 0.9
    level = ALPHAS.index(0.5)
    # The same photographs under a third of the light: three times the albedo, as far as it can be.
    ratio = found.albedo[facing, level, 0] / seen.albedo[facing, level, 0]
    free = found.albedo[facing, level, 0] < 0.99
    assert float(ratio[free].median()) == pytest.approx(3.0, rel=0.2)

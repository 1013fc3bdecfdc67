"""Confidence is as large as the scatter of refits, and follows what photographs tell about an element."""

from dataclasses import replace

import pytest
import torch
from flashcache.errors import TrainingError
from flashcache.evaluation.ambiguity import Priors
from flashcache.polish.confidence import FILE, REACH, Confidence, confidence_of, derivatives
from flashcache.polish.elements import Elements
from flashcache.polish.fit import NOISE_FLOOR
from flashcache.polish.incoming import SIDE
from flashcache.polish.light import Reflectance
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.polish import FINER
from support.polish_sphere import open_tables, sky_picture, sphere_elements
from torch import Tensor

CLAY, GOLD = (0.5, 0.4, 0.3), (0.9, 0.6, 0.3)
PRIORS = Priors()
EVEN = torch.full((1, (SIDE * FINER) ** 2, 3), 0.6)


def alone(elements: Elements, albedo: tuple[float, float, float], alpha: float, metal: float) -> Reflectance:
    count = len(elements)
    return Reflectance(
        torch.tensor(albedo).expand(count, 3).clone(),
        torch.full((count,), alpha),
        torch.full((count,), metal),
        elements.normal,
    )


def noisy(elements: Elements, noise: float, seed: int = 0) -> Elements:
    drawn = torch.randn(elements.colour.shape, generator=torch.Generator().manual_seed(seed))
    width = noise * (elements.colour + NOISE_FLOOR).sqrt()
    return replace(elements, colour=(elements.colour + width * drawn).clamp_min(0.0))


def measured(elements: Elements, *of: object, sky: Tensor | None = None) -> Confidence:
    return confidence_of(
        elements,
        open_tables(len(elements)),
        sky_picture() if sky is None else sky,
        alone(elements, *of),
        Neighbours.of(elements),
    )


def parts(found: Confidence) -> tuple[Tensor, ...]:
    return found.log_albedo, found.perceptual_roughness, found.metalness


@pytest.fixture(scope="module")
def glossy() -> Elements:
    return sphere_elements(CLAY, 0.16, 0.0, count=160, views=16)


def test_derivatives_are_those_of_the_prediction(glossy):
    """In the middle between dielectric and metal, where every term counts."""
    tables, given, step = open_tables(len(glossy)), alone(glossy, CLAY, 0.16, 0.5), 1e-3
    _, found = derivatives(glossy, tables, sky_picture(), given)

    def changed(**values: Tensor) -> Tensor:
        return derivatives(glossy, tables, sky_picture(), replace(given, **values))[0]

    for channel in range(3):
        factor = torch.ones(3)
        factor[channel] = 1.0 + step
        by = (changed(albedo=given.albedo * factor) - changed(albedo=given.albedo / factor)) / (2.0 * step)
        torch.testing.assert_close(found[:, :, channel], by, rtol=1e-2, atol=1e-3)
    by = (changed(metalness=given.metalness + step) - changed(metalness=given.metalness - step)) / (
        2.0 * step
    )
    torch.testing.assert_close(found[:, :, 3], by, rtol=1e-2, atol=1e-3)
    by = changed(alpha=given.alpha * 1.25) - changed(alpha=given.alpha * 0.75)
    by = by / (0.4 * (1.25**0.5 - 0.75**0.5))
    torch.testing.assert_close(found[:, :, 4], by, rtol=1e-2, atol=1e-3)


def test_more_observations_leave_less_open(glossy):
    whole = measured(noisy(glossy, 0.02), CLAY, 0.16, 0.0)
    some = noisy(glossy, 0.02).of(glossy.photograph % 4 < 2)
    fewer = measured(some, CLAY, 0.16, 0.0)
    for many, few in zip(parts(whole), parts(fewer), strict=True):
        assert float(many.mean()) < 0.9 * float(few.mean())


def test_noisier_photographs_leave_more_open(glossy):
    levels = [measured(noisy(glossy, noise), CLAY, 0.16, 0.0) for noise in (0.01, 0.03, 0.1)]
    for values in zip(*(parts(level) for level in levels), strict=True):
        means = [float(value.mean()) for value in values]
        assert means[0] < 0.9 * means[1] < 0.81 * means[2]


def test_gloss_is_known_under_a_lamp_and_not_where_nothing_shows_it():
    under_lamp = measured(sphere_elements(CLAY, 0.09, 0.0, views=12), CLAY, 0.09, 0.0)
    plain = sphere_elements(CLAY, 0.7, 0.0, views=12)
    seen, _ = derivatives(plain, open_tables(len(plain)), EVEN, alone(plain, CLAY, 0.7, 0.0))
    even = noisy(replace(plain, colour=seen.float()), 0.04)
    under_even = measured(even, CLAY, 0.7, 0.0, sky=EVEN)
    prior = PRIORS.perceptual_roughness
    assert float(under_even.perceptual_roughness.median()) > 0.9 * prior
    assert float(under_lamp.perceptual_roughness.median()) < 0.3 * prior


@pytest.mark.slow
@pytest.mark.parametrize(("albedo", "alpha", "metal"), [(CLAY, 0.16, 0.0), (GOLD, 0.28, 1.0)])
def test_refits_to_other_noise_scatter_as_much_as_confidence_says(albedo, alpha, metal):
    elements = sphere_elements(albedo, alpha, metal, count=160, views=16)
    tables, true = open_tables(len(elements)), alone(elements, albedo, alpha, metal)
    clean, _ = derivatives(elements, tables, sky_picture(), true)
    elements = replace(elements, colour=clean.float().clamp_min(0.0))
    prior = torch.diag(PRIORS.local(clean)[:5] ** -2)
    found, refits = [], []
    for seed in range(24):
        observed = noisy(elements, 0.015, seed)
        expected, jacobian = derivatives(observed, tables, sky_picture(), true)
        weight = 1.0 / (0.015**2 * (observed.colour.double() + NOISE_FLOOR))
        error = weight * (observed.colour - expected)
        per = [
            torch.zeros(len(elements), *values.shape[1:], dtype=torch.float64).index_add_(
                0, elements.element, values
            )
            for values in (
                jacobian.transpose(1, 2) @ (weight[..., None] * jacobian),
                (jacobian.transpose(1, 2) @ error[..., None])[..., 0],
            )
        ]
        refits.append(torch.linalg.solve(per[0] + prior, per[1]))
        found.append(measured(observed, albedo, alpha, metal).log_albedo)
    said = torch.stack(found).mean(dim=0)
    scatter = torch.stack(refits)[..., :3].std(dim=0).float()
    # Where priors say little: they do not scatter.
    told = said < 0.1
    assert float(told.float().mean()) > 0.2
    ratio = (said / scatter)[told]
    assert 0.5 < float(ratio.median()) < 2.0
    assert float(((ratio > 0.5) & (ratio < 2.0)).float().mean()) > 0.9


def test_black_and_clipped_things_keep_the_priors_widths(glossy):
    black = replace(glossy, colour=torch.zeros_like(glossy.colour))
    clipped = replace(glossy, clipped=torch.ones_like(glossy.clipped))
    unseen = glossy.of(torch.zeros(len(glossy.element), dtype=torch.bool))
    of_black = measured(black, (0.0, 0.0, 0.0), 0.5, 0.0)
    for value in parts(of_black):
        assert torch.isfinite(value).all()
    torch.testing.assert_close(of_black.log_albedo, torch.full_like(of_black.log_albedo, PRIORS.log_albedo))
    for nothing in (clipped, unseen):
        albedo, roughness, metal = parts(measured(nothing, CLAY, 0.16, 0.0))
        torch.testing.assert_close(albedo, torch.full_like(albedo, PRIORS.log_albedo))
        torch.testing.assert_close(roughness, torch.full_like(roughness, PRIORS.perceptual_roughness))
        torch.testing.assert_close(metal, torch.full_like(metal, PRIORS.metalness))


def test_what_says_nothing_of_gloss_and_metal_keeps_the_width_of_each(glossy):
    """The two widths differ here, so that neither can be taken for the other."""
    priors = Priors(metalness=0.1, perceptual_roughness=0.5)
    unseen = glossy.of(torch.zeros(len(glossy.element), dtype=torch.bool))
    found = confidence_of(
        unseen,
        open_tables(len(unseen)),
        sky_picture(),
        alone(unseen, CLAY, 0.16, 0.0),
        Neighbours.of(unseen),
        priors,
    )
    torch.testing.assert_close(found.metalness, torch.full_like(found.metalness, 0.1))
    torch.testing.assert_close(found.perceptual_roughness, torch.full_like(found.metalness, 0.5))


def test_as_many_observations_as_fitted_numbers_say_nothing_of_the_noise():
    """One photograph of each element: its three channels may have been met exactly."""
    once = noisy(sphere_elements(CLAY, 0.16, 0.0, count=160, views=16), 0.01)
    once = once.of(once.photograph == once.photograph.mode().values)
    rows = torch.bincount(once.element, minlength=len(once))
    assert int(rows.max()) == 1
    albedo, _, _ = parts(measured(once, CLAY, 0.16, 0.0))
    assert float(albedo[rows > 0].median()) > 0.9 * PRIORS.log_albedo


def some_confidence() -> Confidence:
    places = torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [5.0, 0.0, 0.0]])
    values = torch.tensor([0.1, 0.2, 0.3])
    return Confidence(places, 0.1, values[:, None].expand(3, 3), values, 2.0 * values)


def test_a_saved_confidence_is_the_loaded_one(tmp_path):
    before = some_confidence()
    before.save(tmp_path / FILE)
    after = Confidence.load(tmp_path / FILE)
    assert after.size == before.size
    for name in ("positions", "log_albedo", "perceptual_roughness", "metalness"):
        assert torch.equal(getattr(after, name), getattr(before, name))
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


@pytest.mark.parametrize("keep", [0.5, 0.0])
def test_a_damaged_file_says_what_to_do(tmp_path, keep):
    path = tmp_path / FILE
    some_confidence().save(path)
    path.write_bytes(path.read_bytes()[: int(keep * path.stat().st_size)])
    with pytest.raises(TrainingError, match="delete it"):
        Confidence.load(path)


def test_a_place_has_the_mean_of_the_elements_around_it_and_none_far_away():
    found = some_confidence()
    asked = torch.tensor(
        [[0.05, 0.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.99 * 0.1 * REACH, 0.0], [5.0, 1.01 * 0.1 * REACH, 0.0]]
    )
    there = found.at(asked)
    torch.testing.assert_close(there.metalness[0], torch.tensor(0.3))
    assert 0.1 < float(there.perceptual_roughness[1]) < 0.12
    torch.testing.assert_close(there.log_albedo[2], torch.full((3,), 0.3))
    assert all(bool(value[3].isnan().all()) for value in parts(there))
    assert all(bool(torch.isfinite(value[:3]).all()) for value in parts(there))


def test_an_element_of_one_is_found_too():
    one = some_confidence()
    one = Confidence(one.positions[:1], 0.1, one.log_albedo[:1], *(part[:1] for part in parts(one)[1:]))
    assert torch.isfinite(one.at(torch.zeros(2, 3)).metalness).all()

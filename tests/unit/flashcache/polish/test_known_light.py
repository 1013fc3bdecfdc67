"""A wrong light differs from a right one by more than the noise of the photographs, whatever that is."""

import math
from dataclasses import replace

import pytest
import torch
from flashcache.fields.materials import Materials
from flashcache.geometry.octahedron import octahedral_directions
from flashcache.polish.incoming import SIDE
from flashcache.polish.known_light import CODE, judge_by_elements, judge_known_light
from flashcache.polish.light import Prediction, Reflectance
from flashcache.polish.materials import choose
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.polish import FINER, _refitted
from support.polish_sphere import open_tables, radiance, sphere_elements

PLACES, EACH = 400, 4
PLACE = torch.arange(PLACES).repeat_interleave(EACH)


def drawn(seed: int, width: float = 1.0) -> torch.Tensor:
    return width * torch.randn(PLACES * EACH, 3, generator=torch.Generator().manual_seed(seed))


def truth() -> torch.Tensor:
    return 0.2 + 0.5 * torch.rand(PLACES * EACH, 3, generator=torch.Generator().manual_seed(0))


def judged(noise: float, wrong: float, *, model_error: float = 0.0, share: float = 1.0, **options):
    """Return the verdict on a light that is `wrong` by this relative error in a `share` of the places."""
    right = truth()
    observed = right + drawn(1, noise)
    # What shape and materials get wrong is the same under every light, and alike in all of a place.
    error = right * model_error * drawn(2)[PLACE * EACH]
    change = right * wrong * drawn(3)[PLACE * EACH] * (share * PLACES > PLACE)[:, None]
    return judge_known_light(observed, right + error + change, right + error, PLACE, **options)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
@pytest.mark.parametrize("model_error", [0.0, 0.05, 0.3])
def test_the_right_light_is_not_contradicted_however_bad_photographs_and_model_are(noise, model_error):
    verdict = judged(noise, 0.0, model_error=model_error)
    assert not verdict.contradicted
    assert verdict.findings == ()
    assert verdict.error == pytest.approx(1.0)


def test_a_light_that_adds_more_than_all_other_errors_is_contradicted():
    verdict = judged(0.02, 0.3)
    assert verdict.contradicted
    assert verdict.error > 3.0
    ((code, message),) = verdict.findings
    assert code == CODE
    assert f"{verdict.error:.1f} times" in message


def test_the_same_difference_is_nothing_where_the_model_is_worse_than_that():
    assert judged(0.01, 0.1).contradicted
    assert not judged(0.01, 0.1, model_error=0.2).contradicted
    assert not judged(0.15, 0.1).contradicted


def test_a_light_that_differs_by_less_than_a_step_of_a_photograph_is_right():
    assert not judged(0.0, 0.003).contradicted
    assert judged(0.0, 0.1).contradicted


def test_some_places_alone_contradict_nothing_but_a_third_does():
    assert not judged(0.02, 1.0, share=0.02).contradicted
    assert judged(0.02, 1.0, share=0.33).contradicted


def test_outliers_that_no_light_explains_do_not_hide_a_wrong_light_nor_make_one():
    right, gone = truth(), (PLACE % 10 == 0)[:, None]
    observed = torch.where(gone, 5.0 + drawn(1), right + drawn(1, 0.02))
    wrong = right * (1.0 + 0.3 * drawn(3)[PLACE * EACH])
    assert not judge_known_light(observed, right, right, PLACE).contradicted
    assert judge_known_light(observed, wrong, right, PLACE).contradicted


def test_a_handful_of_places_is_not_enough():
    few = PLACE < 6
    right = truth()[few]
    observed = right + drawn(1, 0.02)[few]
    wrong = right * (1.0 + 0.12 * drawn(3)[PLACE * EACH][few])
    verdict = judge_known_light(observed, wrong, right, PLACE[few])
    assert not verdict.contradicted
    assert verdict.sureness < 4.75
    none = judge_known_light(observed[:0], right[:0], right[:0], PLACE[:0])
    assert (none.contradicted, none.error) == (False, 1.0)


def test_neighbours_count_as_independent_only_up_to_a_number():
    """A light that is wrong in a twentieth of the places, which are many."""
    many = judged(0.02, 0.6, share=0.2)
    alike = judged(0.02, 0.6, share=0.2, independent=2.0)
    assert many.excess == alike.excess
    assert many.sureness == pytest.approx(10.0 * alike.sureness)
    assert many.contradicted
    assert not alike.contradicted


def test_what_a_free_light_explains_of_the_noise_is_given_back():
    right = truth()
    noise = drawn(1, 0.05)
    # As if a fit of three quarters as many numbers as there are values had taken its share of the noise.
    verdict = judge_known_light(
        right + noise, right, right + 0.5 * noise, PLACE, num_fitted=noise.numel() * 3 // 4
    )
    assert verdict.excess == pytest.approx(0.0, abs=0.02)
    assert judge_known_light(right + noise, right, right + 0.5 * noise, PLACE).contradicted


def test_a_clipped_channel_contradicts_no_brighter_light():
    right = truth()
    observed = right.clamp_max(0.4)
    clipped = right > 0.4
    brighter = torch.where(clipped, right * 3.0, right)
    assert not judge_known_light(observed, brighter, right, PLACE, clipped=clipped).contradicted
    assert judge_known_light(observed, brighter, observed, PLACE).contradicted
    darker = torch.where(clipped, 0.5 * observed, observed)
    assert judge_known_light(observed, darker, right, PLACE, clipped=clipped).contradicted


def turned(degrees: float):
    """Return the sky of the sphere turned about +z, in the square of the polish."""
    angle = math.radians(degrees)
    x, y, z = octahedral_directions(SIDE * FINER).unbind(dim=-1)
    back = torch.stack(
        [math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x, z], dim=-1
    )
    return radiance(back)[None].numpy()


@pytest.mark.parametrize("alpha", [0.2, 0.6])
def test_a_sphere_contradicts_a_sky_that_is_turned_and_not_its_own(alpha):
    elements = sphere_elements((0.5, 0.4, 0.3), alpha, 0.0, count=120, views=6)
    count = len(elements)
    reflectance = Reflectance(
        torch.tensor([[0.5, 0.4, 0.3]]).expand(count, 3),
        torch.full((count,), alpha),
        torch.zeros(count),
        elements.normal,
    )
    prediction = Prediction(elements, open_tables(count), reflectance, SIDE * FINER)
    own, by_90, by_2 = (torch.from_numpy(prediction(turned(angle))).float() for angle in (0.0, 90.0, 2.0))
    observed, place = elements.colour, elements.element
    assert not judge_known_light(observed, own, own, place).contradicted
    assert judge_known_light(observed, by_90, own, place).contradicted
    assert not judge_known_light(observed, by_2, own, place).contradicted


@pytest.fixture(scope="module")
def glossy():
    elements = sphere_elements((0.9, 0.6, 0.3), 0.2, 1.0, count=1200, views=10)
    noise = 0.01 * torch.randn(elements.colour.shape, generator=torch.Generator().manual_seed(0))
    return replace(elements, colour=(elements.colour + noise).clamp_min(0.0))


def by_elements(elements, degrees: float, level: float = 1.0, known: tuple[int, ...] = (0,)):
    """Return the verdict on a turned sky, as the polish asks for it; trained albedo is off by `level`."""
    count, sky = len(elements), torch.from_numpy(turned(degrees)).contiguous()
    trained = Materials(
        level * torch.tensor([[0.9, 0.6, 0.3]]).expand(count, 3),
        torch.full((count, 1), 0.28),
        torch.full((count, 1), 0.1),
    )
    tables, graph = open_tables(count), Neighbours.of(elements)
    found = choose(elements, tables, sky, [elements.normal], trained, graph)
    return judge_by_elements(
        elements,
        tables,
        sky,
        found,
        graph,
        known=known,
        refit=lambda prediction: _refitted(prediction, sky)[0],
    )


@pytest.mark.slow
def test_fitted_materials_do_not_take_in_that_the_map_is_turned(glossy):
    assert by_elements(glossy, 90.0).findings[0][0] == CODE
    assert not by_elements(glossy, 0.0).contradicted


@pytest.mark.long
@pytest.mark.slow
def test_an_error_of_all_albedo_is_not_one_of_the_light():
    dull = sphere_elements((0.5, 0.4, 0.3), 0.5, 0.0, count=1200, views=10)
    assert not by_elements(dull, 0.0, level=0.6).contradicted


@pytest.mark.slow
def test_only_photographs_in_a_known_light_speak_about_it(glossy):
    verdict = by_elements(replace(glossy, light=torch.zeros_like(glossy.light)), 90.0, known=(1,))
    assert (verdict.contradicted, verdict.error) == (False, 1.0)

"""Rounds of directions of a refined picture, and how many every pixel gets."""

import math

import numpy as np
import pytest
from lambent_relight.refined import sampling_plan
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.running import Running
from lambent_relight.refined.sampling_plan import MAX_FACTOR, costs_of, estimated, numbers_for, steps_for
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Radiance, split_samples
from lambent_relight.settings import settled
from support.statistics import assert_mean

EVERY = np.arange(2)
NO_SHARES = np.zeros((2, 2))


def radiance(value: float, error: float, num_samples: int, freedom: int = 1) -> Radiance:
    parts = [np.full((2, 3), value, np.float32) for _ in range(4)]
    return Radiance(*parts, np.full((2, 3), error, np.float32), num_samples, freedom, NO_SHARES)


def test_independent_rounds_are_combined_by_their_samples_and_get_quieter():
    both = Running.of(PixelRays.alone(2))
    both.add(radiance(1.0, 0.3, 30, 1), EVERY, EVERY)
    np.testing.assert_allclose(both.standard_error, 0.3, rtol=1e-6)
    both.add(radiance(2.0, 0.4, 10, 3), EVERY, EVERY)
    assert (both.num_samples == 40).all()
    assert (both.freedom == 4).all()
    for name in ("direct", "indirect", "specular", "visibility"):
        np.testing.assert_allclose(getattr(both, name), 0.75 * 1.0 + 0.25 * 2.0)
    # Variances of independent means add, with the squares of their shares.
    np.testing.assert_allclose(both.standard_error, np.hypot(0.75 * 0.3, 0.25 * 0.4), rtol=1e-6)


def test_a_round_of_some_pixels_leaves_the_others_as_they_are():
    pixels = PixelRays(np.array([0, 0, 1, 2, 2]), np.array([[0.5], [0.5], [1.0], [0.5], [0.5]]))
    total = Running.of(pixels)
    first = (np.full((5, 3), 1.0, np.float32) for _ in range(4))
    total.add(Radiance(*first, np.full((3, 3), 0.3, np.float32), 4, 1, NO_SHARES), np.arange(3), np.arange(5))
    chosen, points, rays = pixels.chosen(np.array([True, False, True]))
    np.testing.assert_array_equal(chosen, [0, 2])
    np.testing.assert_array_equal(points, [0, 1, 3, 4])
    np.testing.assert_array_equal(rays.pixel, [0, 0, 1, 1])
    np.testing.assert_array_equal(rays.first, [0, 2])
    part = Radiance(
        *(np.full((4, 3), 3.0, np.float32) for _ in range(4)),
        np.full((2, 3), 0.1, np.float32),
        12,
        2,
        NO_SHARES,
    )
    total.add(part, chosen, points)
    np.testing.assert_array_equal(total.num_samples, [16, 4, 16])
    np.testing.assert_array_equal(total.freedom, [3, 1, 3])
    np.testing.assert_allclose(total.direct[:, 0], [2.5, 2.5, 1.0, 2.5, 2.5])
    np.testing.assert_allclose(total.standard_error[1], 0.3, rtol=1e-6)
    assert total.mean_samples == 12


def test_the_relative_error_of_few_passes_is_not_too_small_on_average():
    rng, pixels = np.random.default_rng(5), PixelRays.alone(40)
    every = np.arange(40)
    for passes in (2, 8):
        values = rng.normal(10.0, 3.0, (2000, passes, 40, 3))
        errors = values.std(axis=1, ddof=1) / np.sqrt(passes)
        flat, found = np.full((40, 3), 5.0, np.float32), []
        for error in errors:
            total = Running.of(pixels)
            total.add(
                Radiance(flat, flat, flat, flat, error.astype(np.float32), 4, passes - 1, NO_SHARES),
                every,
                every,
            )
            found.append(total.relative_error())
        assert_mean(np.array(found)[:, None], np.array([0.3 / np.sqrt(passes)]))


def test_nothing_seen_has_no_error_and_no_directions():
    total = Running.of(PixelRays.alone(0))
    assert (total.relative_error(), total.mean_samples) == (0.0, 0)


@pytest.mark.parametrize("seed", range(3))
def test_no_other_numbers_of_directions_reach_an_error_with_less_work(seed):
    rng = np.random.default_rng(seed)
    spread = rng.lognormal(0.0, 1.0, 200)
    spent = np.full(200, 2)
    number = numbers_for(spread, spent, 0.1, 10_000)
    assert (spread / np.sqrt(number)).mean() == pytest.approx(0.1, rel=1e-3)
    # Moving work between pixels, keeping the sum, makes the mean error larger.
    for _ in range(20):
        moved = number * np.exp(0.2 * rng.normal(size=200))
        moved = 2.0 + (moved - 2.0) * (number - 2.0).sum() / (moved - 2.0).sum()
        assert (spread / np.sqrt(moved)).mean() > 0.1 * (1.0 + 1e-4)
    # As many for all would be more work.
    assert number.sum() < 0.9 * 200 * (spread.mean() / 0.1) ** 2


def test_numbers_of_directions_never_fall_and_end_at_a_limit():
    spread, spent = np.array([0.0, 1.0, 100.0]), np.array([10, 4, 4])
    number = numbers_for(spread, spent, 1e-6, 256)
    np.testing.assert_allclose(number[1:], 256.0)
    assert number[0] >= 10
    np.testing.assert_allclose(numbers_for(spread, spent, 1e3, 256), spent)


def test_neighbours_say_how_noisy_a_pixel_is():
    pixels = PixelRays.alone(100)
    total, every = Running.of(pixels), np.arange(100)
    rng = np.random.default_rng(0)
    true = np.where(every < 50, 1.0, 4.0)[:, None]
    error = true * np.abs(rng.normal(size=(100, 3))) / np.sqrt(16.0)
    flat = np.ones((100, 3), np.float32)
    total.add(Radiance(flat, flat, flat, flat, error.astype(np.float32), 16, 1, NO_SHARES), every, every)
    own = (np.sqrt(16.0) * error).mean(axis=1)
    apart = np.r_[0:40, 60:100]
    found = np.abs(total.spread() / true[:, 0] - 1.0)[apart].mean()
    assert found < 0.5 * np.abs(own / true[:, 0] - 1.0)[apart].mean()


@pytest.mark.parametrize("per_ray", [2, 5, 9, 16, 50])
def test_a_round_ends_at_the_limit_where_the_nearest_length_would_not(per_ray: int):
    costs = costs_of(per_ray, 4)
    spent = np.arange(1, MAX_FACTOR + 1) * per_ray
    lacking = MAX_FACTOR * per_ray - spent
    room = np.searchsorted(costs, lacking, side="right")
    steps = steps_for(lacking / per_ray, spent / per_ray, room)
    assert (spent + steps * per_ray <= MAX_FACTOR * per_ray).all()
    # Whoever has room for a first round gets one at least.
    assert (steps[lacking >= costs[0]] > 0).all()


@pytest.mark.parametrize(("spp", "rays"), [(2, 1), (9, 1), (14, 1), (16, 4), (50, 1)])
def test_no_pixel_gets_more_than_64_times_the_first_round_and_those_that_lack_them_do(
    monkeypatch, spp: int, rays: int
):
    count = 400
    pixels = PixelRays(np.repeat(np.arange(count), rays), np.full((count * rays, 1), 1.0 / rays))
    noise = np.geomspace(1e-3, 30.0, count)
    rng = np.random.default_rng(spp)

    def noisy(points, *_, num_samples: int, pixels: PixelRays, **__) -> Radiance:
        passes, length = split_samples(num_samples, pixels.most)
        spread = noise[points.position[pixels.first, 0].astype(int)]
        of_passes = spread[:, None] * rng.normal(size=(len(spread), passes)) / np.sqrt(length)
        error = np.repeat(of_passes.std(axis=1, ddof=1)[:, None] / np.sqrt(passes), 3, axis=1)
        flat = np.full((len(points.position), 3), 0.5, np.float32)
        shares = np.zeros((2, len(spread)))
        return Radiance(flat, flat, flat, flat, error.astype(np.float32), passes * length, passes - 1, shares)

    monkeypatch.setattr(sampling_plan, "outgoing_radiance", noisy)
    place = np.repeat(np.arange(count, dtype=np.float32)[:, None], rays, axis=0)
    points = SurfacePoints(place, place, place, place)
    settings = settled(spp=spp, antialias=1, until_stderr=1e-3)
    found = estimated(points, pixels, None, settings, None)
    first = math.prod(split_samples(max(2, spp), rays))
    most = MAX_FACTOR * first
    assert found.num_samples.max() <= most
    # Nothing shorter than a first round is left to give.
    assert found.num_samples[-40:].min() > most - 2 * first


def test_no_two_rounds_draw_the_same_directions(monkeypatch):
    """With one seed the stated error would fall with every repeat, and the true one would not."""
    seeds = []

    def noisy(points, *_, num_samples, seed, pixels, **__):
        seeds.append(seed)
        count = len(pixels.first)
        flat, error = np.full((count, 3), 0.5, np.float32), np.full((count, 3), 0.5, np.float32)
        return Radiance(flat, flat, flat, flat, error, num_samples, 1, np.zeros((2, count)))

    monkeypatch.setattr(sampling_plan, "outgoing_radiance", noisy)
    place = np.zeros((8, 3), np.float32)
    points = SurfacePoints(place, place, place, place)
    settings = settled(spp=4, antialias=1, until_stderr=1e-2, seed=5)
    estimated(points, PixelRays.alone(8), None, settings, None)
    assert len(seeds) > 2
    assert len(set(seeds)) == len(seeds)
    assert seeds[0] == 5

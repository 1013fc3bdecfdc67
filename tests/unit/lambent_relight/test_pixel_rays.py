"""The rays of a pixel share one even sequence of uniform elements, independent of those of other pixels."""

import numpy as np
import pytest
from lambent_relight.refined.pixel_rays import PixelRays
from support.statistics import assert_mean


def rays_of(counts: list[int]) -> PixelRays:
    """Return pixels with so many rays each, in places with gaps, the later rays weighing more."""
    place = np.repeat(7 * np.arange(len(counts)) + 3, counts)
    weight = np.concatenate([np.arange(1.0, count + 1.0) for count in counts])[:, None]
    return PixelRays.of(place, weight)


def occupied(places: np.ndarray, columns: int, rows: int) -> int:
    """Return how many cells of a grid over the unit square hold one of `places` [n, 2]."""
    cell = np.floor(places * [columns, rows]).astype(int)
    return len(np.unique(cell[:, 0] * rows + cell[:, 1]))


@pytest.mark.parametrize("columns", [1, 2, 4, 8, 16, 32, 64])
def test_the_rays_of_a_pixel_fill_the_square_together_and_each_by_itself(columns):
    u = rays_of([4, 4, 4]).uniforms(16, np.random.default_rng(1)).reshape(3, 4, 16, 3)
    for pixel in u:
        assert occupied(pixel[..., 1:].reshape(64, 2), columns, 64 // columns) == 64
        if columns <= 16:
            assert [occupied(ray[:, 1:], columns, 16 // columns) for ray in pixel] == 4 * [16]


def test_strategies_get_their_share_in_every_pixel_and_every_ray():
    u = rays_of([4] * 50).uniforms(8, np.random.default_rng(2))[:, 0].reshape(50, 4, 8)
    for share in (0.25, 0.375, 0.5):
        np.testing.assert_array_equal((u < share).sum(axis=-1), 8 * share)


def test_rays_take_consecutive_elements_of_one_sequence():
    together = rays_of([4]).uniforms(8, np.random.default_rng(3))
    alone = rays_of([1]).uniforms(32, np.random.default_rng(3))
    np.testing.assert_array_equal(together, alone)


def test_every_element_is_uniform_and_no_pixel_depends_on_its_neighbour():
    count = 20000
    u = PixelRays.alone(count).uniforms(3, np.random.default_rng(4)).reshape(count, 3, 3)
    values = np.concatenate([u.reshape(count, 9), u.reshape(count, 9) ** 2, np.roll(u, 1, 0) * u], axis=None)
    moments = np.concatenate(
        [np.full(9 * count, 1 / 2), np.full(9 * count, 1 / 3), np.full(9 * count, 1 / 4)]
    )
    assert_mean((values - moments).reshape(3, count, 9).transpose(1, 0, 2).reshape(count, 27), np.zeros(27))
    # Coordinates of one element are independent, too.
    assert_mean((u * np.roll(u, 1, axis=2)).reshape(count, 9), np.full(9, 1 / 4))
    # Sixteen strata of a coordinate: the digits that follow the first are scrambled as well.
    strata = np.eye(16)[np.floor(16 * u[:, 1, :]).astype(int)].reshape(count, 48)
    assert_mean(strata, np.full(48, 1 / 16))


def test_the_mean_of_a_pixel_is_that_of_its_rays_by_weight():
    pixels = rays_of([1, 3, 2])
    assert pixels.pixel.tolist() == [0, 1, 1, 1, 2, 2]
    assert pixels.first.tolist() == [0, 1, 4]
    assert pixels.most == 3
    values = np.array([[5.0], [1.0], [2.0], [3.0], [1.0], [4.0]])
    np.testing.assert_allclose(pixels.mean(values)[:, 0], [5.0, 14.0 / 6.0, 3.0])


@pytest.mark.parametrize("most_points", [0, 1, 5, 8, 1000])
def test_parts_hold_whole_pixels_and_all_of_them(most_points):
    counts = [4, 1, 3, 4, 4, 2, 4, 4]
    pixels = rays_of(counts)
    parts = pixels.parts(most_points)
    assert [run.start for run, _ in parts] == [0, *(run.stop for run, _ in parts[:-1])]
    assert parts[-1][0].stop == sum(counts)
    assert np.concatenate([np.bincount(rays.pixel) for _, rays in parts]).tolist() == counts
    assert all(rays.pixel[0] == 0 and run.stop - run.start <= most_points + 4 for run, rays in parts)
    np.testing.assert_array_equal(np.concatenate([rays.share for _, rays in parts]), pixels.share)


def test_a_picture_of_nothing_has_no_parts():
    nothing = PixelRays.of(np.zeros(0, int), np.zeros((0, 1)))
    assert nothing.parts(10) == []
    assert nothing.most == 1
    assert nothing.mean(np.zeros((0, 3))).shape == (0, 3)

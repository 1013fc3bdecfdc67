import numpy as np
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.shading import Radiance
from support.statistics import assert_mean


def radiance(value: float, error: float, num_samples: int, freedom: int = 1) -> Radiance:
    parts = [np.full((2, 3), value, np.float32) for _ in range(4)]
    return Radiance(*parts, np.full((2, 3), error, np.float32), num_samples, freedom)


def test_independent_estimates_are_combined_by_their_samples_and_get_quieter():
    both = radiance(1.0, 0.3, 30, 1).combined(radiance(2.0, 0.4, 10, 3))
    assert both.num_samples == 40
    assert both.freedom == 4
    np.testing.assert_allclose(both.direct, 0.75 * 1.0 + 0.25 * 2.0)
    # Variances of independent means add, with the squares of their shares.
    np.testing.assert_allclose(both.standard_error, np.hypot(0.75 * 0.3, 0.25 * 0.4), rtol=1e-6)


def test_the_relative_error_of_few_passes_is_not_too_small_on_average():
    rng, pixels = np.random.default_rng(5), PixelRays.alone(40)
    for passes in (2, 8):
        values = rng.normal(10.0, 3.0, (2000, passes, 40, 3))
        errors = values.std(axis=1, ddof=1) / np.sqrt(passes)
        flat = np.full((40, 3), 5.0, np.float32)
        found = [
            Radiance(flat, flat, flat, flat, error.astype(np.float32), 4, passes - 1).relative_error(pixels)
            for error in errors
        ]
        assert_mean(np.array(found)[:, None], np.array([0.3 / np.sqrt(passes)]))


def test_nothing_seen_has_no_error():
    empty = np.zeros((0, 3), np.float32)
    assert Radiance(*5 * (empty,), 4, 1).relative_error(PixelRays.alone(0)) == 0.0

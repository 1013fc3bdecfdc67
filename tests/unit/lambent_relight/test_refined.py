import numpy as np
from lambent_relight.refined.shading import Radiance


def radiance(value: float, error: float, num_samples: int) -> Radiance:
    parts = [np.full((2, 3), value, np.float32) for _ in range(4)]
    return Radiance(*parts, np.full((2, 3), error, np.float32), num_samples)


def test_independent_estimates_are_combined_by_their_samples_and_get_quieter():
    both = radiance(1.0, 0.3, 30).combined(radiance(2.0, 0.4, 10))
    assert both.num_samples == 40
    np.testing.assert_allclose(both.direct, 0.75 * 1.0 + 0.25 * 2.0)
    # Variances of independent means add, with the squares of their shares.
    np.testing.assert_allclose(both.standard_error, np.hypot(0.75 * 0.3, 0.25 * 0.4), rtol=1e-6)

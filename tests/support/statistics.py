"""Statistical assertions, so that Monte Carlo claims are tested without hand-picked tolerances."""

import numpy as np
from scipy import stats

FALSE_ALARM = 1e-6
"""Probability that a true statement fails, per call."""


def assert_mean(samples, expected, *, expected_error: float = 0.0, false_alarm: float = FALSE_ALARM) -> None:
    """Assert that independent `samples` [n, ...] have the mean `expected` [...].

    A two-sided t-test per element; the Sidak correction makes the probability of a false alarm `false_alarm`
    for the whole call. `expected_error` bounds the absolute error of `expected` itself (that of a
    quadrature). Use a fixed seed, so that a failure can be looked at.
    """
    values = np.asarray(_numpy(samples), dtype=np.float64)
    target = np.asarray(_numpy(expected), dtype=np.float64)
    count = values.shape[0]
    assert count >= 30, f"{count} samples are too few for a test of their mean"
    assert np.isfinite(values).all(), f"{(~np.isfinite(values)).sum()} samples are not finite"
    mean = values.mean(axis=0)
    np.broadcast_shapes(mean.shape, target.shape)
    rounding = 64.0 * np.finfo(np.float32 if _is_single(samples) else np.float64).eps
    standard_error = values.std(axis=0, ddof=1) / np.sqrt(count)
    standard_error = standard_error + rounding * np.maximum(np.abs(mean), np.abs(target))
    per_element = -np.expm1(np.log1p(-false_alarm) / mean.size)
    limit = stats.t.isf(per_element / 2.0, count - 1)
    excess = np.maximum(np.abs(mean - target) - expected_error, 0.0)
    score = excess / np.maximum(standard_error, np.finfo(np.float64).tiny)
    worst = np.unravel_index(np.argmax(score), score.shape)
    assert score[worst] <= limit, (
        f"mean {mean[worst]:.6g} is not {np.broadcast_to(target, mean.shape)[worst]:.6g}: {score[worst]:.1f} "
        f"standard errors of {standard_error[worst]:.2g}, at most {limit:.1f} allowed (element {worst}, "
        f"{count} samples)"
    )


def _numpy(values):
    return values.detach().cpu().numpy() if hasattr(values, "detach") else values


def _is_single(values) -> bool:
    return str(getattr(values, "dtype", "")).endswith("float32")

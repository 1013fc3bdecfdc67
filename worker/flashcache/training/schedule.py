"""Learning rates and loss weights as functions of the training fraction."""

import math


def ramp(fraction: float, start: float, end: float) -> float:
    """Return 0 before `start`, 1 after `end`, linear between; a step where they coincide."""
    if fraction >= end:
        return 1.0
    return 0.0 if fraction <= start else (fraction - start) / (end - start)


def rate_factor(
    step: int,
    num_steps: int,
    warmup_steps: int,
    final_rate: float,
    decay_from: float = 0.0,
    *,
    linear: bool = False,
) -> float:
    """Return the learning rate as a share of its peak.

    A sine ramp over `warmup_steps`, times a fall to `final_rate`: a log-linear one that begins after the
    share `decay_from` of the steps, or a `linear` one that begins when the ramp ends (supplement 2.4, which
    does not say how the rate rises).
    """
    warm = math.sin(0.5 * math.pi * min(1.0, (step + 1) / warmup_steps)) if warmup_steps else 1.0
    if linear:
        return warm * (1.0 - (1.0 - final_rate) * ramp(step / num_steps, warmup_steps / num_steps, 1.0))
    return warm * final_rate ** ramp(step / num_steps, decay_from, 1.0)


def proposal_exponent(fraction: float, largest: float) -> float:
    """Return the exponent that flattens proposal weights early in training (Mip-NeRF 360 annealing)."""
    return min(10.0 * fraction / (9.0 * fraction + 1.0), largest)

"""Albedo brought to what photographs show, by rendered pixels.

The fit predicts pixels from tables at the elements. A picture is shaded at places along a ray, with what
networks hold there and light from all directions: for the same materials it is darker or brighter.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.polish.elements import Elements
from flashcache.polish.fit import NOISE_FLOOR, OUTLIER
from flashcache.polish.light import Reflectance
from flashcache.polish.materials import encoded
from flashcache.polish.neighbours import Neighbours

MOST_PIXELS = 24_000
WIDTH = 0.1
"""Difference of encoded albedo over which neighbours share a correction."""
STEPS = 2
"""Steps along the graph over which they do."""
MOST = 1.5
"""Largest factor."""
DOUBT = 0.02
"""Squared radiance that is added to both sides: dark pixels say little."""


def corrected_albedo(
    render: Callable[[Int[Tensor, " some"], int], Float[Tensor, "some 3"]],
    elements: Elements,
    fitted: Reflectance,
    neighbours: Neighbours,
    seed: int,
) -> Reflectance:
    """Return `fitted` with its albedo times what pixels show over what is rendered of them.

    `render` returns the radiance of training pixels by the model that has learned `fitted`, with random
    numbers of their own for every repeat. The factor per channel is that of least squares over an element and
    those around it with similar albedo, weighted like the observations of the fit. Channels that are known to
    be at least so bright do not lower it. At most `MOST`, and near 1 where little light arrives.
    """
    generator = torch.Generator().manual_seed(seed)
    some = torch.randperm(len(elements.pixel), generator=generator)[:MOST_PIXELS].sort().values
    # Of two independent estimates: the square of one alone would be too large by its variance.
    one, other = (render(elements.pixel[some], repeat) for repeat in range(2))
    mean, measured = 0.5 * (one + other), elements.colour[some]
    lit = ~(elements.clipped[some] & (mean > measured))
    squared = ((mean - measured).square() / (measured + NOISE_FLOOR)).sum(dim=1, keepdim=True)
    weight = lit / (measured + NOISE_FLOOR) / (1.0 + squared / OUTLIER**2)
    element = elements.element[some]

    def summed(values: Tensor) -> Tensor:
        return torch.zeros(len(elements), 3).index_add_(0, element, values)

    both = torch.cat([summed(weight * mean * measured), summed(weight * one * other)], dim=1)
    alike = neighbours.among_alike(encoded(fitted.albedo), WIDTH)
    both = alike.pooled(both, torch.ones(len(elements)), STEPS)
    factor = ((both[:, :3] + DOUBT) / (both[:, 3:].clamp_min(0.0) + DOUBT)).clamp(1.0 / MOST, MOST)
    albedo = (fitted.albedo * factor).clamp(0.0, 1.0)
    return replace(fitted, albedo=albedo)

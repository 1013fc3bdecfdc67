"""Indirect light that the diffuse lobe reflects, where it is known without following rays.

What rays find of it may go against the noise of direct light: a ray that something is in the way of brings
the one and not the other. So its mean is a control variate, and as much of it is taken as makes least noise:

    direct + share * found + (1 - share) * known.

The share is one number for a whole picture, the regression over all pixels and passes, so that it hardly
depends on any pixel's own noise. Source: Glasserman, Monte Carlo Methods in Financial Engineering, 4.1.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_MOST_SHARE = 1.5
"""Beyond 1, what rays find too much of the known part makes up for what they find too little of the rest."""
_LEAST = 1e-3
"""Radiance below this share of the picture's mean weighs no more than this, in the regression."""


@dataclass(frozen=True)
class KnownBounce:
    """What points reflect diffusely of the light that comes from other surfaces."""

    radiance: NDArray[np.float32]
    """[point, 3]; zero where it is not known."""
    known: NDArray[np.bool_]
    """Whether it is known; rays find it elsewhere, [point]."""

    @classmethod
    def nothing(cls, count: int) -> "KnownBounce":
        """Return `count` points of which nothing is known."""
        return cls(np.zeros((count, 3), np.float32), np.zeros(count, np.bool_))

    def __getitem__(self, index: object) -> "KnownBounce":
        """Return some of the points."""
        return KnownBounce(self.radiance[index], self.known[index])


@dataclass(frozen=True)
class Spread:
    """Sums over independent passes of what rays find at every pixel, for their variances, [pixel, 3] each."""

    passes: NDArray[np.int64]
    """[pixel, 1]."""
    rest: NDArray[np.float64]
    """Everything but the known part."""
    found: NDArray[np.float64]
    """What rays find of the known part."""
    rest_squared: NDArray[np.float64]
    found_squared: NDArray[np.float64]
    product: NDArray[np.float64]

    @classmethod
    def of(cls, count: int) -> "Spread":
        """Return the sums of no passes of `count` pixels."""
        return cls(np.zeros((count, 1), np.int64), *np.zeros((5, count, 3)))

    def add(self, where: slice, rest: NDArray[np.float64], found: NDArray[np.float64]) -> None:
        """Add a pass of some pixels."""
        self.passes[where] += 1
        self.rest[where] += rest
        self.found[where] += found
        self.rest_squared[where] += rest**2
        self.found_squared[where] += found**2
        self.product[where] += rest * found

    def best_share(self, mean: NDArray[np.float64]) -> float:
        """Return the share of what rays find that makes least noise, relative to pixels of this `mean`."""
        weight = 1.0 / np.maximum(mean, _LEAST * mean.mean()) ** 2 if mean.any() else np.ones_like(mean)
        found = float((weight * self._variance(self.found_squared, self.found, self.found)).sum())
        both = float((weight * self._variance(self.product, self.rest, self.found)).sum())
        return min(max(-both / found, 0.0), _MOST_SHARE) if found > 0.0 else 0.0

    def variance(self, share: float) -> NDArray[np.float64]:
        """Return the variance of the mean over the passes with this share of what rays find."""
        squared = self.rest_squared + share * (2.0 * self.product + share * self.found_squared)
        whole = self.rest + share * self.found
        return np.maximum(self._variance(squared, whole, whole), 0.0)

    def _variance(
        self, product: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the covariance of two means over the passes, from the sum of their products and theirs."""
        count = self.passes
        return (product / count - first * second / count**2) / (count - 1)

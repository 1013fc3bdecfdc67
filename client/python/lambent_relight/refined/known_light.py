"""Parts of the light that are known beforehand, as control variates of what rays find.

Two parts of what the diffuse lobe reflects are baked: light from other surfaces, and the sky through shadow
bits (`known_sky`). Rays find both too, and

    rest + found + (share_1 - 1) (found_1 - known_1) - share_2 (found_2 - known_2)

has the same mean for any shares, as far as the first is known exactly (the second is). What rays find of
light from surfaces goes against the noise of direct light: a ray that something is in the way of brings the
one and not the other. So neither all nor nothing of it is best. The shares are those with least noise around
a pixel: a regression over the passes of its neighbours and, for a part, of all pixels. It leaves the pixel
itself out, so that the shares are independent of its noise, but for the part of all pixels. Source:
Glasserman, Monte Carlo Methods in Financial Engineering, 4.1.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight.brdf import RowIndex
from lambent_relight.refined.known_sky import KnownSky

_MOST_SHARE = 1.5
"""Beyond 1, what rays find too much of the known part makes up for what they find too little of the rest."""
_LEAST = 1e-3
"""Radiance below this share of the picture's mean weighs no more than this, in the regression."""
_REACH = 6
"""Pixels to either side, in the order of the pixels, that say which shares are best."""
_PRIOR = 3.0
"""Weight of all pixels together in that, in pixels."""
_TURNS = 12
PARTS = 3
"""All but the light from surfaces that is known, what rays find of that, and of the known sky."""

Shares = NDArray[np.float64]
"""Two of every pixel, [2, pixel]."""


@dataclass(frozen=True)
class KnownLight:
    """What points reflect diffusely of light that is known."""

    radiance: NDArray[np.float32]
    """From other surfaces, [point, 3]; zero where it is not known."""
    known: NDArray[np.bool_]
    """Whether that is known; rays find it elsewhere, [point]."""
    sky: KnownSky | None = None
    """Of the sky, where there are shadow bits."""

    @classmethod
    def nothing(cls, count: int) -> "KnownLight":
        """Return `count` points of which nothing is known."""
        return cls(np.zeros((count, 3), np.float32), np.zeros(count, np.bool_))

    def __getitem__(self, index: RowIndex) -> "KnownLight":
        """Return some of the points."""
        sky = None if self.sky is None else self.sky[index]
        return KnownLight(self.radiance[index], self.known[index], sky)


@dataclass(frozen=True)
class Spread:
    """Sums over independent passes of the parts at every pixel, for their variances."""

    passes: NDArray[np.int64]
    """[pixel, 1]."""
    sums: NDArray[np.float64]
    """[part, pixel, 3]."""
    products: NDArray[np.float64]
    """Of two parts, [part, part, pixel, 3]."""

    @classmethod
    def of(cls, count: int) -> "Spread":
        """Return the sums of no passes of `count` pixels."""
        shape = (PARTS, count, 3)
        return cls(np.zeros((count, 1), np.int64), np.zeros(shape), np.zeros((PARTS, *shape)))

    def add(self, where: slice, *parts: NDArray[np.float64]) -> None:
        """Add a pass of some pixels, [pixel, 3] each."""
        self.passes[where] += 1
        for i, first in enumerate(parts):
            self.sums[i, where] += first
            for j, second in enumerate(parts):
                self.products[i, j, where] += first * second

    def best_shares(self, mean: NDArray[np.float64]) -> Shares:
        """Return the shares that make least noise around every pixel, of pixels of this `mean` [pixel, 3].

        How much of the known light of surfaces is taken from rays, and how much of the noise of the known
        sky is taken out.
        """
        weight = 1.0 / np.maximum(mean, max(_LEAST * mean.mean(), 1e-30)) if mean.size else mean
        near = {
            (i, j): _neighbours((weight * self._covariance(i, j)).sum(axis=-1))
            for i, j in ((0, 1), (0, 2), (1, 2), (1, 1), (2, 2))
        }
        from_rays, taken_out = np.zeros((2, len(mean)))
        # Each in turn given the other, within its bounds: the least of a convex function over a rectangle.
        for _ in range(_TURNS):
            wanted = (taken_out * near[1, 2] - near[0, 1]) / np.maximum(near[1, 1], 1e-300)
            from_rays = np.clip(wanted, 0.0, _MOST_SHARE)
            wanted = (near[0, 2] + from_rays * near[1, 2]) / np.maximum(near[2, 2], 1e-300)
            taken_out = np.clip(wanted, 0.0, 1.0)
        return np.stack([from_rays, taken_out])

    def variance(self, shares: Shares) -> NDArray[np.float64]:
        """Return the variance of the mean over the passes with these shares, [pixel, 3]."""
        factors = (np.ones_like(shares[0]), shares[0], -shares[1])
        total = np.zeros_like(self.sums[0])
        for i, first in enumerate(factors):
            for j, second in enumerate(factors):
                total += (first * second)[:, None] * self._covariance(i, j)
        return np.maximum(total, 0.0)

    def _covariance(self, first: int, second: int) -> NDArray[np.float64]:
        """Return the covariance of the means of two parts over the passes, [pixel, 3]."""
        count = self.passes
        product = self.sums[first] * self.sums[second]
        return (self.products[first, second] / count - product / count**2) / (count - 1)


def _neighbours(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sums over the pixels beside each, without it, and `_PRIOR` times the mean of all, [pixel]."""
    window = np.ones(2 * _REACH + 1)
    window[_REACH] = 0.0
    beside = np.convolve(values, window)[_REACH : _REACH + len(values)] if len(values) else values
    return beside + _PRIOR * values.sum() / max(len(values), 1)

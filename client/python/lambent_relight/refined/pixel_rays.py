"""The rays of a picture's pixels, and the even uniforms that the rays of a pixel share.

A pixel has one scrambled Sobol sequence. Its rays take consecutive elements, each a block of its own, so that
the directions of every ray are even, and all of them together are, too: the error of a pixel is that of one
long sequence. Rays that took the same elements, or every fourth, would each be left with one corner of the
square. Source: Sobol 1967, with the direction numbers of Joe and Kuo 2008; Owen 1995 (scrambling).
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray


def _direction_numbers() -> NDArray[np.uint64]:
    """Return the direction numbers of dimensions 3, 1 and 2 of Sobol's sequence, [3, 32].

    The last two together are a (0, 2)-sequence: every 2^k elements from a multiple of 2^k have one in each
    rectangle of area 2^-k. They become the place in a strategy's square; the first chooses the strategy.
    """
    first, second, third = [1] * 32, [1], [1, 3]
    for k in range(1, 32):
        second.append((2 * second[k - 1]) ^ second[k - 1])
    for k in range(2, 32):
        third.append((2 * third[k - 1]) ^ (4 * third[k - 2]) ^ third[k - 2])
    rows = [[number << (31 - k) for k, number in enumerate(row)] for row in (third, first, second)]
    return np.array(rows, np.uint64)


_DIRECTION_NUMBERS = _direction_numbers()


@dataclass(frozen=True)
class PixelRays:
    """Which points the rays of a pixel hit; points are in the order of their pixels."""

    pixel: NDArray[np.intp]
    """Number of every point's pixel, rising from zero without gaps, [point]."""
    share: NDArray[np.floating]
    """Share of its pixel's radiance that a point has, [point, 1]; one in total for each pixel."""

    @classmethod
    def of(cls, place: NDArray[np.integer], weight: NDArray[np.floating]) -> "PixelRays":
        """Return the rays of pixels at `place` [point], any rising numbers, by their `weight` [point, 1]."""
        number = np.cumsum(np.diff(place, prepend=place[:1]) != 0)
        total = np.bincount(number, weight[:, 0].astype(np.float64))
        return cls(number, weight / np.maximum(total, 1e-12)[number][:, None])

    @classmethod
    def alone(cls, count: int) -> "PixelRays":
        """Return `count` pixels of one ray each."""
        return cls(np.arange(count), np.ones((count, 1)))

    @cached_property
    def first(self) -> NDArray[np.intp]:
        """Number of every pixel's first point, [pixel]."""
        return np.flatnonzero(np.diff(self.pixel, prepend=-1))

    @property
    def most(self) -> int:
        """The largest number of rays of a pixel; one if there are none."""
        return int(np.bincount(self.pixel).max(initial=1))

    def chosen(self, which: NDArray[np.bool_]) -> "tuple[NDArray[np.intp], NDArray[np.intp], PixelRays]":
        """Return the numbers of some pixels and of their points, and these as rays of their own."""
        points = np.flatnonzero(which[self.pixel])
        number = np.cumsum(which) - 1
        return np.flatnonzero(which), points, PixelRays(number[self.pixel[points]], self.share[points])

    def mean(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the mean of `values` [point, n] over the rays of every pixel, [pixel, n]."""
        count = len(self.first)
        sums = [np.bincount(self.pixel, (values * self.share)[:, i], count) for i in range(values.shape[1])]
        return np.stack(sums, axis=-1)

    def parts(self, most_points: int) -> list["tuple[slice, PixelRays]"]:
        """Return runs of whole pixels, with about `most_points` points or fewer each, and their rays."""
        begins = np.diff(self.first // max(most_points, 1), prepend=-1) != 0
        ends = [*self.first[begins], len(self.pixel)]
        runs = [slice(int(start), int(end)) for start, end in pairwise(ends)]
        return [(run, PixelRays(self.pixel[run] - self.pixel[run.start], self.share[run])) for run in runs]

    def uniforms(self, per_point: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return elements of the pixels' sequences, consecutive ones for every point, [point * per_point, 3].

        Each is uniform in [0, 1), and sequences are independent of one another.
        """
        # Compiled code takes a second to import, which programs that only look at bundles do not pay.
        from lambent_relight.refined import sequence_kernels as kernels

        seeds = rng.integers(0, 2**64, (len(self.first), 3), np.uint64)
        rank = np.arange(len(self.pixel)) - self.first[self.pixel]
        u = np.empty((len(self.pixel) * per_point, 3))
        kernels.write_elements(_DIRECTION_NUMBERS, seeds, self.pixel, rank * per_point, per_point, u)
        return u

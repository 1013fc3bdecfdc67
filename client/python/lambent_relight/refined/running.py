"""Means over rounds of directions, of which every pixel may have another number."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.shading import Radiance

_REACH = 4
"""Pixels to either side whose variances are averaged."""
_MEANS = ("direct", "indirect", "specular", "visibility")


@dataclass(frozen=True)
class Running:
    """Means over all rounds so far; fields as in `Radiance`, but for these."""

    pixels: PixelRays
    direct: NDArray[np.float32]
    indirect: NDArray[np.float32]
    specular: NDArray[np.float32]
    visibility: NDArray[np.float32]
    standard_error: NDArray[np.float32]
    num_samples: NDArray[np.int64]
    """Directions of each ray of a pixel, [pixel]."""
    freedom: NDArray[np.int64]
    """Degrees of freedom of `standard_error`, [pixel]."""

    @classmethod
    def of(cls, pixels: PixelRays) -> "Running":
        """Return what no round has found of `pixels`."""
        points, count = len(pixels.pixel), len(pixels.first)
        return cls(
            pixels,
            **{name: np.zeros((points, 3), np.float32) for name in _MEANS},
            standard_error=np.zeros((count, 3), np.float32),
            num_samples=np.zeros(count, np.int64),
            freedom=np.zeros(count, np.int64),
        )

    def add(self, radiance: Radiance, pixels: NDArray[np.integer], points: NDArray[np.integer]) -> None:
        """Add an independent round of some pixels, whose rays are `points`, by its number of directions."""
        total = self.num_samples[pixels] + radiance.num_samples
        share = (radiance.num_samples / total).astype(np.float32)
        of_point = np.zeros(len(self.freedom), np.float32)
        of_point[pixels] = share
        new = of_point[self.pixels.pixel[points]][:, None]
        for name in _MEANS:
            values = getattr(self, name)
            values[points] += new * (getattr(radiance, name) - values[points])
        own, other = self.standard_error[pixels], radiance.standard_error
        self.standard_error[pixels] = np.hypot((1.0 - share)[:, None] * own, share[:, None] * other)
        self.num_samples[pixels] = total
        self.freedom[pixels] += radiance.freedom

    @property
    def mean_samples(self) -> int:
        """The mean number of directions of a ray, rounded; of pixels, not of rays."""
        return round(float(self.num_samples.mean())) if len(self.num_samples) else 0

    def relative_error(self) -> float:
        """Return the mean standard error of all pixels over their mean radiance, of all channels.

        The root of an unbiased variance is too small on average: 20 % with two passes, 4 % with eight. It is
        corrected as for normal errors.
        """
        if not len(self.direct):
            return 0.0
        mean = float(self.pixels.mean(self.direct + self.indirect).mean())
        half = 0.5 * self.freedom
        root = np.exp(gammaln(half + 0.5) - gammaln(half)) / np.sqrt(half)
        error = float((self.standard_error / root[:, None]).mean(dtype=np.float64))
        return error / mean if mean > 0.0 else 0.0

    def spread(self) -> NDArray[np.float64]:
        """Return the standard error that every pixel would have after one direction of a ray, [pixel].

        A pixel's own variance is from a few passes, and goes with its own noise: bright where it is large. So
        it is a mean over neighbours, in the order of the pixels.
        """
        variance = self.standard_error.astype(np.float64) ** 2 * self.num_samples[:, None]
        window = np.ones(2 * _REACH + 1)
        counts = np.convolve(np.ones(len(variance)), window, "same")[: len(variance)]
        smooth = [np.convolve(row, window, "same")[: len(variance)] / counts for row in variance.T]
        return np.sqrt(np.maximum(smooth, 0.0)).mean(axis=0)

"""A phone's way from light to a file: exposure, noise, tone, JPEG and EXIF."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from make_sample_scene import encode_srgb
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy import ndimage

QUALITY = 92
LENS_BLUR_PX = 0.45
ELECTRONS_AT_ISO_100 = 36_000.0
"""Held by one pixel of the reduced picture: six of the sensor's."""
READ_NOISE_ELECTRONS = 5.0
SPEEDS = (50, 64, 80, 100, 125, 160, 200, 250, 320, 400, 500, 640, 800)
SECONDS_AT_ISO_100 = 0.02
"""Seconds at ISO 100 for an exposure factor of 1."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Exposure:
    """How a photograph was exposed."""

    factor: float
    """Times scene radiance: what becomes 1.0, white."""

    @property
    def iso(self) -> int:
        """Return the sensor's speed, chosen for about 1/60 s."""
        wanted = self.factor * SECONDS_AT_ISO_100 * 100.0 * 60.0
        return min(SPEEDS, key=lambda speed: abs(np.log(speed / wanted)))

    @property
    def seconds(self) -> float:
        """Return the exposure time, exactly as it belongs to the factor and the speed."""
        return self.factor * SECONDS_AT_ISO_100 * 100.0 / self.iso


def meter(radiance: np.ndarray, grey: float) -> float:
    """Return the factor that brings the centre-weighted mean of a small picture [H, W, 3] to `grey`.

    It is reduced where more than 2 % of the picture would be white.
    """
    height, width = radiance.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    weight = np.exp(-2.0 * (x**2 + y**2))
    luminance = radiance @ np.array([0.2126, 0.7152, 0.0722])
    mean = float((luminance * weight).sum() / weight.sum())
    return min(grey / mean, 1.1 / float(np.quantile(luminance, 0.98)))


def develop(radiance: np.ndarray, exposure: Exposure, seed: int) -> np.ndarray:
    """Return the photograph uint8 [H, W, 3]: lens blur, shot and read noise, clipping, sRGB."""
    soft = ndimage.gaussian_filter(radiance, (LENS_BLUR_PX, LENS_BLUR_PX, 0.0)) * exposure.factor
    full = ELECTRONS_AT_ISO_100 * 100.0 / exposure.iso
    variance = np.maximum(soft, 0.0) / full + (READ_NOISE_ELECTRONS / full) ** 2
    noisy = soft + np.sqrt(variance) * np.random.default_rng(seed).normal(size=soft.shape)
    return np.round(255.0 * encode_srgb(noisy)).astype(np.uint8)


def write_photograph(
    path: Path,
    picture: np.ndarray,
    exposure: Exposure,
    orientation: int,
    number: int,
    quality: int = QUALITY,
) -> None:
    """Write an upright picture as a JPEG whose pixels lie as EXIF's `orientation` says."""
    stored = {1: picture, 6: np.rot90(picture, 1), 8: np.rot90(picture, -1)}[orientation]
    image = Image.fromarray(np.ascontiguousarray(stored))
    exif = Image.Exif()
    when = f"2026:05:09 1{number // 60 % 10}:{number % 60:02d}:{number * 7 % 60:02d}"
    exif.update({271: "Example", 272: "Phone One", 274: orientation, 305: "tabletop 1", 306: when})
    exif.get_ifd(0x8769).update(
        {
            33434: IFDRational(round(exposure.seconds * 1e6), 1_000_000),
            33437: IFDRational(18, 10),
            34855: exposure.iso,
            36867: when,
            37386: IFDRational(425, 100),
            40962: image.width,
            40963: image.height,
            41986: 0,
            41987: 0,
            41989: 26,
        }
    )
    partial = path.with_suffix(".partial")
    image.save(partial, "JPEG", quality=quality, subsampling=2, exif=exif)
    os.replace(partial, path)

"""How much of the photographs' detail the albedo texture of a printed drum keeps.

    python -m benchmarks texture_detail [BUNDLE ...]

Without a bundle it looks at the print itself. The bundles are of runs on the capture that `python -m
benchmarks.printed_drum` writes. Of each it tells

* the modulation at half the photographs' Nyquist frequency (0.25 cycles per pixel) at slanted edges of the
print,
  after ISO 12233: the median over edges, each the Fourier transform of the derivative of its edge profile. A
  pixel is what the nearest camera's pixel covers on the wall. Edges are followed piece by piece, for the
  surface is not exact to a pixel; what blurs a piece counts, what moves it does not;
* the PSNR of the texture against the print over the wall, sRGB-encoded, with one factor per channel fitted:
  what moves a piece counts here.
"""

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from lambent_relight.asset.textured_mesh import pixels_of, textured_mesh_from_glb
from lambent_relight.baked.raster import interpolate, rasterise_uv
from lambent_relight.baked.texture_lookup import bilinear

from benchmarks import printed_drum as drum

QUICK = "--side 800"
HALF_NYQUIST = 0.25
"""Cycles per photograph pixel."""
PIECE = 0.02
"""Length of the pieces along an edge whose place is found one by one, scene units."""
REACH = 0.045
"""Distance to either side of an edge that is looked at, scene units."""
LENGTH = 0.8
"""Share of an edge that is looked at, around its middle."""
PER_PIXEL = 4
"""Steps of an edge profile per photograph pixel."""
LEAST_TEXELS = 40
OUTSIDE = 0.97
"""Least distance of the wall from the axis, as a share of the radius."""
LOOKED_UP = 4096
"""Texels a side at whose centres textures are looked up at least."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Detail:
    """Figures of one texture."""

    size: int
    modulation: float
    """Median over edges at `HALF_NYQUIST`."""
    lowest: float
    highest: float
    """First and last decile over edges."""
    edges: int
    psnr: float
    """dB, over the wall."""
    scale: tuple[float, float, float]
    """Factors that were fitted."""


def detail_of(glb: bytes, side: int = 1600) -> Detail:
    """Return the figures of a bundle's mesh, for photographs of `side` pixels."""
    mesh = textured_mesh_from_glb(glb)
    albedo = linear_from_srgb(pixels_of(mesh.base_colour_png) / 255.0).astype(np.float32)
    # A small texture is looked up as a renderer does; one of `LOOKED_UP` texels at their centres.
    size = max(len(albedo), LOOKED_UP)
    found = rasterise_uv(mesh.uv, mesh.faces, size)
    positions = interpolate(found, mesh.faces, mesh.vertices)
    row, column = np.nonzero(found.covered)
    wall = np.flatnonzero(outside(positions))
    uv = (np.stack([column[wall], row[wall]], axis=-1) + 0.5) / size
    positions, values = positions[wall], bilinear(albedo, uv)
    truth = drum.albedo_at(positions)
    scale = (truth * values).sum(axis=0) / np.maximum((values**2).sum(axis=0), 1e-12)
    encoded = [srgb_from_linear(np.clip(each, 0.0, 1.0)) for each in (values * scale, truth)]
    error = float(np.mean((encoded[0] - encoded[1]) ** 2))
    found_modulations = modulations(positions, values.mean(axis=1), pixel_on_wall(side))
    low, middle, high = np.percentile(found_modulations, [10, 50, 90]) if found_modulations else (0.0,) * 3
    return Detail(
        size=len(albedo),
        modulation=float(middle),
        lowest=float(low),
        highest=float(high),
        edges=len(found_modulations),
        psnr=-10.0 * np.log10(error + 1e-12),
        scale=tuple(float(value) for value in scale),
    )


def outside(positions: np.ndarray) -> np.ndarray:
    """Return which positions belong to the wall as it is seen; a mesh may have sheets inside it."""
    return drum.on_wall(positions) & (np.hypot(positions[:, 0], positions[:, 1]) > OUTSIDE * drum.RADIUS)


def pixel_on_wall(side: int) -> float:
    """Return what a pixel covers on the wall straight in front of a camera, scene units."""
    return (drum.DISTANCE - drum.RADIUS) * 2.0 * np.tan(0.5 * drum.ANGLE) / side


def modulations(positions: np.ndarray, grey: np.ndarray, pixel: float) -> list[float]:
    """Return the modulation at `HALF_NYQUIST` of every edge of the tilted squares that texels cover."""
    azimuth = np.arctan2(positions[:, 1], positions[:, 0]) % (2.0 * np.pi)
    result = []
    for middle, height in drum.SQUARES:
        around = (azimuth - middle + np.pi) % (2.0 * np.pi) - np.pi
        place = np.stack([drum.RADIUS * around, positions[:, 2] - height], axis=-1)
        for quarter in range(4):
            angle = np.radians(drum.TILT_DEG + 90.0 * quarter)
            out, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
            across, forth = place @ out - drum.SQUARE, place @ along
            near = (np.abs(across) < REACH) & (np.abs(forth) < LENGTH * drum.SQUARE)
            profile = edge_profile(across[near], forth[near], grey[near], pixel)
            if profile is not None:
                result.append(modulation(profile))
    return result


def edge_profile(
    across: np.ndarray, along: np.ndarray, values: np.ndarray, pixel: float
) -> np.ndarray | None:
    """Return values against the distance from the edge in steps of 1 / `PER_PIXEL` pixels, dark to light.

    The edge is a line through where each piece of it crosses its middle. None where texels are too few.
    """
    dark, light = np.median(values[across < -0.5 * REACH]), np.median(values[across > 0.5 * REACH])
    level = (values - dark) / max(light - dark, 1e-6)
    middles, places = [], []
    for start in np.arange(along.min(initial=0.0), along.max(initial=0.0), PIECE):
        piece = (along >= start) & (along < start + PIECE)
        if piece.sum() < LEAST_TEXELS:
            continue
        # Where a step between both tones would have the same sum.
        order = np.argsort(across[piece])
        x, y = across[piece][order], np.clip(level[piece][order], 0.0, 1.0)
        places.append(x[-1] - np.trapezoid(y, x))
        middles.append(start + 0.5 * PIECE)
    if len(middles) < 2:
        return None
    whole = (along >= middles[0]) & (along <= middles[-1])
    distance, level = across[whole] - np.interp(along[whole], middles, places), level[whole]
    step = pixel / PER_PIXEL
    count = int(0.8 * REACH / step)
    number = np.floor(distance / step + 0.5).astype(int)
    inside = np.abs(number) <= count
    sums = np.bincount(number[inside] + count, level[inside], 2 * count + 1)
    counts = np.bincount(number[inside] + count, minlength=2 * count + 1)
    known = np.flatnonzero(counts)
    if len(known) < 0.7 * len(counts):
        return None
    return np.interp(np.arange(len(counts)), known, sums[known] / counts[known])


def modulation(profile: np.ndarray) -> float:
    """Return the modulation of an edge profile at `HALF_NYQUIST`, relative to that at zero."""
    line = np.diff(profile) * np.hanning(len(profile) - 1)
    x = np.arange(len(line)) / PER_PIXEL
    wave = np.exp(-2.0j * np.pi * HALF_NYQUIST * x)
    # The difference of neighbours is itself a filter, which ISO 12233 divides out.
    own = np.sinc(HALF_NYQUIST / PER_PIXEL)
    return float(abs((line * wave).sum()) / max(abs(line.sum()), 1e-9) / own)


def ideal(pixel: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions on the wall, a pixel apart, and the grey of the print averaged over that pixel."""
    step = pixel / 4
    around = np.arange(0.0, 2.0 * np.pi * drum.RADIUS, step)
    around = around[: len(around) // 4 * 4] / drum.RADIUS
    height = np.arange(-drum.WALL + step, drum.WALL - step, step)
    grey, places = [], []
    for first in range(0, len(height) // 4 * 4, 4):
        azimuth, z = np.meshgrid(around, height[first : first + 4])
        points = np.stack([drum.RADIUS * np.cos(azimuth), drum.RADIUS * np.sin(azimuth), z], axis=-1)
        values = drum.albedo_at(points.reshape(-1, 3)).mean(axis=1).reshape(1, 4, -1, 4).mean(axis=(1, 3))
        middle = azimuth.reshape(4, -1, 4).mean(axis=(0, 2))
        level = np.full_like(middle, z.mean())
        places.append(np.stack([drum.RADIUS * np.cos(middle), drum.RADIUS * np.sin(middle), level], axis=-1))
        grey.append(values[0])
    return np.concatenate(places), np.concatenate(grey)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument(
        "bundles", type=Path, nargs="*", help="default: the print itself, of texels of a pixel"
    )
    parser.add_argument("--side", type=int, default=1600, help="pixels of the photographs")


def main(options: argparse.Namespace) -> dict[str, Any]:
    """Print and return the figures of each bundle."""
    if not options.bundles:
        pixel = pixel_on_wall(options.side)
        found = modulations(*ideal(pixel), pixel)
        print(f"the print: modulation {np.median(found):.3f}, {min(found):.3f} to {max(found):.3f}")
        return {"print": found}
    result = {}
    for bundle in options.bundles:
        found = asdict(detail_of((bundle / "mesh" / "asset.glb").read_bytes(), options.side))
        result[str(bundle)] = found
        print(bundle.name, json.dumps(found), flush=True)
    return result

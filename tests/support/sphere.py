"""Quadrature over the sphere, against which estimators are held."""

import math

import numpy as np
import torch


def sphere_quadrature(
    num_polar: int = 128, num_azimuth: int = 256, *, lowest: float = -1.0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return (directions [n, 3], weights [n]), float64: Gauss-Legendre in the cosine, even steps in azimuth.

    The part of the sphere with cosine above `lowest`; the weights sum to its solid angle.
    """
    nodes, weights = np.polynomial.legendre.leggauss(num_polar)
    cosine = torch.from_numpy(nodes) * (1.0 - lowest) / 2.0 + (1.0 + lowest) / 2.0
    azimuth = (torch.arange(num_azimuth, dtype=torch.float64) + 0.5) * (2.0 * math.pi / num_azimuth)
    sine = (1.0 - cosine * cosine).sqrt()
    directions = torch.stack(
        [
            sine[:, None] * azimuth.cos(),
            sine[:, None] * azimuth.sin(),
            cosine[:, None].expand(-1, num_azimuth),
        ],
        dim=-1,
    )
    weight = torch.from_numpy(weights) * (1.0 - lowest) / 2.0 * (2.0 * math.pi / num_azimuth)
    return directions.reshape(-1, 3), weight.repeat_interleave(num_azimuth)


def without_rare(
    shares: torch.Tensor, masses: torch.Tensor, num_samples: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return `shares` [rows, bins] and `masses` [bins], bins that expect under 50 samples put together.

    The mean of a bin that is hardly ever hit is not normal yet.
    """
    often = masses * num_samples >= 50.0
    rest = ~often
    return (
        torch.cat([shares[:, often], shares[:, rest].sum(dim=1, keepdim=True)], dim=1),
        torch.cat([masses[often], masses[rest].sum(dim=0, keepdim=True)]),
    )


def frame_with_axis(directions: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return `directions` turned so that +z becomes the unit vector `axis` (a Householder reflection)."""
    z = torch.tensor([0.0, 0.0, 1.0], dtype=directions.dtype)
    across = axis - z
    squared = across.dot(across)
    if squared < 1e-12:
        return directions
    return directions - 2.0 * (directions @ across / squared)[:, None] * across


NUM_BANDS, NUM_SECTORS = 8, 16


def bin_masses(density, axis: torch.Tensor, nodes: int = 16) -> torch.Tensor:
    """Return the integral of `density` ([n, 3] directions to [n]) over each bin of the sphere about `axis`.

    8 bands of equal solid angle by 16 sectors, Gauss-Legendre inside each bin.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = torch.from_numpy(x), torch.from_numpy(w)
    cosine = (torch.arange(NUM_BANDS)[:, None] + (x + 1.0) / 2.0) * (2.0 / NUM_BANDS) - 1.0
    azimuth = (torch.arange(NUM_SECTORS)[:, None] + (x + 1.0) / 2.0) * (2.0 * math.pi / NUM_SECTORS)
    cosine = cosine[:, None, :, None].expand(-1, NUM_SECTORS, -1, nodes)
    azimuth = azimuth[None, :, None, :].expand(NUM_BANDS, -1, nodes, -1)
    sine = (1.0 - cosine * cosine).sqrt()
    local = torch.stack([sine * azimuth.cos(), sine * azimuth.sin(), cosine], dim=-1)
    values = density(frame_with_axis(local.reshape(-1, 3), axis)).reshape(local.shape[:-1])
    area = (2.0 / NUM_BANDS) * (2.0 * math.pi / NUM_SECTORS) / 4.0
    return (values * w[:, None] * w).sum(dim=(-1, -2)).reshape(-1) * area


def bin_shares(directions: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return the share [rows, bins] of each row's `directions` [rows, lights, 3] in each bin."""
    rows, lights, _ = directions.shape
    local = frame_with_axis(directions.reshape(-1, 3), axis)
    band = ((local[:, 2] + 1.0) / 2.0 * NUM_BANDS).long().clamp(0, NUM_BANDS - 1)
    turn = (torch.atan2(local[:, 1], local[:, 0]) / (2.0 * math.pi)) % 1.0
    sector = (turn * NUM_SECTORS).long().clamp(0, NUM_SECTORS - 1)
    one_hot = torch.nn.functional.one_hot(band * NUM_SECTORS + sector, NUM_BANDS * NUM_SECTORS)
    return one_hot.double().reshape(rows, lights, -1).mean(dim=1)

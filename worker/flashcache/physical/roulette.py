"""Early stopping of secondary rays that can hardly matter, without bias (Russian roulette)."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from flashcache.geometry.directions import dot
from flashcache.physical.brdf import Materials, diffuse_albedo, lambert_cos, specular_brdf_cos
from flashcache.physical.sampling import DirectionSamples

SURVIVAL_MINIMUM = 0.05
"""Smallest probability of tracing a direction: what survives counts twenty times at most."""


def survival_probability(
    normal: Float[Tensor, "points 3"],
    omega_o: Float[Tensor, "points 3"],
    materials: Materials,
    halves: tuple[DirectionSamples, DirectionSamples],
    is_exact: Bool[Tensor, " lights"],
    threshold: float,
) -> Float[Tensor, "points lights"]:
    """Return the probability with which each direction should be traced; one for directions not exact.

    A direction's throughput is reflectance times cosine times weight: its contribution under light of one.
    Those below `threshold` times the mean of their point's exact directions survive in proportion.
    """
    normal = normal.unsqueeze(1)
    with torch.no_grad():
        diffuse = diffuse_albedo(materials).unsqueeze(1) * lambert_cos(halves[0].omega_i, normal)
        specular = specular_brdf_cos(
            omega_o.unsqueeze(1), halves[1].omega_i, normal, materials.per_direction()
        )
        weight = torch.cat([half.weight for half in halves], dim=1)
        throughput = torch.cat([diffuse, specular], dim=1).mean(dim=-1) * weight
        above = torch.cat([dot(normal, half.omega_i).squeeze(-1) for half in halves], dim=1) > 0.0
        counted = (above & is_exact).to(throughput.dtype)
        mean = (throughput * counted).sum(dim=1, keepdim=True) / counted.sum(dim=1, keepdim=True).clamp_min(1)
        share = throughput / (threshold * mean).clamp_min(1e-12)
        return torch.where(is_exact, share.clamp(SURVIVAL_MINIMUM, 1.0), torch.ones_like(share))

"""The occlusion-aware light sampler: a mixture of von Mises-Fisher lobes that differs from point to point.

Letters as in the paper: lobe means mu, concentrations kappa, amplitudes exp(lambda). Densities are in 1/sr.
"""

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.turns import LightTurns
from flashcache.errors import ConfigError
from flashcache.fields.mlp import Hidden, linear
from flashcache.geometry.contraction import contract
from flashcache.geometry.directions import from_frame, normalize

KAPPA_MINIMUM = 1e-4
"""Below this a lobe is the uniform density to float32 precision."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LightSamplerConfig:
    """Sizes and starting values of the light sampler (supplement 2.7)."""

    grid: HashGridConfig = field(default_factory=HashGridConfig)
    width: int = 64
    num_layers: int = 2
    num_lobes: int = 128
    position_scale: float = 20.0
    """Factor on the network's lobe positions [scene units]."""
    position_spread: float = 10.0
    """Standard deviation of the fixed offsets of the lobe positions [scene units]."""
    kappa_maximum: float = 50.0
    amplitude_minimum: float = -50.0
    """Lower bound of lambda, the logarithm of a lobe's amplitude."""

    def __post_init__(self) -> None:
        if self.num_lobes < 1:
            raise ConfigError(f"light_sampler.num_lobes must be at least 1, got {self.num_lobes}")


@dataclass(frozen=True)
class VmfMixture:
    """One mixture of von Mises-Fisher lobes per point: a sampling strategy, and a model of light."""

    means: Float[Tensor, "points lobes 3"]
    """Unit vectors."""
    kappa: Float[Tensor, "points lobes"]
    log_amplitude: Float[Tensor, "points lobes"]
    num_uniforms = 3

    def _log_scale(self) -> Float[Tensor, "points lobes"]:
        """Return log k / (2 pi (1 - e^-2k)), which normalises exp(k (cos - 1))."""
        kappa = self.kappa.clamp_min(KAPPA_MINIMUM)
        return torch.log(kappa / (2.0 * math.pi)) - torch.log(-torch.expm1(-2.0 * kappa))

    def _mixture(self, log_weight: Tensor, omega: Tensor) -> Tensor:
        kappa = self.kappa.clamp_min(KAPPA_MINIMUM)
        peak = (log_weight + self._log_scale() - kappa).unsqueeze(1)
        exponent = torch.baddbmm(peak, omega, (kappa.unsqueeze(-1) * self.means).transpose(1, 2))
        return exponent.exp().sum(dim=-1)

    def pdf(self, omega: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights"]:
        """Return the density of the normalised mixture, in 1/sr (paper, the vMF mixture q)."""
        return self._mixture(torch.log_softmax(self.log_amplitude, dim=-1), omega)

    def amplitude(self, omega: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights"]:
        """Return the unnormalised mixture: the sampler's model of how bright each direction is."""
        return self._mixture(self.log_amplitude, omega)

    def sample(self, u: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights 3"]:
        """Return directions; the first variate picks a lobe for each, the others a direction in it.

        Directions below the surface are kept; they contribute nothing to an estimate.
        """
        cdf = torch.softmax(self.log_amplitude, dim=-1).cumsum(dim=-1)
        lobe = torch.searchsorted(cdf, (u[..., 0] * cdf[:, -1:]).contiguous(), right=True)
        lobe = lobe.clamp_max(cdf.shape[-1] - 1)
        mean = torch.take_along_dim(self.means, lobe.unsqueeze(-1), dim=1)
        kappa = torch.take_along_dim(self.kappa, lobe, dim=1).clamp_min(KAPPA_MINIMUM)
        # u + (1 - u) e^-2k, written so that float32 keeps its digits where k is small.
        cosine = 1.0 + torch.log1p((1.0 - u[..., 1]) * torch.expm1(-2.0 * kappa)) / kappa
        cosine = cosine.clamp(-1.0, 1.0)
        sine = (1.0 - cosine * cosine).clamp_min(0.0).sqrt()
        angle = 2.0 * math.pi * u[..., 2]
        local = torch.stack([sine * torch.cos(angle), sine * torch.sin(angle), cosine], dim=-1)
        return normalize(from_frame(local, mean))


class LightSampler(nn.Module):
    """Predicts where light comes from at a point, for every light of the scene.

    Lobe means are positions in space, so that one lamp needs no re-learning at each point; amplitudes vary
    over space, so that a lobe can be switched off where its lamp is hidden. With `turns` these positions turn
    with the light, and amplitudes vary with the turn too.
    """

    offsets: Tensor

    def __init__(
        self,
        config: LightSamplerConfig,
        contraction_radius: float,
        num_lights: int,
        turns: LightTurns | None = None,
    ) -> None:
        super().__init__()
        self.config = config
        self.contraction_radius = contraction_radius
        self.num_lights = num_lights
        self.turns = turns
        self.grid = HashGrid(config.grid)
        num_turn = 0 if turns is None else turns.out_features
        self.network = Hidden(self.grid.out_features + num_turn, config.width, config.num_layers)
        self.head = linear(self.network.num_outputs, 5 * config.num_lobes * num_lights)
        fixed = torch.Generator().manual_seed(1)
        # Differs from the paper: its code draws these anew for every batch row
        # (docs/decisions/0007-light-sampler.md).
        self.register_buffer("offsets", torch.randn((config.num_lobes, 3), generator=fixed))

    def forward(
        self, positions: Float[Tensor, "points 3"], light_index: Int[Tensor, " points"]
    ) -> VmfMixture:
        """Return the mixture at `positions` under each point's light; never a gradient to the positions.

        Source: paper, occlusion-aware importance sampler; supplement 2.7.
        """
        config = self.config
        positions = positions.detach()
        encoded = self.grid(contract(positions, self.contraction_radius))
        if self.turns is not None:
            encoded = torch.cat([encoded, self.turns.code(light_index)], dim=-1)
        raw = self.head(self.network(encoded)).reshape(-1, self.num_lights, config.num_lobes, 5)
        if self.num_lights == 1:
            raw = raw[:, 0]
        else:
            raw = raw[torch.arange(len(raw), device=raw.device), light_index]
        places = config.position_scale * raw[..., 0:3] + config.position_spread * self.offsets
        if self.turns is not None:
            places = self.turns.to_world(places, light_index)
        means = normalize(places - positions.unsqueeze(1))
        kappa = torch.nn.functional.softplus(raw[..., 3] + 1.0).clamp_max(config.kappa_maximum)
        # The total amplitude starts near one, whatever the number of lobes.
        start = 1.0 - math.log(config.num_lobes)
        log_amplitude = (raw[..., 4] + start).clamp_min(config.amplitude_minimum)
        return VmfMixture(means, kappa, log_amplitude)

"""The far field: radiance that arrives from outside the scene, one set of values per light.

Directions point towards the light, z up; texture convention as in `geometry.directions`.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.encoding.directional import positional_encoding
from flashcache.errors import ConfigError
from flashcache.fields.mlp import Hidden, linear


@dataclass(frozen=True, kw_only=True, slots=True)
class EnvironmentConfig:
    """How the environment is represented (supplement 2.1)."""

    texture_height: int = 0
    """Rows of a latitude-longitude texture (twice as many columns); 0 selects the network."""
    width: int = 256
    num_layers: int = 3
    last_width: int = 128
    num_frequencies: int = 4
    bias: float = -1.0

    def __post_init__(self) -> None:
        if self.texture_height < 0 or self.texture_height % 2:
            raise ConfigError(f"texture_height must be even and not negative, got {self.texture_height}")


class Environment(nn.Module):
    """Radiance of the surroundings by direction, positive, linear Rec. 709."""

    def __init__(self, config: EnvironmentConfig, num_lights: int) -> None:
        super().__init__()
        self.config = config
        self.num_lights = num_lights
        if config.texture_height:
            rows = config.texture_height
            self.texture = nn.Parameter(torch.zeros(num_lights, 3, rows, 2 * rows))
        else:
            num_inputs = 3 + 6 * config.num_frequencies
            self.network = Hidden(num_inputs, config.width, config.num_layers, skip_after=config.num_layers)
            self.last = linear(self.network.num_outputs, config.last_width)
            self.head = linear(config.last_width, 3 * num_lights)

    def forward(
        self, directions: Float[Tensor, "rays 3"], light_index: Int[Tensor, " rays"]
    ) -> Float[Tensor, "rays 3"]:
        """Return the radiance that arrives from `directions` (unit) in each ray's light."""
        if self.config.texture_height:
            return self._lookup(directions, light_index)
        hidden = torch.relu(
            self.last(self.network(positional_encoding(directions, self.config.num_frequencies)))
        )
        raw = self.head(hidden).reshape(-1, self.num_lights, 3)
        raw = raw[:, 0] if self.num_lights == 1 else raw[torch.arange(len(raw)), light_index]
        return torch.nn.functional.softplus(raw + self.config.bias)

    def _lookup(self, directions: Tensor, light_index: Tensor) -> Tensor:
        """Bilinear lookup with wrap-around in azimuth; softplus of the interpolated value's corners."""
        radiance = torch.nn.functional.softplus(self.texture + self.config.bias)
        rows, columns = radiance.shape[-2:]
        polar = torch.acos(directions[:, 2].clamp(-1.0, 1.0)) / math.pi
        azimuth = (0.5 - torch.atan2(directions[:, 1], directions[:, 0]) / (2.0 * math.pi)) % 1.0
        v, u = polar * rows - 0.5, azimuth * columns - 0.5
        v0, u0 = v.floor(), u.floor()
        fv, fu = (v - v0)[:, None], (u - u0)[:, None]
        top = v0.long().clamp(0, rows - 1)
        bottom = (v0.long() + 1).clamp(0, rows - 1)
        left, right = u0.long() % columns, (u0.long() + 1) % columns
        flat = radiance.permute(0, 2, 3, 1).reshape(-1, 3)
        base = light_index * (rows * columns)

        def texel(row: Tensor, column: Tensor) -> Tensor:
            return flat.index_select(0, base + row * columns + column)

        upper = texel(top, left) * (1 - fu) + texel(top, right) * fu
        lower = texel(bottom, left) * (1 - fu) + texel(bottom, right) * fu
        return upper * (1 - fv) + lower * fv

    def image(self, height: int, light: int = 0) -> Float[Tensor, "height width 3"]:
        """Return the environment as a latitude-longitude picture, `width = 2 height`, linear radiance."""
        device = next(self.parameters()).device
        polar = (torch.arange(height, device=device) + 0.5) * math.pi / height
        azimuth = math.pi - (torch.arange(2 * height, device=device) + 0.5) * math.pi / height
        directions = torch.stack(
            [
                polar.sin()[:, None] * azimuth.cos(),
                polar.sin()[:, None] * azimuth.sin(),
                polar.cos()[:, None].expand(-1, 2 * height),
            ],
            dim=-1,
        ).reshape(-1, 3)
        index = torch.full((len(directions),), light, dtype=torch.long, device=device)
        with torch.no_grad():
            return self(directions, index).reshape(height, 2 * height, 3)

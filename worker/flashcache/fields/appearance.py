"""Outgoing radiance of the NeRF cache: diffuse, specular and irradiance heads.

Directions point away from the surface; radiance is linear Rec. 709.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.encoding.directional import IntegratedDirectionalEncoding, positional_encoding
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.fields.mlp import Hidden, linear
from flashcache.geometry.contraction import contract
from flashcache.geometry.directions import reflect

RADIANCE_MAXIMUM = 1e4


@dataclass(frozen=True, kw_only=True, slots=True)
class AppearanceConfig:
    """Sizes of the appearance networks (supplement 2.2, architecture `ide`)."""

    grid: HashGridConfig = field(default_factory=HashGridConfig)
    bottleneck: int = 128
    factor_width: int = 64
    factor_layers: int = 2
    num_degrees: int = 5
    """Bands 1, 2, 4, ... of the directional encoding."""
    width_bias: float = -1.0
    """Added to the raw width (1/kappa) of the reflected lobe; smaller begins with sharper reflections."""
    view_frequencies: int = -1
    """Frequencies of the view direction as a further input of the reflection network; -1 leaves it out, as
    the paper does (docs/decisions/0012-view-direction.md)."""
    reflection_width: int = 128
    reflection_layers: int = 4


class Appearance(NamedTuple):
    """Radiance leaving a batch of points, split by cause."""

    diffuse: Float[Tensor, "points 3"]
    specular: Float[Tensor, "points 3"]
    irradiance: Float[Tensor, "points 3"]
    """Irradiance over pi; never rendered."""

    @property
    def radiance(self) -> Float[Tensor, "points 3"]:
        """Diffuse and specular radiance together."""
        return self.diffuse + self.specular


class AppearanceField(nn.Module):
    """Maps points, their density features, normals and view directions to outgoing radiance."""

    def __init__(
        self, config: AppearanceConfig, num_hidden: int, contraction_radius: float, num_lights: int
    ) -> None:
        super().__init__()
        self.config = config
        self.contraction_radius = contraction_radius
        self.num_lights = num_lights
        self.grid = HashGrid(config.grid)
        num_features = num_hidden + self.grid.out_features
        # One matrix for the heads that are linear in the feature: diffuse, irradiance, tint, width.
        self.heads = linear(num_features, 6 * num_lights + 4)
        self.bottleneck = linear(num_features, config.bottleneck)
        self.factor = Hidden(config.bottleneck + 1, config.factor_width, config.factor_layers)
        self.factor_head = linear(self.factor.num_outputs, 1)
        self.directional = IntegratedDirectionalEncoding(config.num_degrees)
        skip = 3 if config.reflection_layers > 3 else None
        num_view = 3 + 6 * config.view_frequencies if config.view_frequencies >= 0 else 0
        self.reflection = Hidden(
            config.bottleneck + self.directional.out_features + num_view,
            config.reflection_width,
            config.reflection_layers,
            skip_after=skip,
        )
        self.reflection_head = linear(self.reflection.num_outputs, 3 * num_lights)

    def forward(
        self,
        positions: Float[Tensor, "points 3"],
        hidden: Float[Tensor, "points width"],
        normal: Float[Tensor, "points 3"],
        omega_o: Float[Tensor, "points 3"],
        light_index: Int[Tensor, " points"],
        *,
        with_specular: bool = True,
    ) -> Appearance:
        """Return the outgoing radiance towards `omega_o`.

        Without `with_specular` the specular part is zero and costs nothing (the first phase of training).
        """
        features = torch.cat([hidden, self.grid(contract(positions, self.contraction_radius))], dim=-1)
        raw = self.heads(features)
        colours = torch.nn.functional.softplus(
            self._of_light(raw[:, : 6 * self.num_lights], light_index) - 2.0
        )
        diffuse, irradiance = colours[:, :3].clamp_max(RADIANCE_MAXIMUM), colours[:, 3:]
        if not with_specular:
            return Appearance(diffuse, torch.zeros_like(diffuse), irradiance)
        tint = torch.sigmoid(raw[:, -4:-1])
        width = torch.nn.functional.softplus(raw[:, -1:] + self.config.width_bias)
        bottleneck = self.bottleneck(features)
        cosine = (normal * omega_o).sum(dim=-1, keepdim=True)
        factor = torch.sigmoid(
            self.factor_head(self.factor(torch.cat([bottleneck, cosine], dim=-1))) + math.log(3.0)
        )
        direction_code = self.directional(reflect(omega_o, normal), width)
        inputs = [bottleneck, direction_code]
        if self.config.view_frequencies >= 0:
            inputs.append(positional_encoding(omega_o, self.config.view_frequencies))
        reflected = self.reflection_head(self.reflection(torch.cat(inputs, dim=-1)))
        reflected = torch.nn.functional.softplus(self._of_light(reflected, light_index) - 1.0)
        specular = (tint * factor * reflected).clamp_max(RADIANCE_MAXIMUM)
        return Appearance(diffuse, specular, irradiance)

    def _of_light(self, values: Tensor, light_index: Tensor) -> Tensor:
        """Pick each point's light from heads laid out light after light."""
        if self.num_lights == 1:
            return values
        values = values.reshape(len(values), self.num_lights, -1)
        return values[torch.arange(len(values), device=values.device), light_index]

"""Outgoing radiance of the NeRF cache: diffuse, specular and irradiance heads.

Directions point away from the surface; radiance is linear Rec. 709.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.encoding.directional import IntegratedDirectionalEncoding, positional_encoding
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.turns import LightTurns
from flashcache.fields.mlp import Hidden, linear
from flashcache.fields.packing import Layers, arrays_of, packed_grid, packed_lights
from flashcache.geometry.contraction import contract
from flashcache.geometry.directions import reflect
from flashcache.kernels import dispatch, surface_query
from flashcache.kernels.cpu import over_rows

RADIANCE_MAXIMUM = 1e4
FACTOR_BIAS = math.log(3.0)
"""Added to the raw factor of the specular part, which begins at three quarters."""
NORMAL_FREQUENCIES = 2
"""Frequencies of the normal in the light's frame, where the light turns."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AppearanceConfig:
    """Sizes of the appearance networks (supplement 2.2)."""

    architecture: Literal["ide", "fast_like"] = "ide"
    """Where reflected radiance comes from: a network on the reflected direction alone, or a copy of the fast
    cache along the reflected ray with a far field behind it, as in the paper."""
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
    """Width of the network on the reflected direction; of the far field in `fast_like`."""
    reflection_layers: int = 4
    far_degrees: int = 4
    """Bands of the far field's directional encoding, `fast_like` only."""


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
        self,
        config: AppearanceConfig,
        num_hidden: int,
        contraction_radius: float,
        num_lights: int,
        reflected: nn.Module | None = None,
        turns: LightTurns | None = None,
    ) -> None:
        """`reflected` answers reflected rays in `fast_like`: near radiance and opacity, as the fast cache.

        With `turns` all radiance depends on the turn of the light: unhindered light from afar through the
        normal and the reflected direction in the light's frame, shadows and near light through the turn.
        """
        super().__init__()
        self.config = config
        self.contraction_radius = contraction_radius
        self.num_lights = num_lights
        self.turns = turns
        self.grid = HashGrid(config.grid)
        num_features = num_hidden + self.grid.out_features
        # One matrix for the heads that are linear in the feature: diffuse, irradiance, tint, width.
        self.heads = linear(num_features, 6 * num_lights + 4)
        self.bottleneck = linear(num_features, config.bottleneck)
        self.factor = Hidden(config.bottleneck + 1, config.factor_width, config.factor_layers)
        self.factor_head = linear(self.factor.num_outputs, 1)
        self.reflected = reflected
        num_turn = 0
        if turns is not None:
            num_turn = turns.out_features
            num_normal = 3 + 6 * NORMAL_FREQUENCIES
            self.turned = Hidden(config.bottleneck + num_normal + num_turn, config.reflection_width, 2)
            self.turned_head = linear(self.turned.num_outputs, 6)
        if config.architecture == "fast_like":
            self.directional = IntegratedDirectionalEncoding(config.far_degrees)
            num_inputs = self.directional.out_features + num_turn
        else:
            self.directional = IntegratedDirectionalEncoding(config.num_degrees)
            # A fixed camera sees the turning light's frame from one side only: an input that
            # hardly varies would not be learned, and yet be evaluated for every secondary ray.
            self.view_frequencies = config.view_frequencies if turns is None else -1
            num_view = 3 + 6 * self.view_frequencies if self.view_frequencies >= 0 else 0
            num_inputs = config.bottleneck + self.directional.out_features + num_view + num_turn
        skip = 3 if config.reflection_layers > 3 else None
        self.reflection = Hidden(
            num_inputs, config.reflection_width, config.reflection_layers, skip_after=skip
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
        Without gradients one compiled function answers, where there is one (`dispatch.answers_compiled`).
        """
        plain = self.config.architecture == "ide" and self.turns is None
        if plain and dispatch.answers_compiled(positions, hidden, normal, omega_o, self.grid.table):
            inputs = positions, hidden, normal, omega_o
            return self._answer_compiled(inputs, light_index, with_specular=with_specular)
        encoded = self.grid(contract(positions, self.contraction_radius))
        features = torch.cat([hidden, encoded], dim=-1)
        raw = self.heads(features)
        bottleneck = None
        colours = self._of_light(raw[:, : 6 * self.num_lights], light_index)
        if self.turns is not None:
            bottleneck = self.bottleneck(features)
            colours = colours + self._turned(bottleneck, normal, light_index)
        colours = torch.nn.functional.softplus(colours - 2.0)
        diffuse, irradiance = colours[:, :3].clamp_max(RADIANCE_MAXIMUM), colours[:, 3:]
        if not with_specular:
            return Appearance(diffuse, torch.zeros_like(diffuse), irradiance)
        tint = torch.sigmoid(raw[:, -4:-1])
        width = torch.nn.functional.softplus(raw[:, -1:] + self.config.width_bias)
        if bottleneck is None:
            bottleneck = self.bottleneck(features)
        cosine = (normal * omega_o).sum(dim=-1, keepdim=True)
        factor = torch.sigmoid(
            self.factor_head(self.factor(torch.cat([bottleneck, cosine], dim=-1))) + FACTOR_BIAS
        )
        reflected = self._reflected(
            positions, reflect(omega_o, normal), omega_o, width, bottleneck, light_index
        )
        specular = (tint * factor * reflected).clamp_max(RADIANCE_MAXIMUM)
        return Appearance(diffuse, specular, irradiance)

    def _answer_compiled(
        self, inputs: tuple[Tensor, ...], light_index: Tensor, *, with_specular: bool
    ) -> Appearance:
        """Return what `forward` does in torch, up to rounding; for the architecture `ide` without turns."""
        layers, directional = Layers(), self.directional
        layers.add_matrix(directional.polynomials.T)
        # Each term has one of the powers of x + iy.
        orders = directional.orders.to(torch.int64).argmax(dim=0)
        layers.add(self.heads).add(self.bottleneck)
        factor = len(layers.rows)
        layers.add_hidden(self.factor, self.factor_head)
        reflection = len(layers.rows)
        layers.add_hidden(self.reflection, self.reflection_head)
        query = surface_query.Appearance(
            factor=factor,
            reflection=reflection,
            end=len(layers.rows),
            num_lights=self.num_lights,
            view_frequencies=self.view_frequencies,
            inverse_radius=np.float32(1.0 / self.contraction_radius),
            width_bias=np.float32(self.config.width_bias),
            factor_bias=np.float32(FACTOR_BIAS),
            most=np.float32(RADIANCE_MAXIMUM),
            with_specular=with_specular,
        )
        count = len(light_index)
        outgoing = Appearance(*torch.empty(3, count, 3))
        over_rows(
            surface_query.outgoing,
            count,
            surface_query.POINTS,
            *arrays_of(*inputs),
            packed_lights(light_index, self.num_lights),
            packed_grid(self.grid),
            layers.packed(),
            query,
            surface_query.Directional(*arrays_of(orders, directional.rates)),
            layers.widest,
            *arrays_of(*outgoing),
        )
        return outgoing

    def _turned(self, bottleneck: Tensor, normal: Tensor, light_index: Tensor) -> Tensor:
        """Return what the turn of the light adds to the raw diffuse colour and irradiance."""
        assert self.turns is not None
        facing = positional_encoding(self.turns.to_light(normal, light_index), NORMAL_FREQUENCIES)
        inputs = torch.cat([bottleneck, facing, self.turns.code(light_index)], dim=-1)
        return self.turned_head(self.turned(inputs))

    def _reflected(
        self,
        positions: Tensor,
        omega_r: Tensor,
        omega_o: Tensor,
        width: Tensor,
        bottleneck: Tensor,
        light_index: Tensor,
    ) -> Tensor:
        """Return the radiance that arrives around the reflected direction `omega_r`."""
        turn: list[Tensor] = []
        omega_f = omega_r
        if self.turns is not None:
            omega_f = self.turns.to_light(omega_r, light_index)
            turn = [self.turns.code(light_index)]
        code = self.directional(omega_f, width)
        if self.config.architecture == "fast_like":
            # Differs from the paper: a far field of its own (docs/decisions/0019-small-departures.md).
            assert self.reflected is not None
            far = self._from_directions([code, *turn], light_index)
            near = self.reflected(positions, omega_r, light_index)
            return near.near_radiance + (1.0 - near.opacity)[:, None] * far
        inputs = [bottleneck, code, *turn]
        if self.view_frequencies >= 0:
            inputs.append(positional_encoding(omega_o, self.view_frequencies))
        return self._from_directions(inputs, light_index)

    def _from_directions(self, inputs: list[Tensor], light_index: Tensor) -> Tensor:
        raw = self.reflection_head(self.reflection(torch.cat(inputs, dim=-1)))
        return torch.nn.functional.softplus(self._of_light(raw, light_index) - 1.0)

    def _of_light(self, values: Tensor, light_index: Tensor) -> Tensor:
        """Pick each point's light from heads laid out light after light."""
        if self.num_lights == 1:
            return values
        values = values.reshape(len(values), self.num_lights, -1)
        return values[torch.arange(len(values), device=values.device), light_index]

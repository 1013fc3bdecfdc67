"""The fast cache: near-field radiance, opacity and distance of a ray from nine grid queries.

One query of a distance grid at the ray's origin places eight samples along the ray; one query of
a feature grid at each of them, weighted and decoded, gives the radiance (supplement 2.1).
"""

import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from lambent_compute import blocks
from torch import Tensor, nn

from flashcache.encoding.directional import positional_encoding
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.turns import LightTurns
from flashcache.fields.mlp import Hidden, linear
from flashcache.fields.packing import Layers, arrays_of, packed_grid, packed_lights
from flashcache.geometry.contraction import contract
from flashcache.kernels import dispatch, fast_query
from flashcache.kernels.cpu import over_rows
from flashcache.volume.proposal_sampling import SECONDARY_CURVE

LEAST_OPACITY = 1e-3
"""Opacity below which nothing is hit and the distance jumps to the far end of the ray."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FastCacheConfig:
    """Sizes of the fast cache (supplement 2.1)."""

    distance_grid: HashGridConfig = field(default_factory=HashGridConfig)
    feature_grid: HashGridConfig = field(default_factory=lambda: HashGridConfig(half_extent=2.0))
    code_width: int = 64
    code_layers: int = 2
    distance_width: int = 128
    distance_layers: int = 4
    num_frequencies: int = 2
    num_samples: int = 8
    decoder_widths: tuple[int, int] = (64, 128)


class CacheAnswer(NamedTuple):
    """A cache's answers for a batch of secondary rays."""

    near_radiance: Float[Tensor, "rays 3"]
    """Linear, premultiplied by opacity, without environment."""
    opacity: Float[Tensor, " rays"]
    distance: Float[Tensor, " rays"]
    """From the ray's origin, scene units; the far end where nothing is hit."""


class FastCache(nn.Module):
    """The fast cache: answers for secondary rays, about ten times cheaper than the NeRF cache's."""

    def __init__(
        self,
        config: FastCacheConfig,
        contraction_radius: float,
        num_lights: int,
        ends: tuple[float, float],
        *,
        position_frequencies: int | None = None,
        origin_frequencies: int | None = None,
        colour_bias: float = -2.0,
        turns: LightTurns | None = None,
    ) -> None:
        """`ends` are the near and the far distance of rays, scene units.

        With `turns` radiance depends on the turn of the light; opacity and distance never do. The three
        before are for the copy inside the NeRF cache's appearance (supplement 2.2): `position_frequencies`
        replaces `config.num_frequencies` for the origin in the distance network, `origin_frequencies` lets
        the decoder see the encoded origin (not at all by default), and `colour_bias` is added to the raw
        colour.
        """
        super().__init__()
        self.config = config
        self.position_frequencies = (
            config.num_frequencies if position_frequencies is None else position_frequencies
        )
        self.origin_frequencies = origin_frequencies
        self.colour_bias = colour_bias
        self.turns = turns
        self.contraction_radius = contraction_radius
        self.num_lights = num_lights
        self.near, self.far = ends
        self.distance_grid = HashGrid(config.distance_grid)
        self.code = Hidden(self.distance_grid.out_features, config.code_width, config.code_layers)
        num_encoded = 6 + 6 * (config.num_frequencies + self.position_frequencies)
        skip = 3 if config.distance_layers > 3 else None
        self.distance_network = Hidden(
            self.code.num_outputs + num_encoded,
            config.distance_width,
            config.distance_layers,
            skip_after=skip,
        )
        self.distance_head = linear(self.distance_network.num_outputs, 3 * config.num_samples + 1)
        nn.init.zeros_(self.distance_head.weight)
        self.feature_grid = HashGrid(config.feature_grid)
        first, second = config.decoder_widths
        num_origin = 0 if origin_frequencies is None else 3 + 6 * origin_frequencies
        num_mixed = self.feature_grid.out_features + num_origin
        num_mixed += 0 if turns is None else turns.out_features
        self.decoder = nn.ModuleList([linear(num_mixed, first), linear(first, second)])
        self.decoder_head = linear(second, 3 * num_lights)

    def forward(
        self,
        origins: Float[Tensor, "rays 3"],
        directions: Float[Tensor, "rays 3"],
        light_index: Int[Tensor, " rays"],
    ) -> CacheAnswer:
        """Return radiance, opacity and distance along rays from (offset) surface points.

        Without gradients one compiled function answers, where there is one (`dispatch.answers_compiled`).
        Source: supplement 2.1; the explicit product of colour and opacity makes empty rays black.
        """
        if dispatch.answers_compiled(origins, directions, self.distance_grid.table) and self._is_plain:
            return self._answer_compiled(origins, directions, light_index)
        count = self.config.num_samples
        contracted = contract(origins, self.contraction_radius)
        encoded = [
            self.code(self.distance_grid(contracted)),
            positional_encoding(contracted, self.position_frequencies),
            positional_encoding(directions, self.config.num_frequencies),
        ]
        raw = self.distance_head(self.distance_network(torch.cat(encoded, dim=-1)))
        offset, gate, logit = raw[:, :-1].reshape(-1, 3, count).unbind(dim=1)
        distances = self._sample_distances(offset, gate)
        total = torch.sigmoid(raw[:, -1:] + 2.0)
        weights = torch.softmax(logit, dim=-1) * total
        opacity = weights.sum(dim=-1)
        points = origins[:, None] + distances[..., None] * directions[:, None]
        mixed = self.feature_grid.mixture(points, weights, self.contraction_radius)
        if self.origin_frequencies is not None:
            mixed = torch.cat([mixed, positional_encoding(origins, self.origin_frequencies)], dim=-1)
        if self.turns is not None:
            mixed = torch.cat([mixed, self.turns.code(light_index)], dim=-1)
        hidden = torch.relu(self.decoder[1](torch.relu(self.decoder[0](mixed))))
        colour = self._of_light(self.decoder_head(hidden), light_index)
        colour = torch.nn.functional.softplus(colour + self.colour_bias)
        mean = (weights * distances).sum(dim=-1) / opacity.clamp_min(LEAST_OPACITY)
        distance = torch.where(opacity < LEAST_OPACITY, torch.full_like(mean, self.far), mean)
        # Differs from the paper: colour times opacity (docs/decisions/0019-small-departures.md).
        return CacheAnswer(opacity[:, None] * colour, opacity, distance)

    def _answer_compiled(self, origins: Tensor, directions: Tensor, light_index: Tensor) -> CacheAnswer:
        """Return what `forward` does in torch, up to rounding; the decoder must see nothing but features."""
        layers = Layers()
        for layer in self.code.layers:
            layers.add(layer, blocks.RELU)
        layers.add_hidden(self.distance_network, self.distance_head)
        for layer in self.decoder:
            layers.add(layer, blocks.RELU)
        layers.add(self.decoder_head)
        start, end = (SECONDARY_CURVE.ladder(torch.tensor(limit)) for limit in (self.near, self.far))
        num_rays = len(origins)
        query = fast_query.FastQuery(
            num_code=len(self.code.layers),
            num_distance=len(self.distance_network.layers),
            num_samples=self.config.num_samples,
            num_lights=self.num_lights,
            position_frequencies=self.position_frequencies,
            direction_frequencies=self.config.num_frequencies,
            inverse_radius=np.float32(1.0 / self.contraction_radius),
            colour_bias=np.float32(self.colour_bias),
            far=np.float32(self.far),
            start=np.float32(start.item()),
            length=np.float32((end - start).item()),
            ladder=SECONDARY_CURVE.inverse_constants,
            widest=max(layers.widest, self.feature_grid.out_features),
            least_opacity=np.float32(LEAST_OPACITY),
        )
        answer = CacheAnswer(torch.empty(num_rays, 3), torch.empty(num_rays), torch.empty(num_rays))
        over_rows(
            fast_query.answer,
            num_rays,
            fast_query.RAYS,
            *arrays_of(origins, directions),
            packed_lights(light_index, self.num_lights),
            packed_grid(self.distance_grid),
            packed_grid(self.feature_grid),
            layers.packed(),
            query,
            *arrays_of(*answer),
        )
        return answer

    def at_turn(self, light_index: int) -> "FastCache":
        """Return the cache for one turn of the light: one that knows of no turns, with the same answers."""
        assert self.turns is not None, "this cache knows of no turns"
        still, code = copy.deepcopy(self), self.turns.codes[light_index]
        still.turns = None
        first = self.decoder[0]
        assert isinstance(first, nn.Linear)
        own = linear(first.in_features - len(code), first.out_features).to(first.weight)
        with torch.no_grad():
            own.weight.copy_(first.weight[:, : -len(code)])
            own.bias.copy_(first.bias + first.weight[:, -len(code) :] @ code)
        still.decoder[0] = own
        return still

    @property
    def _is_plain(self) -> bool:
        """Whether the decoder sees nothing but features: then there is compiled code."""
        return self.turns is None and self.origin_frequencies is None

    def _sample_distances(self, offset: Tensor, gate: Tensor) -> Tensor:
        """Spread the samples over the ray, shift each by its learned offset and fold back into [0, 1].

        Folding keeps every sample between near and far, so none needs a test of validity, which
        rounding would decide differently in every runtime.
        """
        count = self.config.num_samples
        ladder = torch.linspace(0.0, 1.0, count, device=offset.device, dtype=offset.dtype)
        shifted = ladder + offset / count * torch.sigmoid(gate - 2.0)
        whole = shifted.floor()
        rest = shifted - whole
        odd = whole - 2.0 * (whole / 2.0).floor()
        folded = rest + odd * (1.0 - 2.0 * rest)
        # Filled on the device: numbers that are copied there make a GPU wait.
        near, far = offset.new_full((), self.near), offset.new_full((), self.far)
        return SECONDARY_CURVE.distance(folded, near, far)

    def _of_light(self, values: Tensor, light_index: Tensor) -> Tensor:
        if self.num_lights == 1:
            return values
        values = values.reshape(len(values), self.num_lights, 3)
        return values[torch.arange(len(values), device=values.device), light_index]

"""The far field: radiance that arrives from outside the scene, one set of values per light.

Directions point towards the light, z up; texture convention as in `geometry.directions`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float, Float64, Int, Int64
from torch import Tensor, nn

from flashcache.encoding.directional import positional_encoding
from flashcache.encoding.turns import LightTurns
from flashcache.errors import ConfigError
from flashcache.fields.mlp import Hidden, linear
from flashcache.geometry.directions import environment_directions, look_up
from flashcache.geometry.octahedron import look_up_octahedral


@dataclass(frozen=True, kw_only=True, slots=True)
class EnvironmentConfig:
    """Representation of the environment (supplement 2.1)."""

    width: int = 256
    num_layers: int = 3
    last_width: int = 128
    num_frequencies: int = 4
    bias: float = -1.0
    lights: Literal["separate", "rotated"] = "separate"
    """"rotated" makes all lights rotations of one environment about +z, each by its own angle."""
    rotations_deg: tuple[float, ...] = ()
    """Angles of rotated lights in the scene's order; empty reads them from names such as `sunset_120`."""
    known_height: int = 128
    """Rows to which a given environment is resampled."""

    def __post_init__(self) -> None:
        if self.known_height < 2:
            raise ConfigError(f"known_height must be at least 2, got {self.known_height}")


class Environment(nn.Module):
    """Radiance of the surroundings by direction, not negative, linear Rec. 709.

    With `rotations_deg` all lights share one environment: that of a light is the shared one turned by its
    angle about +z. The environments of the lights `known` (indices; any of them means all where lights
    are rotated) are given by `set_known` and never learned. With `turns` a light index is the number of
    a turn of one environment, which is that of turn 0.
    """

    known_images: Tensor
    angles: Float64[Tensor, " lights"]
    """Of rotated lights, radians; empty where lights are not rotated."""
    known_place: Int64[Tensor, " lights"]
    """Of each light among the known ones; -1 for those that are learned."""
    learned_lights: Int64[Tensor, " learned"]
    texture: Float[Tensor, "lights cells 3"] | None
    """Radiance over octahedral squares, in place of the network's; None until there is one."""

    def __init__(
        self,
        config: EnvironmentConfig,
        num_lights: int,
        *,
        rotations_deg: Sequence[float] = (),
        known: Sequence[int] = (),
        turns: LightTurns | None = None,
    ) -> None:
        super().__init__()
        assert len(rotations_deg) in (0, num_lights), "one angle per light"
        self.config = config
        self.turns = turns
        self.rotations = tuple(math.radians(angle) for angle in rotations_deg)
        num_lights = 1 if self.rotations else num_lights
        self.num_lights = num_lights
        """Environments, one for all lights where they are rotated."""
        self.known = (0,) if self.rotations and known else tuple(known)
        if self.known:
            rows = config.known_height
            self.register_buffer("known_images", torch.zeros(len(self.known), rows, 2 * rows, 3))
        # Buffers: tensors that are made from lists in each step are copied to a GPU, which waits.
        place = [self.known.index(light) if light in self.known else -1 for light in range(self.num_lights)]
        constants = {
            "angles": torch.tensor(self.rotations, dtype=torch.float64),
            "known_place": torch.tensor(place),
            "learned_lights": torch.tensor(self.learned, dtype=torch.long),
        }
        for name, values in constants.items():
            self.register_buffer(name, values, persistent=False)
        self.register_buffer("texture", None)
        num_inputs = 3 + 6 * config.num_frequencies
        self.network = Hidden(num_inputs, config.width, config.num_layers, skip_after=config.num_layers)
        self.last = linear(self.network.num_outputs, config.last_width)
        self.head = linear(config.last_width, 3 * num_lights)

    @property
    def learned(self) -> tuple[int, ...]:
        """Return the indices of the environments that are learned."""
        return tuple(index for index in range(self.num_lights) if index not in self.known)

    def set_known(self, light: int, image: Float[Tensor, "height width 3"]) -> None:
        """Give the environment of a known light; `image` has `known_height` rows and twice as many columns.

        With rotated lights, it is the shared environment before rotation.
        """
        place = 0 if self.rotations else self.known.index(light)
        with torch.no_grad():
            self.known_images[place].copy_(image)

    def set_texture(self, texture: Float[Tensor, "lights cells 3"]) -> None:
        """Give the learned lights the radiance of octahedral squares, which networks are too smooth for.

        It is part of the state that checkpoints hold. Rows of known lights are not used.
        """
        self.texture = texture.detach().clone()

    def _load_from_state_dict(self, state_dict: dict, prefix: str, *arguments: Any) -> None:
        # Whether there is a texture is the state's to say: training ends without one, a polish with one.
        stored = state_dict.get(f"{prefix}texture")
        self.texture = None if stored is None else torch.empty_like(stored, device=self.angles.device)
        super()._load_from_state_dict(state_dict, prefix, *arguments)

    def forward(
        self, directions: Float[Tensor, "rays 3"], light_index: Int[Tensor, " rays"]
    ) -> Float[Tensor, "rays 3"]:
        """Return the radiance that arrives from `directions` (unit) in each ray's light."""
        if self.rotations:
            directions = self._turned_back(directions, light_index)
            light_index = torch.zeros_like(light_index)
        if self.turns is not None:
            directions = self.turns.to_light(directions, light_index)
            light_index = torch.zeros_like(light_index)
        if not self.known:
            return self._learned(directions, light_index)
        given = self._given(directions, light_index)
        if not self.learned:
            return given
        is_known = self.known_place[light_index] >= 0
        return torch.where(is_known[:, None], given, self._learned(directions, light_index))

    def _turned_back(self, directions: Tensor, light_index: Tensor) -> Tensor:
        """Return directions in the unrotated environment: `L_deg(d) = L_0(R_z(-deg) d)`."""
        angle = self.angles.to(directions.dtype)[light_index]
        cosine, sine = angle.cos(), angle.sin()
        x, y, z = directions.unbind(dim=-1)
        return torch.stack([cosine * x + sine * y, cosine * y - sine * x, z], dim=-1)

    def _learned(self, directions: Tensor, light_index: Tensor) -> Tensor:
        if self.texture is not None:
            return look_up_octahedral(self.texture, directions, light_index)
        hidden = torch.relu(
            self.last(self.network(positional_encoding(directions, self.config.num_frequencies)))
        )
        raw = self.head(hidden).reshape(-1, self.num_lights, 3)
        raw = (
            raw[:, 0] if self.num_lights == 1 else raw[torch.arange(len(raw), device=raw.device), light_index]
        )
        return torch.nn.functional.softplus(raw + self.config.bias)

    def _given(self, directions: Tensor, light_index: Tensor) -> Tensor:
        """Return the given radiance; that of any given light for rays of the others."""
        return look_up(self.known_images, directions, self.known_place[light_index].clamp_min(0))

    @torch.no_grad()
    def image(self, height: int, light: int = 0) -> Float[Tensor, "height width 3"]:
        """Return a light's latitude-longitude picture of linear radiance, `width = 2 height`."""
        device = next(self.parameters()).device
        directions = environment_directions(height, 2 * height).reshape(-1, 3).to(device)
        index = torch.full((len(directions),), light, dtype=torch.long, device=device)
        return self(directions, index).reshape(height, 2 * height, 3)

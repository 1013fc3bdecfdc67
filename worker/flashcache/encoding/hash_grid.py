"""Multi-resolution grid with the additive lattice hash (supplement 2.1; formula: `kernels.layout`)."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.errors import ConfigError
from flashcache.geometry.contraction import contract
from flashcache.kernels import dispatch
from flashcache.kernels.layout import GridLayout, build_layout, level_resolutions


@dataclass(frozen=True, kw_only=True, slots=True)
class HashGridConfig:
    """Size of a feature grid."""

    base_resolution: int = 16
    """Voxels per side of the coarsest level (authors' code: 16)."""
    finest_resolution: int = 256
    """Voxels per side of the finest level, at most 2048."""
    num_levels: int = 0
    """Levels, spaced geometrically; 0: as many as doubling needs."""
    num_features: int = 2
    """Features per voxel, 1 to 8."""
    log2_table_size: int = 17
    """Rows per level at most, as a power of two (authors' code: 19)."""
    half_extent: float = 1.0
    """The grid covers [-half_extent, half_extent]^3; points outside read its border."""
    output_scale: float = 1.0
    """Factor between the table and the features: how far a feature moves in a step of Adam's. The authors'
    code has 10."""

    def __post_init__(self) -> None:
        if not 1 <= self.num_features <= 8:
            raise ConfigError(f"num_features must be 1 to 8, got {self.num_features}")
        if not self.half_extent > 0.0:
            raise ConfigError(f"half_extent must be positive, got {self.half_extent}")
        if not self.output_scale > 0.0:
            raise ConfigError(f"output_scale must be positive, got {self.output_scale}")
        if self.num_levels < 0:
            raise ConfigError(f"num_levels must not be negative, got {self.num_levels}")


class HashGrid(nn.Module):
    """Features of points in a cube, interpolated from voxel grids of several resolutions.

    Features are `output_scale` times what the parameter `table` [rows, features] holds, and start uniform in
    +-1e-4; `layout` says which row is which voxel.
    A training loop that only calls `Tensor.backward` may set `in_place_gradient`: gradients are then added to
    an existing `table.grad` (keep it with `zero_grad(set_to_none=False)`), which saves a copy per call.
    The buffer `levels` puts the rows and the hash's multipliers into checkpoints; a table that was trained
    with others is refused by `load_state_dict`.
    """

    levels: Tensor

    def __init__(self, config: HashGridConfig) -> None:
        super().__init__()
        resolutions = level_resolutions(config.base_resolution, config.finest_resolution, config.num_levels)
        self.layout = build_layout(
            resolutions,
            num_features=config.num_features,
            log2_table_size=config.log2_table_size,
            half_extent=config.half_extent,
        )
        self.out_features = self.layout.num_outputs
        self.output_scale = config.output_scale
        self.in_place_gradient = False
        self.register_buffer("levels", _level_numbers(self.layout))
        self.table = nn.Parameter(torch.empty(self.layout.num_rows, config.num_features))
        nn.init.uniform_(self.table, -1e-4 / config.output_scale, 1e-4 / config.output_scale)

    def forward(self, z: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch outputs"]:
        """Return the features of `z`, levels coarse to fine; differentiable by `table` and `z`.

        `z` is in grid coordinates (contracted space) and is clamped to the cube.
        """
        features = dispatch.encode(
            z.reshape(-1, 3), self.table, self.layout, in_place_gradient=self.in_place_gradient
        )
        return self._scaled(features).reshape(*z.shape[:-1], self.out_features)

    def mixture(
        self,
        points: Float[Tensor, "rays samples 3"],
        weights: Float[Tensor, "rays samples"],
        radius: float,
    ) -> Float[Tensor, "rays outputs"]:
        """Return the sum along each ray of the features of its contracted `points`, times `weights`.

        `points` and `radius`, the radius that contraction maps to 1, are in scene units.
        """
        if dispatch.is_fused(self.table.device, self.table.dtype):
            from flashcache.kernels.gpu_mixture import encode_mixture

            mixed = encode_mixture(
                points, weights, self.table, self.layout, radius, in_place_gradient=self.in_place_gradient
            )
            return self._scaled(mixed)
        features = self(contract(points.reshape(-1, 3), radius))
        return (weights[..., None] * features.reshape(*weights.shape, self.out_features)).sum(dim=1)

    def encode_with_jacobian(
        self, z: Float[Tensor, "*batch 3"]
    ) -> tuple[Float[Tensor, "*batch outputs"], Float[Tensor, "*batch outputs 3"]]:
        """Return the features of `z` and their derivative by `z`; both are differentiable by `table`.

        With the gradient of a small network by the features this gives density normals whose loss needs no
        second derivative of the interpolation.
        """
        features, jacobian = dispatch.encode_with_jacobian(
            z.reshape(-1, 3), self.table, self.layout, in_place_gradient=self.in_place_gradient
        )
        batch = z.shape[:-1]
        return (
            self._scaled(features).reshape(*batch, self.out_features),
            self._scaled(jacobian).reshape(*batch, self.out_features, 3),
        )

    def fold_scale(self) -> None:
        """Multiply the table by the scale, which becomes one: the same features, for readers without one."""
        with torch.no_grad():
            self.table.mul_(self.output_scale)
        self.output_scale = 1.0

    def _scaled(self, values: Tensor) -> Tensor:
        return values if self.output_scale == 1.0 else self.output_scale * values

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, metadata: Any, strict: bool, *lists: list[str]
    ) -> None:
        """Take values from a checkpoint; a table whose rows mean other voxels is an error."""
        stored = state_dict.setdefault(prefix + "levels", self.levels)
        if stored.shape != self.levels.shape or not torch.equal(stored.cpu(), self.levels.cpu()):
            _missing, _unexpected, errors = lists
            errors.append(f"{prefix}levels: the grid was trained with other levels or another hash")
            return
        super()._load_from_state_dict(state_dict, prefix, metadata, strict, *lists)


def _level_numbers(layout: GridLayout) -> Int[Tensor, "levels 5"]:
    """Return resolution, first row, rows and multipliers of y and z per level."""
    return torch.tensor(
        [
            [level.resolution, level.first_row, level.num_rows, level.multiplier_y, level.multiplier_z]
            for level in layout.levels
        ]
    )

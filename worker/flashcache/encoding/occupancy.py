"""Cells of the scene's box that may hold something. Everywhere else the density is zero, for every reader.

Cells come from the masks of the photographs first (`flashcache.data.hull`), from the trained density later.
"""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor, nn

from flashcache.errors import ConfigError
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch
from flashcache.kernels.layout import dense_layout


@dataclass(frozen=True, kw_only=True, slots=True)
class OccupancyConfig:
    """The lattice of cells, and how the masks of photographs rule cells out."""

    cells: int = 0
    """Along each side of the scene's box; 0: everything may hold something, as in the paper."""
    margin_px: float = 2.0
    """Distance from a mask up to which a pixel may still show the object, pixels of the training pictures."""
    dissent: float = 0.1
    """Share of the views that see a cell which may see nothing of the object there, where masks disagree."""

    def __post_init__(self) -> None:
        if self.cells < 0 or self.cells == 1 or self.cells > 256:
            raise ConfigError(f"model.occupancy.cells must be 0 or 2..256, got {self.cells}")
        if self.margin_px < 0.0:
            raise ConfigError(f"model.occupancy.margin_px must not be negative, got {self.margin_px}")
        if not 0.0 <= self.dissent < 1.0:
            raise ConfigError(f"model.occupancy.dissent must lie in 0..1, got {self.dissent}")


class Occupancy(nn.Module):
    """A lattice over the scene's box that knows which cells may hold something: all of them at first.

    Densities are multiplied by `share`, which is 1 in the middles of cells that lie among others that may
    hold something, 0 in the middles of all others, and trilinear between: where programs that read a bundle
    round differently, it differs by no more than their rounding.
    """

    output_scale = 1.0
    """The table holds the shares themselves; as for `HashGrid`."""

    cells: UInt8[Tensor, "x y z"]
    table: Float[Tensor, "rows 1"]
    low: Float[Tensor, "3"]
    high: Float[Tensor, "3"]

    def __init__(
        self, low: tuple[float, float, float], high: tuple[float, float, float], resolution: int
    ) -> None:
        """`low` and `high` are corners of the box, scene units; `resolution` counts cells along a side."""
        super().__init__()
        self.layout = dense_layout(resolution)
        self.register_buffer("cells", torch.ones((resolution,) * 3, dtype=torch.uint8))
        self.register_buffer("table", torch.empty(resolution**3, 1), persistent=False)
        self.register_buffer("low", torch.tensor(low, dtype=torch.float32), persistent=False)
        self.register_buffer("high", torch.tensor(high, dtype=torch.float32), persistent=False)
        # Computed here, for reading it from a GPU in each call would wait for the GPU.
        self._step = 0.5 * float(self.size.min())
        self.set(self.cells > 0)

    @property
    def size(self) -> Float[Tensor, "3"]:
        """Return the sides of a cell, scene units."""
        return (self.high - self.low) / self.cells.shape[0]

    def share(self, positions: Float[Tensor, "points 3"]) -> Float[Tensor, " points"]:
        """Return the factor on densities at world positions, 0..1; 0 outside of the box."""
        half = 0.5 * (self.high - self.low)
        return dispatch.encode((positions - (self.low + half)) / half, self.table, self.layout)[:, 0]

    @torch.no_grad()
    def narrowed(self, rays: Rays) -> Rays:
        """Return rays that begin just before the first cell that may hold something, and end behind the last.

        A ray that meets none gets an empty stretch (`far == near`). Cells are looked for in steps of half of
        their shortest side, so the corner of one may be missed.
        """
        near, far = dispatch.stretch(rays, self.cells, self.low, self.high, self._step)
        return Rays(rays.origins, rays.directions, near, far)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        """Take cells from a checkpoint; the table follows from them."""
        super()._load_from_state_dict(state_dict, prefix, *rest)
        self.set(self.cells > 0)

    @torch.no_grad()
    def set(self, cells: Bool[Tensor, "x y z"]) -> None:
        """Replace the cells that may hold something, and the table that follows from them."""
        empty = torch.nn.functional.pad(1.0 - cells.float(), (1,) * 6, value=1.0)
        inner = 1.0 - torch.nn.functional.max_pool3d(empty[None, None], 3, stride=1)[0, 0]
        self.cells.copy_(cells.to(self.cells))
        # Rows of a dense level run along x first.
        self.table.copy_(inner.permute(2, 1, 0).reshape(-1, 1))

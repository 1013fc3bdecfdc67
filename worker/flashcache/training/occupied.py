"""Empty space, as a trained density sees it, is ruled out for all later steps."""

import torch
from torch import Tensor

from flashcache.caches.nerf_cache import NerfCache

LEAST_OPACITY = 0.002
"""Opacity across a cell from which it counts as filled."""
PLACES = 2
"""Places along each side of a cell at which the density is looked up."""
_CHUNK_CELLS = 1 << 14


@torch.no_grad()
def keep_filled(nerf: NerfCache) -> None:
    """Rule out the cells in which the density is next to nothing, and so in all cells around.

    A density that is next to nothing everywhere rules out none: it has not learned the scene yet.
    """
    occupancy = nerf.occupancy
    if occupancy is None:
        return
    index = (occupancy.cells > 0).nonzero()
    size = occupancy.size
    steps = (torch.arange(PLACES, device=size.device) + 0.5) / PLACES
    places = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), dim=-1).reshape(-1, 3)
    filled = torch.zeros_like(occupancy.cells, dtype=torch.bool)
    for some in index.split(_CHUNK_CELLS):
        points = occupancy.low + (some[:, None] + places) * size
        depth = nerf.density.density(points) * size.max()
        kept = some[-torch.expm1(-depth.amax(dim=-1)) > LEAST_OPACITY]
        filled[tuple(kept.unbind(dim=-1))] = True
    if not filled.any():
        return
    # Cells beside those count as well, and one layer more, on which the share of densities fades.
    occupancy.set(_grown(_grown(filled)) & (occupancy.cells > 0))


def _grown(cells: Tensor) -> Tensor:
    return torch.nn.functional.max_pool3d(cells[None, None].float(), 3, stride=1, padding=1)[0, 0] > 0.0

"""Densities from compiled code; see `flashcache.kernels.density_query`."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.encoding.occupancy import Occupancy
from flashcache.fields.density import DensityField, DensitySample
from flashcache.fields.packing import NO_GRID, Layers, packed_grid
from flashcache.kernels import density_query
from flashcache.kernels.lookup import Grid
from flashcache.kernels.ranges import over_rows

_NO_BOX = density_query.Box(False, np.zeros(3, np.float32), np.zeros(3, np.float32))


def packed_occupancy(occupancy: Occupancy | None) -> tuple[Grid, density_query.Box]:
    """Return the grid of an occupancy and its box, or stand-ins of the same types."""
    if occupancy is None:
        return NO_GRID, _NO_BOX
    half = 0.5 * (occupancy.high - occupancy.low)
    box = density_query.Box(True, (occupancy.low + half).numpy(), half.reciprocal().numpy())
    return packed_grid(occupancy), box


def add_density(layers: Layers, field: DensityField) -> density_query.Density:
    """Add the networks of a density field to `layers` and return what else is read of it."""
    begin = len(layers.rows)
    layers.add_hidden(field.network, field.head)
    return density_query.Density(
        begin=begin,
        end=len(layers.rows),
        sharpness=np.float32(field.network.softplus_beta or 1.0),
        bias=np.float32(field.config.bias),
        inverse_radius=np.float32(1.0 / field.contraction_radius),
    )


def sample(field: DensityField, positions: Float[Tensor, "points 3"]) -> DensitySample:
    """Return what `field.forward` does, up to rounding."""
    layers = Layers()
    query = add_density(layers, field)
    occupancy, box = packed_occupancy(field.occupancy)
    found = DensitySample(torch.empty(len(positions)), torch.empty(len(positions), field.network.num_outputs))
    arguments = (
        positions.contiguous().numpy(),
        tuple(packed_grid(field.grid)),
        tuple(layers.packed()),
        tuple(query),
        tuple(occupancy),
        tuple(box),
        layers.widest,
        *(part.numpy() for part in found),
    )
    over_rows(
        lambda begin, end: density_query.samples(begin, end, *arguments), len(positions), density_query.POINTS
    )
    return found

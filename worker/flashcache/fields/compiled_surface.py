"""Normals and outgoing radiance from compiled code; see `flashcache.kernels.surface_query`."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.encoding.directional import IntegratedDirectionalEncoding
from flashcache.fields.appearance import FACTOR_BIAS, RADIANCE_MAXIMUM, Appearance, AppearanceField
from flashcache.fields.density import NormalField
from flashcache.fields.packing import NO_GRID, Layers, packed_grid, packed_lights
from flashcache.kernels import surface_query
from flashcache.kernels.ranges import over_rows


def normals(
    field: NormalField, positions: Float[Tensor, "points 3"], hidden: Float[Tensor, "points width"]
) -> Float[Tensor, "points 3"]:
    """Return what `field.forward` does, up to rounding."""
    found = torch.empty_like(positions, memory_format=torch.contiguous_format)
    grid, layers = NO_GRID, Layers()
    if field.grid is None or field.network is None:
        layers.add(field.head)
    else:
        grid = packed_grid(field.grid)
        layers.add_hidden(field.network, field.head)
    arguments = (
        positions.contiguous().numpy(),
        hidden.contiguous().numpy(),
        field.grid is not None,
        tuple(grid),
        tuple(layers.packed()),
        np.float32(1.0 / field.contraction_radius),
        layers.widest,
        found.numpy(),
    )
    over_rows(
        lambda begin, end: surface_query.normals(begin, end, *arguments), len(positions), surface_query.POINTS
    )
    return found


def outgoing(
    field: AppearanceField,
    positions: Float[Tensor, "points 3"],
    hidden: Float[Tensor, "points width"],
    normal: Float[Tensor, "points 3"],
    omega_o: Float[Tensor, "points 3"],
    light_index: Int[Tensor, " points"],
    *,
    with_specular: bool,
) -> Appearance:
    """Return what `field.forward` does, up to rounding; for the architecture `ide` without turns."""
    found = Appearance(*torch.empty(3, len(positions), 3))
    layers = Layers()
    constants = _add_directional(layers, field.directional)
    layers.add(field.heads).add(field.bottleneck)
    factor = len(layers.rows)
    layers.add_hidden(field.factor, field.factor_head)
    reflection = len(layers.rows)
    layers.add_hidden(field.reflection, field.reflection_head)
    query = surface_query.Appearance(
        factor=factor,
        reflection=reflection,
        end=len(layers.rows),
        num_lights=field.num_lights,
        view_frequencies=field.view_frequencies,
        inverse_radius=np.float32(1.0 / field.contraction_radius),
        width_bias=np.float32(field.config.width_bias),
        factor_bias=np.float32(FACTOR_BIAS),
        most=np.float32(RADIANCE_MAXIMUM),
        with_specular=with_specular,
    )
    arguments = (
        *(part.contiguous().numpy() for part in (positions, hidden, normal, omega_o)),
        packed_lights(light_index, field.num_lights),
        tuple(packed_grid(field.grid)),
        tuple(layers.packed()),
        tuple(query),
        tuple(constants),
        layers.widest,
        *(part.numpy() for part in found),
    )
    over_rows(
        lambda begin, end: surface_query.outgoing(begin, end, *arguments),
        len(positions),
        surface_query.POINTS,
    )
    return found


def _add_directional(layers: Layers, encoding: IntegratedDirectionalEncoding) -> surface_query.Directional:
    """Add the polynomials as a layer and return the other constants."""
    layers.add_matrix(encoding.polynomials.T)
    # Of the powers of x + iy, each term has one.
    orders = encoding.orders.to(torch.int64).argmax(dim=0)
    return surface_query.Directional(orders.numpy(), encoding.rates.numpy())

"""The fast cache's answers from compiled code; see `flashcache.kernels.fast_query`."""

import numpy as np
import torch
from jaxtyping import Float, Int
from lambent_compute import blocks
from torch import Tensor

from flashcache.caches.fast_cache import LEAST_OPACITY, FastCache, FastCacheAnswer
from flashcache.fields.packing import Layers, packed_grid, packed_lights
from flashcache.kernels import fast_query
from flashcache.kernels.ranges import over_rows
from flashcache.volume.proposal_sampling import SECONDARY_CURVE


def answer(
    cache: FastCache,
    origins: Float[Tensor, "rays 3"],
    directions: Float[Tensor, "rays 3"],
    light_index: Int[Tensor, " rays"],
) -> FastCacheAnswer:
    """Return what `cache.forward` does, up to rounding; the decoder must see nothing but features."""
    count, num_rays = cache.config.num_samples, len(origins)
    found = FastCacheAnswer(
        *(
            torch.empty(shape)
            for shape in ((num_rays, 3), num_rays, num_rays, (num_rays, count), (num_rays, count))
        )
    )
    inputs = origins.contiguous().numpy(), directions.contiguous().numpy()
    arguments = (
        *inputs,
        packed_lights(light_index, cache.num_lights),
        tuple(packed_grid(cache.distance_grid)),
        tuple(packed_grid(cache.feature_grid)),
        *(tuple(part) for part in _query(cache)),
        *(part.numpy() for part in found),
    )
    over_rows(lambda begin, end: fast_query.answer(begin, end, *arguments), num_rays, fast_query.RAYS)
    return found


def _query(cache: FastCache) -> tuple[blocks.Networks, fast_query.FastQuery]:
    layers = Layers()
    for layer in cache.code.layers:
        layers.add(layer, blocks.RELU)
    layers.add_hidden(cache.distance_network, cache.distance_head)
    for layer in cache.decoder:
        layers.add(layer, blocks.RELU)
    layers.add(cache.decoder_head)
    near, far = torch.tensor(cache.near), torch.tensor(cache.far)
    start, end = SECONDARY_CURVE.ladder(near), SECONDARY_CURVE.ladder(far)
    query = fast_query.FastQuery(
        num_code=len(cache.code.layers),
        num_distance=len(cache.distance_network.layers),
        num_samples=cache.config.num_samples,
        num_lights=cache.num_lights,
        position_frequencies=cache.position_frequencies,
        direction_frequencies=cache.config.num_frequencies,
        inverse_radius=np.float32(1.0 / cache.contraction_radius),
        colour_bias=np.float32(cache.colour_bias),
        far=np.float32(cache.far),
        start=np.float32(start.item()),
        length=np.float32((end - start).item()),
        ladder=SECONDARY_CURVE.inverse_constants,
        widest=max(layers.widest, cache.feature_grid.out_features),
        least_opacity=np.float32(LEAST_OPACITY),
    )
    return layers.packed(), query

"""Memory of photographs that are no longer open."""

import tracemalloc

import numpy as np
from lambent_asset.textures.photo_choice import Observations, choose
from lambent_asset.textures.photo_nodes import nodes_of
from support.atlas_box import atlas_box

BOX = atlas_box(128)
VIEWS = 60
LARGEST, KEPT = 44.0, 30.0
"""Bytes for each node and photograph that sees 40 % of the nodes: what docs/reference/export.md says, and a
tenth more."""


def test_photographs_take_the_memory_that_the_page_says():
    nodes = nodes_of(BOX.size, BOX.texel_index, BOX.positions, BOX.texel_normals)
    rng, count = np.random.default_rng(0), len(nodes.texel)
    albedo = rng.uniform(0.2, 0.8, (count, 3)).astype(np.float32)
    choose(nodes, [], albedo)
    tracemalloc.start()
    try:
        seen = []
        for _ in range(VIEWS):
            on = np.flatnonzero(rng.random(count) < 0.4).astype(np.int32)
            rest = (rng.uniform(0.5, 1.0, len(on)).astype(np.float32) for _ in range(3))
            seen.append(Observations(on, albedo[on], *rest))
        choices = choose(nodes, seen, albedo)
        kept, largest = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(choices) == VIEWS
    assert largest / count / VIEWS < LARGEST
    assert kept / count / VIEWS < KEPT

"""The transport product as a graph, for runtimes other than ours: baked relighting of pixels, no weights.

    E        = transfer_direct . light_sh + transfer_indirect . light_sh (its first coefficients, per channel)
    s        = clip(visibility . sh_reflect, 0, 1)
    radiance = albedo_diffuse / pi max(E, 0) + s spec_prefiltered

`sh_reflect` are the harmonics of the mirror direction times the lobe's factor per band, `spec_prefiltered` is
specular reflectance times prefiltered radiance. Source: docs/reference/bundle-format.md (relight).
"""

import math
from collections.abc import Mapping

import numpy as np
import onnx
from jaxtyping import Float
from numpy import ndarray

from flashcache.export.onnx import GraphBuilder, WeightFile
from flashcache.export.signatures import documented

INDIRECT_COEFFICIENTS = 9


def relight_graph(
    num_direct: int, num_visibility: int, weights: WeightFile, metadata: Mapping[str, str]
) -> onnx.ModelProto:
    """Return the graph for the given numbers of coefficients of direct transfer and visibility."""
    graph = GraphBuilder("relight", "pixel", weights)
    direct = graph.input("transfer_direct", num_direct)
    indirect = graph.input("transfer_indirect", 3 * INDIRECT_COEFFICIENTS)
    visibility = graph.input("visibility", num_visibility)
    reflect = graph.input("sh_reflect", num_visibility)
    light = graph.fixed_input("light_sh", [num_direct, 3])
    albedo = graph.input("albedo_diffuse", 3)
    prefiltered = graph.input("spec_prefiltered", 3)

    arriving = graph.node("MatMul", direct, light)
    # Per channel: the coefficients of one channel lie three apart, so that pixels need one product only.
    low = graph.node("Gather", light, np.arange(INDIRECT_COEFFICIENTS, dtype=np.int32), axis=0)
    channel = np.tile(np.eye(3, dtype=np.float32), (INDIRECT_COEFFICIENTS, 1))
    bounced = graph.node("MatMul", indirect, graph.reshape(low, 3 * INDIRECT_COEFFICIENTS, 1) * channel)
    irradiance = graph.at_least(arriving + bounced, 0.0)
    free = graph.reduce("ReduceSum", visibility * reflect)
    free = graph.node("Clip", free, 0.0, 1.0)
    radiance = albedo * irradiance * (1.0 / math.pi) + prefiltered * free
    return documented(graph.finish({"radiance": (radiance, 3)}, metadata), "relight")


def relight(
    transfer_direct: Float[ndarray, "pixels direct"],
    transfer_indirect: Float[ndarray, "pixels 27"],
    visibility: Float[ndarray, "pixels visible"],
    sh_reflect: Float[ndarray, "pixels visible"],
    light_sh: Float[ndarray, "direct 3"],
    albedo_diffuse: Float[ndarray, "pixels 3"],
    spec_prefiltered: Float[ndarray, "pixels 3"],
) -> Float[ndarray, "pixels 3"]:
    """Return the expected output of the graph, computed in numpy."""
    count = len(transfer_direct)
    low = light_sh[:INDIRECT_COEFFICIENTS]
    bounced = np.einsum("pkc,kc->pc", transfer_indirect.reshape(count, INDIRECT_COEFFICIENTS, 3), low)
    irradiance = np.maximum(transfer_direct @ light_sh + bounced, 0.0)
    free = np.clip((visibility * sh_reflect).sum(axis=-1, keepdims=True), 0.0, 1.0)
    return albedo_diffuse * irradiance / math.pi + spec_prefiltered * free

"""The graphs of a bundle: camera ray to surface, point to materials, secondary ray to the fast cache's view.

Each is the function of the same name in `flashcache.export.reference`, which documents it. Inputs and outputs
are float32 with a free first axis.
"""

import json
from collections.abc import Mapping
from typing import cast

import numpy as np
import onnx
import torch

from flashcache.caches.fast_cache import LEAST_OPACITY, FastCache
from flashcache.caches.nerf_cache import SECONDARY_CURVE
from flashcache.export import layers
from flashcache.export.constants import fast_cache_constants, gbuffer_constants, material_constants
from flashcache.export.onnx import GraphBuilder, Value, WeightFile
from flashcache.export.reference import OPACITY_FLOOR, SURFACE_THICKNESS, UPRIGHT_OPACITY, GbufferRule
from flashcache.export.signatures import documented
from flashcache.export.stored_grids import OCCUPANCY, exported_grids
from flashcache.fields.materials import ALPHA_MINIMUM
from flashcache.physical.model import InverseModel

Metadata = Mapping[str, str]


def grid_metadata(model: InverseModel) -> str:
    """Return the levels of all grids as JSON: resolution, first row, rows, multipliers of y and z."""
    described = {
        name: {
            "features": grid.layout.num_features,
            "half_extent": grid.layout.half_extent,
            "levels": [
                [le.resolution, le.first_row, le.num_rows, le.multiplier_y, le.multiplier_z]
                for le in grid.layout.levels
            ],
        }
        for name, grid in exported_grids(model).items()
    }
    return json.dumps(described, separators=(",", ":"))


def gbuffer_graph(
    model: InverseModel, rule: GbufferRule, weights: WeightFile, metadata: Metadata
) -> onnx.ModelProto:
    """Return the graph: origin, direction -> surface seen by a camera ray."""
    graph = GraphBuilder("gbuffer", "ray", weights)
    origin, direction = graph.input("origin", 3), graph.input("direction", 3)
    start, end = _stretch(graph, rule, origin, direction)
    count, group = rule.num_samples, rule.group
    fractions = ((np.arange(count) + 0.5) / count).astype(np.float32)[None]
    entry = origin + direction * start
    inside = (end - start) * fractions
    _, density = _density(graph, model, _points_at(graph, entry, direction, inside))
    depth = graph.reshape(density, -1, count) * ((end - start) / float(count))
    # The sum over all earlier places, as a product: a running sum is missing in some runtimes.
    before = graph.node("MatMul", depth, np.triu(np.ones((count, count), np.float32), 1))
    weight = _hidden_share(graph, depth) * graph.node("Exp", -before)
    opacity = graph.reduce("ReduceSum", weight)
    share = 1.0 / graph.at_least(opacity, OPACITY_FLOOR)

    groups = count // group
    mass = graph.reduce("ReduceSum", graph.reshape(weight, -1, groups, group), keep=False)
    moment = graph.reduce("ReduceSum", graph.reshape(weight * inside, -1, groups, group), keep=False)
    middles = _points_at(graph, entry, direction, moment / graph.at_least(mass, 1e-6))
    properties = _surface(graph, model, middles)
    mass_column = graph.unsqueeze(mass, 2)

    def mean(name: str, size: int) -> Value:
        values = graph.reshape(properties[name], -1, groups, size)
        return graph.reduce("ReduceSum", mass_column * values, axis=1, keep=False)

    upright = graph.node("Relu", UPRIGHT_OPACITY - opacity) * np.array([[0.0, 0.0, 1.0]], np.float32)
    outputs = {
        "opacity": (opacity, 1),
        "distance": (graph.reduce("ReduceSum", weight * (inside + start)) * share, 1),
        "normal": (layers.normalise(graph, mean("normal", 3) + upright), 3),
        "albedo": (mean("albedo", 3) * share, 3),
        "perceptual_roughness": (mean("perceptual_roughness", 1) * share, 1),
        "metalness": (mean("metalness", 1) * share, 1),
    }
    return documented(graph.finish(outputs, {**gbuffer_constants(model, rule), **metadata}), "gbuffer")


def material_graph(model: InverseModel, weights: WeightFile, metadata: Metadata) -> onnx.ModelProto:
    """Return the graph: position -> surface properties."""
    graph = GraphBuilder("material", "point", weights)
    properties = _surface(graph, model, graph.input("position", 3))
    opacity = _hidden_share(graph, properties.pop("density") * SURFACE_THICKNESS)
    sizes = {"albedo": 3, "normal": 3, "perceptual_roughness": 1, "metalness": 1}
    outputs = {name: (value, sizes[name]) for name, value in properties.items()}
    outputs["opacity"] = (opacity, 1)
    return documented(graph.finish(outputs, {**material_constants(model), **metadata}), "material")


def fast_cache_graph(
    model: InverseModel, light: int, weights: WeightFile, metadata: Metadata
) -> onnx.ModelProto:
    """Return the graph: origin, direction -> near radiance under one training light, opacity, distance."""
    rows, name = slice(3 * light, 3 * light + 3), model.domain.lights[light]
    return _cache_graph(model.fast, rows, name, "fast", f"fast.decoder_head.{name}", weights, metadata)


def adapted_cache_graph(
    fast: FastCache, light: str, weights: WeightFile, metadata: Metadata
) -> onnx.ModelProto:
    """Return the graph of a fast cache that was adapted to a light; same inputs and outputs.

    Tensors of the radiance are called `adapted.<light>.*`; those of the geometry are the trained cache's, and
    must equal those that `weights` has.
    """
    prefix = adapted_prefix(light)
    return _cache_graph(fast, slice(0, 3), light, prefix, f"{prefix}.decoder_head", weights, metadata)


def adapted_prefix(light: str) -> str:
    """Return the prefix of the names of an adapted cache's own tensors and grid."""
    return f"adapted.{light}"


def _cache_graph(
    fast: FastCache,
    rows: slice,
    light: str,
    prefix: str,
    head_name: str,
    weights: WeightFile,
    metadata: Metadata,
) -> onnx.ModelProto:
    """Return a fast cache's graph; `prefix` begins the names of what only its radiance needs."""
    graph = GraphBuilder(f"fast_cache_{light}", "ray", weights)
    origin, direction = graph.input("origin", 3), graph.input("direction", 3)
    radius = fast.contraction_radius
    count, frequencies = fast.config.num_samples, fast.config.num_frequencies

    contracted = layers.contract(graph, origin, radius)
    code = layers.hash_grid(graph, "fast.distance_grid", fast.distance_grid, contracted)
    encoded = [
        layers.hidden(graph, "fast.code", fast.code, code),
        layers.positional_encoding(graph, contracted, frequencies),
        layers.positional_encoding(graph, direction, frequencies),
    ]
    last = layers.hidden(graph, "fast.distance_network", fast.distance_network, graph.concat(encoded))

    def head(name: str, rows: slice) -> Value:
        layer = fast.distance_head
        return layers.affine(graph, f"fast.{name}_head", layer.weight[rows], layer.bias[rows], last)

    distances = _sample_distances(
        graph, fast, head("offset", slice(0, count)), head("gate", slice(count, 2 * count))
    )
    share = graph.node("Softmax", head("logit", slice(2 * count, 3 * count)), axis=-1)
    weight = share * graph.node("Sigmoid", head("opacity", slice(3 * count, None)) + 2.0)
    opacity = graph.reduce("ReduceSum", weight)

    points = layers.contract(graph, _points_at(graph, origin, direction, distances), radius)
    features = layers.hash_grid(graph, f"{prefix}.feature_grid", fast.feature_grid, points)
    features = graph.reshape(features, -1, count, fast.feature_grid.out_features)
    values = graph.reduce("ReduceSum", graph.unsqueeze(weight, 2) * features, axis=1, keep=False)
    for index, layer in enumerate(fast.decoder):
        values = graph.node(
            "Relu", layers.linear(graph, f"{prefix}.decoder.{index}", cast(torch.nn.Linear, layer), values)
        )
    decoder_head = fast.decoder_head
    colour = layers.affine(graph, head_name, decoder_head.weight[rows], decoder_head.bias[rows], values)

    mean = graph.reduce("ReduceSum", weight * distances) / graph.at_least(opacity, LEAST_OPACITY)
    distance = graph.node(
        "Where", graph.node("Less", opacity, graph.value(LEAST_OPACITY)), graph.value(fast.far), mean
    )
    outputs = {
        "radiance": (opacity * layers.softplus(graph, colour + fast.colour_bias), 3),
        "opacity": (opacity, 1),
        "distance": (distance, 1),
    }
    return documented(graph.finish(outputs, {**fast_cache_constants(fast), **metadata}), "fast_cache")


def _sample_distances(graph: GraphBuilder, fast: FastCache, offset: Value, gate: Value) -> Value:
    """Return the distances [row, samples] of the fast cache's samples (`FastCache._sample_distances`)."""
    with graph.part("sample_distances"):
        count = fast.config.num_samples
        ladder = torch.linspace(0.0, 1.0, count).numpy()[None]
        shifted = offset / float(count) * graph.node("Sigmoid", gate - 2.0) + ladder
        whole = graph.node("Floor", shifted)
        rest = shifted - whole
        odd = whole - graph.node("Floor", whole / 2.0) * 2.0
        folded = rest + odd * (1.0 - rest * 2.0)
        power, premultiplier = SECONDARY_CURVE.power, SECONDARY_CURVE.premultiplier
        a = abs(power - 1.0)
        first, last = (SECONDARY_CURVE.ladder(torch.tensor(t)) for t in (fast.near, fast.far))
        y = folded * (last - first).item() + first.item()
        stretched = graph.node("Pow", y * power / a + 1.0, graph.value(1.0 / power))
        return (stretched - 1.0) * (a / premultiplier)


def _stretch(graph: GraphBuilder, rule: GbufferRule, origin: Value, direction: Value) -> tuple[Value, Value]:
    """Return where rays enter and leave the box (`reference.stretch`)."""
    with graph.part("box"):
        tiny = graph.value(1e-9)
        safe = graph.node("Where", graph.node("Less", graph.node("Abs", direction), tiny), tiny, direction)
        first = (np.array([rule.box_min], np.float32) - origin) / safe
        second = (np.array([rule.box_max], np.float32) - origin) / safe
        start = graph.at_least(graph.reduce("ReduceMax", graph.minimum(first, second)), 0.0)
        return start, graph.maximum(graph.reduce("ReduceMin", graph.maximum(first, second)), start)


def _points_at(graph: GraphBuilder, origin: Value, direction: Value, distances: Value) -> Value:
    """Return the points [row * samples, 3] at distances [row, samples] along rays."""
    with graph.part("points"):
        steps = graph.unsqueeze(distances, 2) * graph.unsqueeze(direction, 1)
        return graph.reshape(graph.unsqueeze(origin, 1) + steps, -1, 3)


def _hidden_share(graph: GraphBuilder, depth: Value) -> Value:
    """Return 1 - exp(-depth) as 2 T / (1 + T), T = tanh(depth / 2), which keeps small depths exact."""
    half = graph.node("Tanh", depth * 0.5)
    return half * 2.0 / (half + 1.0)


def _density(graph: GraphBuilder, model: InverseModel, positions: Value) -> tuple[Value, Value]:
    """Return hidden feature [point, width] and density [point, 1] (`DensityField.forward`)."""
    field = model.nerf.density
    z = layers.contract(graph, positions, field.contraction_radius)
    features = layers.hash_grid(graph, "nerf.density.grid", field.grid, z)
    hidden = layers.hidden(graph, "nerf.density.network", field.network, features)
    raw = layers.linear(graph, "nerf.density.head", field.head, hidden) + field.config.bias
    density = graph.node("Exp", graph.minimum(raw, 70.0))
    occupancy = model.nerf.occupancy
    if occupancy is not None:
        low, high = layers.array_of(occupancy.low)[None], layers.array_of(occupancy.high)[None]
        half = np.float32(0.5) * (high - low)
        place = (positions - (low + half)) / half
        density = density * layers.hash_grid(graph, OCCUPANCY, occupancy, place)
    return hidden, density


def _surface(graph: GraphBuilder, model: InverseModel, positions: Value) -> dict[str, Value]:
    """Return normal, materials and density at points [point, 3] (`reference.surface`)."""
    hidden, density = _density(graph, model, positions)
    normals = model.nerf.normals
    if normals.grid is None or normals.network is None:
        raw_normal = layers.linear(graph, "nerf.normals.head", normals.head, hidden)
    else:
        z = layers.contract(graph, positions, normals.contraction_radius)
        features = layers.hash_grid(graph, "nerf.normals.grid", normals.grid, z)
        inner = layers.hidden(
            graph, "nerf.normals.network", normals.network, graph.concat([features, hidden])
        )
        raw_normal = layers.linear(graph, "nerf.normals.head", normals.head, inner)
    return {
        "normal": -layers.normalise(graph, raw_normal),
        "density": density,
        **_materials(graph, model, positions),
    }


def _materials(graph: GraphBuilder, model: InverseModel, positions: Value) -> dict[str, Value]:
    """Return albedo, perceptual roughness and metalness (`MaterialField.forward`).

    The field's two layers have nothing between them: they are multiplied here, and only the used rows kept.
    Where GGX width and metalness have a grid of their own, its levels follow those of albedo, which the heads
    of either leave out by weights of zero.
    """
    field = model.materials
    z = layers.contract(graph, positions, field.contraction_radius)
    features = layers.hash_grid(graph, "materials.grid", exported_grids(model)["materials.grid"], z)
    weight = field.head.weight.double() @ field.bottleneck.weight.double()
    bias = field.head.weight.double() @ field.bottleneck.bias.double() + field.head.bias.double()
    if field.gloss is not None:
        own = field.gloss.head
        weight = torch.nn.functional.pad(weight, (0, own.in_features))
        for row, gloss in zip((6, 8), range(2), strict=True):
            weight[row] = 0.0
            weight[row, -own.in_features :] = own.weight[gloss].double()
            bias[row] = own.bias[gloss].double()

    def head(name: str, rows: slice, start: float) -> Value:
        part = layers.affine(graph, f"materials.{name}", weight[rows], bias[rows], features)
        return graph.node("Sigmoid", part + start)

    config = field.config
    alpha = head("alpha", slice(6, 7), config.alpha_bias) * (1.0 - ALPHA_MINIMUM) + ALPHA_MINIMUM
    return {
        "albedo": head("albedo", slice(0, 3), config.albedo_bias),
        "perceptual_roughness": graph.node("Sqrt", alpha),
        "metalness": head("metalness", slice(8, 9), config.metalness_bias),
    }

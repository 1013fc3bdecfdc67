"""The numbers that a reader needs, besides the tensors, to evaluate a network without running its graph.

They travel with each graph as metadata. Source: docs/reference/bundle-format.md (networks).
"""

import json
from typing import Any

from flashcache.caches.fast_cache import FastCache
from flashcache.caches.nerf_cache import SECONDARY_CURVE
from flashcache.export.reference import GbufferRule
from flashcache.fields.materials import ALPHA_MINIMUM
from flashcache.physical.model import InverseModel

METADATA_KEY = "lambent.network"


def gbuffer_constants(model: InverseModel, rule: GbufferRule) -> dict[str, str]:
    """Return the metadata of a gbuffer graph."""
    own = {
        "box_min": list(rule.box_min),
        "box_max": list(rule.box_max),
        "num_samples": rule.num_samples,
        "group": rule.group,
    }
    return _metadata(f"gbuffer.{_version(model)}", {**_surface(model), **own})


def material_constants(model: InverseModel) -> dict[str, str]:
    """Return the metadata of a material graph."""
    return _metadata(f"material.{_version(model)}", _surface(model))


def fast_cache_constants(fast: FastCache) -> dict[str, str]:
    """Return the metadata of a fast cache's graph."""
    values = {
        "contraction_radius": fast.contraction_radius,
        "near": fast.near,
        "far": fast.far,
        "num_frequencies": fast.config.num_frequencies,
        "colour_bias": fast.colour_bias,
        "curve_power": SECONDARY_CURVE.power,
        "curve_premultiplier": SECONDARY_CURVE.premultiplier,
    }
    return _metadata("fast_cache.v1", values)


def _version(model: InverseModel) -> str:
    return "v1" if model.nerf.occupancy is None else "v2"


def _surface(model: InverseModel) -> dict[str, Any]:
    density, materials = model.nerf.density.config, model.materials.config
    occupancy = model.nerf.occupancy
    box = {}
    if occupancy is not None:
        box = {"occupancy_min": occupancy.low.tolist(), "occupancy_max": occupancy.high.tolist()}
    return {
        **box,
        "contraction_radius": model.domain.contraction_radius,
        "softplus_beta": density.softplus_beta,
        "density_bias": density.bias,
        "albedo_bias": materials.albedo_bias,
        "alpha_bias": materials.alpha_bias,
        "metalness_bias": materials.metalness_bias,
        "alpha_minimum": ALPHA_MINIMUM,
    }


def _metadata(kind: str, values: dict[str, Any]) -> dict[str, str]:
    return {METADATA_KEY: json.dumps({"kind": kind, **values}, separators=(",", ":"))}

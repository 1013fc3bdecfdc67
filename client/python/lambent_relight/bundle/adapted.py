"""Fast caches that were adapted to an environment (`lambent bake-light`), and whether one fits a picture.

An adapted cache returns the radiance of all bounces, under one light and for one material. Its graph
describes these in the metadata `lambent.adapted`. Source: docs/reference/bundle-format.md.
"""

import hashlib
import json
import math
from dataclasses import dataclass

import numpy as np
from lambent_core.errors import BundleError

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.onnx_check import metadata
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.maps import Environment

METADATA_KEY = "lambent.adapted"
_LEAST_DEGREES = 0.01
_LEAST_RATIO = 1e-3


@dataclass(frozen=True, kw_only=True)
class AdaptedLight:
    """The light and albedo that a cache was adapted to."""

    name: str
    """The graph's light in the manifest."""
    environment_sha256: str
    """`environment_digest` of the map, before it was turned."""
    rotate_deg: float
    """Rotation of the light about +z."""
    albedo_ratio: tuple[float, float, float]
    """Factor on the stored albedo, per channel."""

    def to_json(self) -> str:
        """Return the value of the metadata entry."""
        return json.dumps(
            {
                "environment_sha256": self.environment_sha256,
                "rotate_deg": self.rotate_deg,
                "albedo_ratio": list(self.albedo_ratio),
            }
        )


def environment_digest(environment: Environment) -> str:
    """Return the SHA-256 of a map's size and its float32 radiance, little endian, whatever its rotation."""
    radiance = np.ascontiguousarray(environment.radiance, "<f4")
    size = ",".join(str(number) for number in radiance.shape)
    return hashlib.sha256(size.encode() + b"\n" + radiance.tobytes()).hexdigest()


def adapted_lights(bundle: Bundle) -> list[AdaptedLight]:
    """Return the lights to which a bundle's fast caches were adapted, in the manifest's order.

    Raises BundleError `bundle.graph_damaged` where a graph says so in a form that cannot be read.
    """
    lights = []
    for graph in bundle.manifest.graphs:
        if graph.name != "fast_cache":
            continue
        text = metadata(bundle.graph(graph.path)).get(METADATA_KEY, "")
        if text:
            lights.append(_parsed(graph.light, graph.path, text))
    return lights


def _parsed(name: str, path: str, text: str) -> AdaptedLight:
    try:
        values = json.loads(text)
        red, green, blue = (float(value) for value in values["albedo_ratio"])
        light = AdaptedLight(
            name=name,
            environment_sha256=str(values["environment_sha256"]),
            rotate_deg=float(values["rotate_deg"]),
            albedo_ratio=(red, green, blue),
        )
        if not math.isfinite(light.rotate_deg) or not min(light.albedo_ratio) > 0.0:
            raise ValueError("values out of range")
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise BundleError(
            "bundle.graph_damaged",
            f'"{path}" does not say what it was adapted to ({type(error).__name__}: {str(error)[:100]})',
            "adapt it again with lambent bake-light",
        ) from error
    return light


def misfit(light: AdaptedLight, environment: Environment, edit: MaterialEdit) -> str:
    """Return why a cache is not valid for this environment and material; empty if it is."""
    if environment_digest(environment) != light.environment_sha256:
        return "it was adapted to another map"
    apart = (environment.rotate_deg - light.rotate_deg + 180.0) % 360.0 - 180.0
    if abs(apart) > _LEAST_DEGREES:
        return f"the light is turned by {environment.rotate_deg:g} degrees, not {light.rotate_deg:g}"
    if edit.albedo is not None or edit.roughness_scale != 1.0:
        return "the material is edited"
    gains = np.asarray(edit.albedo_gain) / np.asarray(light.albedo_ratio)
    if np.abs(gains - 1.0).max() > _LEAST_RATIO:
        return f"the albedo is multiplied by {edit.albedo_gain}, not {light.albedo_ratio}"
    return ""


def error_names(light: str) -> tuple[str, str]:
    """Return the names of the metrics for the errors of a cache and of baked transport.

    Root mean squared errors divided by the mean, relative to the physical model on rays not used in training.
    """
    return f"adapted_error_{light}", f"transport_error_{light}"


def outdone(bundle: Bundle, light: AdaptedLight) -> str:
    """Return why baked transport is preferred to a cache; empty if it is not better, or was not compared."""
    adapted, transport = (bundle.manifest.metrics.get(name) for name in error_names(light.name))
    if adapted is None or transport is None or adapted < transport:
        return ""
    return f"its error is {adapted:.2g}, that of baked transport {transport:.2g}"


def choose(
    bundle: Bundle, environment: Environment, edit: MaterialEdit, *, although_worse: bool = False
) -> tuple[AdaptedLight | None, str]:
    """Return the first adapted cache that fits an environment (as turned) and a material.

    The text says why none is used although the bundle has some; it is empty otherwise.
    A cache that was worse than baked transport when it was baked is skipped, unless `although_worse`.
    """
    reasons = []
    for light in adapted_lights(bundle):
        reason = misfit(light, environment, edit) or ("" if although_worse else outdone(bundle, light))
        if not reason:
            return light, ""
        reasons.append(f'"{light.name}": {reason}')
    return None, "; ".join(reasons)

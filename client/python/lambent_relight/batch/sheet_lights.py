"""A chrome and a grey ball for every environment of a batch, for its contact sheet."""

from collections.abc import Mapping

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_core.errors import RelightError
from PIL import Image

from lambent_relight.batch.manifest import Light, Manifest
from lambent_relight.environment.input import open_environment
from lambent_relight.environment.probes import GREY
from lambent_relight.probe_overlay import LightProbes

SIDE = 32
"""Width of a ball, pixels."""
MAX_LIGHTS = 200
"""Environments above this number are not drawn: each map has to be read."""


def light_pictures(manifest: Manifest) -> Mapping[str, Image.Image]:
    """Return a picture of both balls, seen from +x, for every environment whose map can be read here.

    Each is exposed so that the grey ball's mean is middle grey: maps differ by any factor.
    """
    pictures: dict[str, Image.Image] = {}
    known: tuple[object, LightProbes] | None = None
    for light in sorted(manifest.environments[:MAX_LIGHTS], key=lambda each: str(each.map)):
        if light.map is None or not light.map.is_file():
            continue
        key = (light.map, light.given)
        if known is None or known[0] != key:
            try:
                known = (key, LightProbes(open_environment(light.map, light).environment))
            except (RelightError, OSError):
                # The pictures of this map are listed as failed, with the reason.
                continue
        pictures[light.called] = _picture(known[1], light)
    return pictures


def _picture(probes: LightProbes, light: Light) -> Image.Image:
    pair = probes.pair(SIDE, rotate_deg=light.rotate_deg)
    grey = slice(pair.rgb.shape[1] - SIDE, None)
    weight = pair.opacity[:, grey]
    mean = float((pair.rgb[:, grey] * weight).sum() / (3.0 * max(float(weight.sum()), 1e-6)))
    colour = srgb_from_linear(pair.rgb * (GREY / mean if mean > 0.0 else 1.0))
    pixels = np.round(255.0 * np.concatenate([colour, pair.opacity], axis=-1)).astype(np.uint8)
    return Image.fromarray(pixels)

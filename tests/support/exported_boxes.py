"""A bundle of three boxes whose graphs, mesh, maps and baked transport all show the same, exactly."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from google.protobuf import json_format
from lambent_asset.textures.surface import AtlasSurface
from lambent_core.directions import pixel_directions
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.baked.raster import rasterise
from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import write_environment
from support.analytic_bundle import write_manifest
from support.baked_bundle import boxes_surface, write_baked_bundle
from support.viewer_fixture import SCENE

SIDE = 32
NAMES = ("slab", "block", "metal block")


def sky(height: int = 32) -> np.ndarray:
    """Return a sky that is brighter above, with a soft sun: [height, 2 height, 3], linear."""
    direction = pixel_directions(height, 2 * height)
    towards = np.array([0.5, -0.45, 0.74])
    sun = 12.0 * np.exp(30.0 * (direction @ towards - 1.0))[..., None] * np.array([1.0, 0.9, 0.7])
    return (0.35 + 0.25 * direction[..., 2:] + sun).astype(np.float32)


def write_boxes(folder: Path, cameras: Sequence[Camera]) -> AtlasSurface:
    """Write the bundle, lit by `sky` as its recovered light, and return its surface."""
    write_baked_bundle(folder, SCENE, side=SIDE, cameras=list(cameras))
    (folder / "env").mkdir(exist_ok=True)
    write_environment(folder / "env" / "trained_sky.exr", sky(), half=False)
    write_manifest(folder, json_format.Parse((folder / "manifest.json").read_text(), BundleManifest()))
    return boxes_surface(SCENE, SIDE)[0]


def object_of_pixel(surface: AtlasSurface, camera: Camera) -> np.ndarray:
    """Return the number of the box that each pixel's centre shows, -1 for none: [height, width]."""
    face = rasterise(surface.vertices, surface.faces, camera).face
    return np.where(face >= 0, face // 12, -1)

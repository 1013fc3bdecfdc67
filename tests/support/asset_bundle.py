"""A bundle of one box with a textured mesh, recovered light and exact graphs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from google.protobuf import json_format
from lambent_asset.bundle.glb import write_glb
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.textures import TextureSet
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import write_environment
from support.analytic_bundle import write_analytic_bundle, write_manifest
from support.analytic_scene import AnalyticScene, Box, Surface
from support.atlas_box import SIZES, coloured

PAINT = Surface(albedo=(0.7, 0.5, 0.3), perceptual_roughness=0.8, metalness=0.0)


def painted(surface: AtlasSurface, paint: Surface = PAINT) -> TextureSet:
    """Return textures of one material everywhere."""
    plain = coloured(surface, np.broadcast_to(np.float32(paint.albedo), (len(surface.texel_index), 3)))
    return replace(
        plain,
        perceptual_roughness=np.full_like(plain.perceptual_roughness, paint.perceptual_roughness),
        metalness=np.full_like(plain.metalness, paint.metalness),
    )


def write_asset_bundle(
    folder: Path,
    surface: AtlasSurface,
    textures: TextureSet,
    *,
    radiance: np.ndarray | None = None,
    cameras: Sequence[Camera] | None = None,
    albedo_scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> Path:
    """Write a bundle whose graphs show the box in `PAINT` and whose mesh is `surface`; return its folder.

    `radiance` is the recovered map of its light "sky", by default even light of 1.
    """
    half = SIZES / 2.0
    write_analytic_bundle(folder, AnalyticScene([Box(tuple(-half), tuple(half), PAINT)]), cameras)
    (folder / "mesh").mkdir()
    (folder / "mesh" / "asset.glb").write_bytes(write_glb(surface, textures, unit="unknown"))
    light = np.ones((8, 16, 3), np.float32) if radiance is None else radiance
    write_environment(folder / "env" / "trained_sky.exr", light)
    manifest = json_format.Parse((folder / "manifest.json").read_text(), BundleManifest())
    manifest.albedo_scale_rgb[:] = albedo_scale
    write_manifest(folder, manifest)
    return folder

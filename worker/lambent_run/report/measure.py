"""Compares a bundle with the trained model: metrics for its manifest, and small pictures of a few views."""

import dataclasses
from pathlib import Path

import numpy as np
from flashcache.evaluation.views import render_gbuffer
from flashcache.physical.model import InverseModel
from jaxtyping import Float
from lambent_asset.bundle.surface_files import silhouette_iou
from lambent_asset.mesh.mesh_depth import NUM_VIEWS, depth_agreement, relight_camera
from lambent_asset.textures.surface import AtlasSurface
from lambent_core.scene import Camera, View, evenly_spaced
from lambent_relight.bundle.graphs import SurfaceCaches
from numpy import ndarray

from lambent_run.report import figures
from lambent_run.report.predictions import over_white

SHOWN_VIEWS = 2
SHOWN_SIDE = 128
"""Pixels along the longer side."""
PHOTO_SIDE = 512
SOLID = 0.9
"""Pixels of at least this opacity take part in the comparison of distances."""


def measure(
    model: InverseModel,
    caches: SurfaceCaches,
    surface: AtlasSurface,
    views: tuple[View, ...],
    light: str,
    folder: Path,
) -> dict[str, float]:
    """Return metrics over a few views; write the NeRF cache's pictures of them, and photographs, to `folder`.

    `psnr_views` compares the cache's picture with the photograph, sRGB over white. `gbuffer_opacity_error`
    and `gbuffer_distance_error` (scene units, median) compare the exported surface, as `caches` read it,
    with the traced one, whose samples are placed by proposal networks. `mesh_depth_*_pixels` are those of
    `DepthAgreement`, over more views; absent where no view shows mesh and volume.
    """
    shown = evenly_spaced(views, SHOWN_VIEWS)
    by_view = [_measure_view(model, caches, surface, view, light, folder) for view in shown]
    means = {name: float(np.mean([values[name] for values in by_view])) for name in by_view[0]}
    depth = depth_agreement(model, surface.vertices, surface.faces, evenly_spaced(views, NUM_VIEWS))
    if depth is None:
        return means
    return means | {
        "mesh_depth_median_pixels": depth.median,
        "mesh_depth_p95_pixels": depth.p95,
        "mesh_depth_worst_view_p95_pixels": depth.worst_p95,
    }


def _measure_view(
    model: InverseModel, caches: SurfaceCaches, surface: AtlasSurface, view: View, light: str, folder: Path
) -> dict[str, float]:
    camera, photograph = _reduced(view.camera, view.images[light])
    traced = render_gbuffer(model, camera, light=model.light_at(0, view.light_turn))
    opacity = traced.opacity
    straight = traced.cache_rgb / np.maximum(opacity, 1e-3)
    seen = over_white(np.concatenate([straight, opacity], axis=-1))
    wanted = over_white(photograph)
    (folder / f"{view.name}.png").write_bytes(figures.png(seen, max_side=SHOWN_SIDE))
    (folder / f"photo_{view.name}.png").write_bytes(_photograph(view.images[light]))
    exported = caches.gbuffer(*relight_camera(view.name, camera).rays())
    shape = opacity.shape
    exported_opacity, exported_distance = exported.opacity.reshape(shape), exported.distance.reshape(shape)
    solid = (opacity > SOLID) & (exported_opacity > SOLID)
    apart = np.abs(exported_distance - traced.distance)[solid]
    return {
        "psnr_views": float(-10.0 * np.log10(np.mean((seen - wanted) ** 2) + 1e-12)),
        "gbuffer_opacity_error": float(np.abs(exported_opacity - opacity).mean()),
        "gbuffer_distance_error": float(np.median(apart)) if apart.size else 0.0,
        "mesh_silhouette_iou": silhouette_iou(surface, relight_camera(view.name, camera), opacity),
    }


def write_photographs(views: tuple[View, ...], light: str, folder: Path) -> None:
    """Write the photographs of the views that `measure` shows, in one light, to `folder`."""
    for view in evenly_spaced(views, SHOWN_VIEWS):
        (folder / f"photo_{view.name}.png").write_bytes(_photograph(view.images[light]))


def _photograph(image: Float[ndarray, "height width 4"]) -> bytes:
    """Return a photograph for comparison in viewers: PNG, sRGB over white."""
    return figures.png(over_white(image), max_side=PHOTO_SIDE)


def _reduced(
    camera: Camera, image: Float[ndarray, "height width 4"]
) -> tuple[Camera, Float[ndarray, "rows columns 4"]]:
    """Return a photograph of at most `SHOWN_SIDE` pixels, by means over blocks of pixels, and its camera."""
    block = -(-max(camera.width, camera.height) // SHOWN_SIDE)
    columns, rows = camera.width // block, camera.height // block
    camera = dataclasses.replace(camera, width=columns * block, height=rows * block).resized(columns, rows)
    image = image[: rows * block, : columns * block]
    weighted = np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], axis=-1)
    means = weighted.reshape(rows, block, columns, block, 4).mean(axis=(1, 3))
    straight = means[..., :3] / np.maximum(means[..., 3:], 1e-6)
    return camera, np.concatenate([straight, means[..., 3:]], axis=-1)

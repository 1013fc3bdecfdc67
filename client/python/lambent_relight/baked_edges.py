"""Soft silhouettes: how much of the pixels at the mesh's border the trained volume really covers.

A mesh ends sharply where the volume it was made from fades out. Pixels at the border are few, so they are
asked of the bundle's `gbuffer` function, as every pixel of a refined picture is; inside, the mesh decides.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lambent_relight.baked_view import BakedView
from lambent_relight.graphs import SurfaceCaches
from lambent_relight.views import MIN_OPACITY, grown, rays_of_pixels


def with_soft_edges(view: BakedView, caches: SurfaceCaches, antialias: int) -> BakedView:
    """Return `view` with the volume's coverage in all pixels within one of the mesh's border.

    A pixel that the mesh misses shows the surface point of the nearest pixel that it does not miss. Pixels
    that the volume does not cover are left out.
    """
    camera = view.camera
    shape = (camera.height, camera.width)
    full = np.zeros(shape, bool)
    full.ravel()[view.pixel[view.coverage[:, 0] > 1.0 - 1e-6]] = True
    some = np.zeros(shape, bool)
    some.ravel()[view.pixel] = True
    border = grown(some) & grown(~full)
    if not border.any():
        return view
    pixels = np.flatnonzero(border)
    owner, ray = rays_of_pixels(pixels, camera, antialias)
    fine = camera.resized(camera.width * antialias, camera.height * antialias)
    origin, direction = fine.rays()
    opacity = caches.gbuffer(origin[ray], direction[ray]).opacity[:, 0]
    coverage = np.zeros(camera.height * camera.width, np.float32)
    coverage[view.pixel] = view.coverage[:, 0]
    coverage[pixels] = np.bincount(owner, opacity, len(coverage))[pixels] / antialias**2
    wanted = np.flatnonzero(coverage > MIN_OPACITY)
    return replace(
        _taken(view, wanted, _source(view, wanted)), coverage=np.minimum(coverage[wanted], 1.0)[:, None]
    )


def _source(view: BakedView, wanted: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the number in `view` of the pixel nearest to each wanted one: itself or one of 8 neighbours."""
    height, width = view.camera.height, view.camera.width
    number = np.full((height + 2, width + 2), -1, np.int64)
    row, column = np.divmod(view.pixel, width)
    number[row + 1, column + 1] = np.arange(view.num_pixels)
    row, column = np.divmod(wanted, width)
    found = number[row + 1, column + 1]
    for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        found = np.where(found >= 0, found, number[row + 1 + dr, column + 1 + dc])
    assert (found >= 0).all(), "the border is one pixel wide"
    return found


def _taken(view: BakedView, pixel: NDArray[np.intp], source: NDArray[np.intp]) -> BakedView:
    """Return the view whose pixels are `pixel`, each with what the pixel number `source` shows."""
    count = np.diff(view.first)[source]
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    place = np.repeat(view.first[source] - first[:-1], count) + np.arange(first[-1])
    rows = {
        name: getattr(view, name)[source]
        for name in (
            "coverage",
            "distance",
            "omega_o",
            "normal",
            "albedo",
            "perceptual_roughness",
            "metalness",
            "visibility",
            "openness",
            "surroundings",
        )
    }
    return BakedView(
        camera=view.camera, pixel=pixel, first=first, texel=view.texel[place], used=view.used, **rows
    )

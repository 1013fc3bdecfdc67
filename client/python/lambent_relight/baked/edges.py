"""Soft edges: the trained volume's appearance at the sharp edges of the mesh extracted from it.

Pixels at the mesh's border and at depth discontinuities are few, so they are evaluated with the bundle's
`gbuffer` function, like every pixel of a refined picture. It returns the pixel's coverage, material and
mean distance; at a discontinuity the distance gives the share of either side. All other pixels come from
the mesh.
"""

from dataclasses import dataclass, replace

import numpy as np
from lambent_core.directions import normalise
from numpy.typing import NDArray

from lambent_relight.baked.depth_steps import DepthSteps, depth_steps, pixel_numbers
from lambent_relight.baked.view import BakedView, turned_to
from lambent_relight.bundle.graphs import NoCaches, PrimaryHits, SurfaceCaches
from lambent_relight.views import MIN_OPACITY, grown, rays_of_pixels

_AROUND = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def with_soft_edges(view: BakedView, caches: SurfaceCaches, antialias: int) -> BakedView:
    """Return `view` with pixels next to the mesh's border and to depth steps taken from the volume.

    A pixel that the mesh does not cover takes its light from the nearest one that it covers, one at a step
    from both sides. Pixels that the volume does not cover are left out. Without networks, the mesh's
    edges are kept.
    """
    if isinstance(caches, NoCaches):
        return view
    shape = (view.camera.height, view.camera.width)
    full, some = np.zeros(shape, bool), np.zeros(shape, bool)
    full.ravel()[view.pixel[view.coverage[:, 0] > 1.0 - 1e-6]] = True
    some.ravel()[view.pixel] = True
    asked = grown(some) & grown(~full)
    steps = depth_steps(view)
    asked.ravel()[view.pixel[steps.at]] = True
    if not asked.any():
        return view
    seen = _ask(view, caches, np.flatnonzero(asked), antialias)
    coverage = np.zeros(asked.size, np.float32)
    coverage[view.pixel] = view.coverage[:, 0]
    coverage[seen.pixel] = seen.coverage
    shown = np.flatnonzero(coverage > MIN_OPACITY)
    near = _source(view, shown)
    far, share = near.copy(), np.ones(len(shown), np.float32)
    at = np.searchsorted(shown, view.pixel[steps.at])
    there = (at < len(shown)) & (shown[np.minimum(at, len(shown) - 1)] == view.pixel[steps.at])
    at, steps = at[there], steps[there]
    near[at], far[at] = steps.near, steps.far
    share[at] = seen.share_of_near(view, steps)
    mixed = _mixed(view, shown, (near, far, share))
    return seen.applied(replace(mixed, coverage=np.minimum(coverage[shown], 1.0)[:, None]))


@dataclass(frozen=True, eq=False)
class _Seen:
    """The volume's appearance in some pixels, in rising order."""

    pixel: NDArray[np.intp]
    owner: NDArray[np.intp]
    """Index of the pixel that each ray belongs to."""
    hits: PrimaryHits
    coverage: NDArray[np.float32]

    def mean(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return means over each pixel's rays [ray, n], weighted by opacity, [pixel, n]."""
        opacity = self.hits.opacity[:, 0]
        count = len(self.pixel)
        total = np.maximum(np.bincount(self.owner, opacity, count), 1e-12)
        sums = [np.bincount(self.owner, opacity * column, count) for column in values.T]
        return np.stack([column / total for column in sums], axis=-1).astype(np.float32)

    def share_of_near(self, view: BakedView, steps: DepthSteps) -> NDArray[np.float32]:
        """Return the share of the near side in each step's pixel, from the mean distance of its rays."""
        near, far = np.zeros((2, len(self.pixel)), np.float32)
        number = np.searchsorted(self.pixel, view.pixel[steps.at])
        near[number], far[number] = view.distance[steps.near, 0], view.distance[steps.far, 0]
        behind = np.maximum(far - near, np.float32(1e-9))[self.owner]
        share = np.clip((far[self.owner] - self.hits.distance[:, 0]) / behind, 0.0, 1.0)
        return self.mean(share[:, None])[number, 0]

    def applied(self, view: BakedView) -> BakedView:
        """Return `view` with the volume's distance, normal and material in these pixels."""
        place = np.searchsorted(view.pixel, self.pixel)
        there = view.pixel[np.minimum(place, view.num_pixels - 1)] == self.pixel
        there &= place < view.num_pixels
        place, changed = place[there], {}
        for name in ("distance", "normal", "albedo", "perceptual_roughness", "metalness"):
            values = getattr(view, name).copy()
            values[place] = self.mean(getattr(self.hits, name))[there]
            changed[name] = values
        changed["normal"][place] = turned_to(view.omega_o[place], normalise(changed["normal"][place]))
        return replace(view, **changed)


def _ask(view: BakedView, caches: SurfaceCaches, pixels: NDArray[np.intp], antialias: int) -> _Seen:
    camera = view.camera
    owner, ray = rays_of_pixels(pixels, camera, antialias)
    origin, direction = camera.finer(antialias).rays()
    hits = caches.gbuffer(origin[ray], direction[ray])
    owner = np.searchsorted(pixels, owner)
    covered = np.bincount(owner, hits.opacity[:, 0], len(pixels)) / antialias**2
    return _Seen(pixels, owner, hits, covered.astype(np.float32))


def _source(view: BakedView, wanted: NDArray[np.intp]) -> NDArray[np.int64]:
    """Return the number in `view` of the pixel nearest to each wanted one: itself or one of 8 neighbours."""
    number = pixel_numbers(view)
    row, column = np.divmod(wanted, view.camera.width)
    source = number[row + 1, column + 1]
    for dr, dc in _AROUND:
        source = np.where(source >= 0, source, number[row + 1 + dr, column + 1 + dc])
    assert (source >= 0).all(), "the border is one pixel wide"
    return source


def _mixed(
    view: BakedView,
    pixel: NDArray[np.intp],
    sides: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]],
) -> BakedView:
    """Return the view whose pixels are `pixel`, lit as the pixels `near` and, for the rest of 1, `far`."""
    near, far, share = sides
    two = near != far
    # Texels of both sides in turn; a pixel without a far side has none of it.
    side = np.stack([near, far], axis=1).ravel()
    weight = np.stack([share, 1.0 - share], axis=1).ravel()
    counts = np.diff(view.first)[side]
    counts[1::2] *= two
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    place = np.repeat(view.first[side] - start[:-1], counts) + np.arange(start[-1])
    one = two[:, None] * (np.float32(1.0) - share[:, None])
    rows = {
        name: getattr(view, name)[near] * (1.0 - one) + getattr(view, name)[far] * one
        for name in ("visibility", "openness", "surroundings")
    }
    kept = ("coverage", "distance", "normal", "albedo", "perceptual_roughness", "metalness")
    return BakedView(
        camera=view.camera,
        pixel=pixel,
        within=np.ones(len(pixel), np.float32),
        first=start[::2].copy(),
        texel=view.texel[place],
        share=(view.share[place] * np.repeat(weight, counts)).astype(np.float32),
        used=view.used,
        points=view.points,
        near=near,
        far=far,
        share_of_near=share.astype(np.float32),
        omega_o=-view.camera.rays()[1][pixel],
        **{name: values.astype(np.float32) for name, values in rows.items()},
        **{name: getattr(view, name)[near] for name in kept},
    )

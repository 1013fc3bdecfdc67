"""The view of a baked surface from a camera: per pixel, the texels around it and one averaged surface point.

Coverage and materials are means over `antialias` x `antialias` fragments of a pixel, and so is the irradiance
of the texels around them, bilinear. The specular lobe is looked up once per pixel; where the fragments of one
differ too much for a mean to reflect as they do, once per fragment (`apart`). Nothing here depends on the
light, so a new light on a known view costs little.
"""

from dataclasses import dataclass, fields

import numpy as np
from lambent_core.directions import dot, normalise
from numpy.typing import NDArray

from lambent_relight.baked.raster import rasterise
from lambent_relight.baked.scene import BakedScene, SurfacePlaces
from lambent_relight.baked.texel_blend import blended_texels, weighted_sums
from lambent_relight.cameras import Camera

LEAST_COSINE = np.float32(0.9)
"""Normals of a pixel that differ by more are shaded one by one."""
MOST_DIFFERENCE = np.float32(0.1)
"""So are roughness and metalness that differ by more."""


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """The fragments of a view, pixel after pixel."""

    first: NDArray[np.int64]
    """Where each pixel's begin, [pixel + 1]."""
    position: NDArray[np.float32]
    """World coordinates, [fragment, 3]."""
    normal: NDArray[np.float32]
    """Unit, [fragment, 3]."""
    row: NDArray[np.int32]
    """In the picture of all samples, [fragment]; so is `column`."""
    column: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class BakedView:
    """Pixels that show the surface, in rising order, and what they show.

    A pixel whose fragments are shaded one by one has a row for each of these.
    """

    camera: Camera
    pixel: NDArray[np.int64]
    """row * width + column, [pixel]."""
    within: NDArray[np.float32]
    """Share of each row in what its pixel shows, [pixel]; 1 where a pixel has one row."""
    first: NDArray[np.int64]
    """Start of every pixel's texels in `texel`, [pixel + 1]."""
    texel: NDArray[np.int32]
    """Texels around all fragments, pixel after pixel, as places in `used`."""
    share: NDArray[np.float32]
    """Weight of each of `texel` in its pixel's mean; a pixel's weights sum to one."""
    used: NDArray[np.int32]
    """All visible texels, in rising order."""
    coverage: NDArray[np.float32]
    """Share of all of the pixel's fragments that show the surface, [pixel, 1]."""
    distance: NDArray[np.float32]
    omega_o: NDArray[np.float32]
    normal: NDArray[np.float32]
    """Unit, turned towards the viewer where it faced away, [pixel, 3]."""
    albedo: NDArray[np.float32]
    perceptual_roughness: NDArray[np.float32]
    metalness: NDArray[np.float32]
    visibility: NDArray[np.float32]
    """Harmonics of the sky's visibility, [pixel, coefficient]."""
    openness: NDArray[np.float32]
    surroundings: NDArray[np.float32]
    points: "SurfacePoints"
    """The fragments, for lights that are looked up on the surface."""
    near: NDArray[np.int64]
    """The pixel of `points` that each pixel takes such light from, [pixel]."""
    far: NDArray[np.int64]
    """Another one, for the rest of it; the same where there is none, [pixel]."""
    share_of_near: NDArray[np.float32]

    @property
    def num_pixels(self) -> int:
        """The number of rows: that of pixels that show the surface, where none is shaded apart."""
        return len(self.pixel)

    @property
    def size_bytes(self) -> int:
        """The memory of all arrays; one that stands for two things counts once."""
        arrays = [getattr(part, item.name) for part in (self, self.points) for item in fields(part)]
        whole = {id(array): array.nbytes for array in arrays if isinstance(array, np.ndarray)}
        return sum(whole.values())

    def mean(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the mean of values per used texel [used, n] over the texels of every pixel, [pixel, n]."""
        return weighted_sums(values, self.texel, self.share, self.first)

    def mean_of_points(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean of values per fragment [fragment, n] over those of every pixel, [pixel, n]."""
        means = _means(values, self.points.first)
        share = self.share_of_near[:, None]
        return share * means[self.near] + (1.0 - share) * means[self.far]

    def image(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return values per pixel [pixel, n] as a picture [height, width, n], zero elsewhere."""
        result = np.zeros((self.camera.height * self.camera.width, values.shape[1]), np.float32)
        if self.within.min(initial=1.0) == 1.0:
            result[self.pixel] = values
        else:
            # Rows of a pixel follow each other.
            starts = np.flatnonzero(np.append(True, np.diff(self.pixel) > 0))
            result[self.pixel[starts]] = np.add.reduceat(self.within[:, None] * values, starts, axis=0)
        return result.reshape(self.camera.height, self.camera.width, -1)


def look_at_surface(scene: BakedScene, camera: Camera, antialias: int, *, apart: bool = False) -> BakedView:
    """Return the view of `camera` with `antialias` x `antialias` fragments per pixel.

    With `apart` the fragments of a pixel are rows of their own where they differ too much for one.
    """
    fine = camera.finer(antialias)
    fragments = rasterise(scene.mesh.vertices, scene.mesh.faces, fine)
    row, column = np.nonzero(fragments.covered)
    owner = (row // antialias).astype(np.int64) * camera.width + column // antialias
    places = SurfacePlaces.of(fragments, scene.mesh)
    depth = fragments.depth[row, column]
    if antialias > 1:
        order = np.argsort(owner, kind="stable")
        owner, depth, places = owner[order], depth[order], places[order]
        row, column = row[order], column[order]
    footprint = depth / np.float32(fine.focal_x)
    albedo, roughness, metalness = scene.materials_at(places.uv, footprint)
    normal = scene.normals_at(places, footprint)
    pixel, start, number = np.unique(owner, return_index=True, return_inverse=True)
    first = np.append(start, len(owner)).astype(np.int64)
    total = np.diff(first)
    if apart and antialias > 1:
        starts = np.zeros(len(owner), bool)
        starts[start] = True
        starts |= _differing(normal, roughness, metalness, start, number)[number]
        first = np.append(np.flatnonzero(starts), len(owner)).astype(np.int64)
        pixel, total = owner[starts], total[number[starts]]
    count = np.diff(first)
    texel, share, begin = blended_texels(scene.texel_plane, places.uv, first)
    used, place = np.unique(texel, return_inverse=True)

    # Not as they are found: those are columns of one array, which would stay whole.
    place_in_picture = row.astype(np.int32), column.astype(np.int32)
    points = SurfacePoints(first, places(scene.mesh.vertices), normal, *place_in_picture)
    every = np.arange(len(pixel))

    def blended(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return weighted_sums(values, texel, share, begin)

    omega_o = -camera.rays()[1][pixel]
    return BakedView(
        camera=camera,
        pixel=pixel,
        within=(count / total).astype(np.float32),
        first=begin,
        texel=place.astype(np.int32),
        share=share,
        used=used,
        coverage=(total[:, None] / antialias**2).astype(np.float32),
        distance=_means(depth[:, None], first),
        omega_o=omega_o,
        normal=turned_to(omega_o, normalise(_means(normal, first))),
        albedo=_means(albedo, first),
        perceptual_roughness=_means(roughness, first),
        metalness=_means(metalness, first),
        visibility=blended(scene.visibility),
        openness=blended(scene.openness),
        surroundings=blended(scene.surroundings),
        points=points,
        near=every,
        far=every,
        share_of_near=np.ones(len(pixel), np.float32),
    )


def _differing(
    normal: NDArray[np.float32],
    roughness: NDArray[np.float32],
    metalness: NDArray[np.float32],
    first: NDArray[np.intp],
    number: NDArray[np.intp],
) -> NDArray[np.bool_]:
    """Return which pixels have a fragment too unlike their first one for a common lobe, [pixel].

    `first` is where each pixel's fragments begin, and `number` the pixel of each.
    """
    own = first[number]
    unlike = dot(normal, normal[own])[:, 0] < LEAST_COSINE
    for values in (roughness, metalness):
        unlike |= np.abs(values - values[own])[:, 0] > MOST_DIFFERENCE
    return np.bincount(number, unlike, len(first)) > 0


def turned_to(omega_o: NDArray[np.floating], normal: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return unit normals, those that face away from the viewer turned until they just do not.

    A mean normal may face away at a silhouette, where the true one cannot.
    """
    away = np.minimum(dot(normal, omega_o) - 1e-3, 0.0)
    return normalise(normal - away * omega_o).astype(np.float32)


def _means(values: NDArray[np.floating], first: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the means of rows [first[i], first[i + 1]) of `values`."""
    if len(values) == len(first) - 1:
        return values.astype(np.float32, copy=False)
    if len(values) == 0:
        return np.zeros((0, values.shape[1]), np.float32)
    return (np.add.reduceat(values, first[:-1], axis=0) / np.diff(first)[:, None]).astype(np.float32)

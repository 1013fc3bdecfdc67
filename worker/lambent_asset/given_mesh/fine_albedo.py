"""The albedo texture of a given mesh at a size of its own, as sharp as the file's pictures."""

import numpy as np
from flashcache.config import SIZE_STEP
from jaxtyping import Float32
from lambent_relight.baked.raster import Fragments, interpolate, nearest_texel, rasterise_uv
from numpy import ndarray

from lambent_asset.given_mesh.glb_file import GivenMesh
from lambent_asset.given_mesh.glb_maps import sampled
from lambent_asset.mesh.atlas import Unwrapped

ROWS_AT_ONCE = 128

Plane = Float32[ndarray, "size size 3"]


def albedo_size(given: GivenMesh, *, kept_uv: bool, least: int, most: int) -> int:
    """Return the texels along a side at which nothing of the file's base colours is lost, up to `most`.

    On the file's atlas that is the longest side of its pictures; on a new one, as many texels as they have
    pixels together. It is `least` where the pictures have fewer.
    """
    shapes = [maps.albedo.shape for maps in given.maps if maps is not None and maps.albedo is not None]
    if not shapes:
        return least
    if kept_uv:
        wanted = max(max(height, width) for height, width, _ in shapes)
    else:
        wanted = int(np.ceil(sum(height * width for height, width, _ in shapes) ** 0.5))
    # Smaller versions and compressed ones need sizes that can be halved.
    return max(least, min(most, -(-wanted // SIZE_STEP) * SIZE_STEP))


def fine_albedo(given: GivenMesh, charts: Unwrapped, coarse: Plane, size: int) -> Plane:
    """Return the albedo on an atlas of `size` texels a side, linear Rec. 709, gutters filled.

    Parts without maps have that of `coarse`, an albedo of another size on the same charts, interpolated.
    """
    fragments = rasterise_uv(charts.uv, charts.faces, size)
    index = np.flatnonzero(fragments.covered).astype(np.int32)
    own_uv = given.uv[charts.source]
    fitting = [None if maps is None else maps.reduced(size) for maps in given.maps]
    plane = np.zeros((size, size, 3), np.float32)
    for row in range(0, size, ROWS_AT_ONCE):
        band = slice(row, row + ROWS_AT_ONCE)
        some = Fragments(fragments.face[band], fragments.barycentric[band], fragments.depth[band])
        uv = interpolate(some, charts.faces, own_uv)
        rows, columns = np.nonzero(some.covered)
        here = (np.stack([columns, rows + row], axis=1) + 0.5) / size
        part = given.part_of_face[some.face[some.covered]]
        values = np.empty((len(uv), 3), np.float32)
        for number in np.unique(part):
            chosen, maps = part == number, fitting[number]
            if maps is not None:
                values[chosen] = maps.albedo_at(uv[chosen])
            else:
                # Pictures repeat when they are looked up; the atlas does not.
                margin = 0.5 / len(coarse)
                values[chosen] = sampled(coarse, here[chosen].clip(margin, 1.0 - margin))
        plane[band][some.covered] = values
    del fragments
    owner = nearest_texel(index, size)
    flat = plane.reshape(-1, 3)
    for row in range(0, size, ROWS_AT_ONCE):
        band = slice(row, row + ROWS_AT_ONCE)
        # Covered texels own themselves, so that filling the others in place reads no filled one.
        plane[band] = flat[index[owner[band]]]
    return plane

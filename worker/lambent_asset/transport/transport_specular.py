"""Light that blocked rays find mirrored in what they hit, in one compiled pass over the hits.

The same terms as `lambent_relight.baked`: split sum, lobe of the harmonics, sky visible from the hit point.
Source: docs/method.md (relighting).
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from lambent_compute.compiling import compiled, inlined
from lambent_compute.threads import available_threads, for_each
from lambent_relight.baked.split_sum import TABLE_SIDE, table
from lambent_relight.baked.transport_kernels import basis_at, recurrence
from lambent_relight.baked.transport_lobes import ggx_bands
from numpy import ndarray

_RECEIVERS_AT_ONCE = 512


@dataclass(frozen=True, slots=True, eq=False)
class RayHits:
    """Blocked rays that were followed, by the coarse texel (the receiver) they left from."""

    first: Int[ndarray, " receivers_and_one"]
    """The hits of receiver r are those from `first[r]` to `first[r + 1]`."""
    texel: Int[ndarray, " hits"]
    """Texel nearest to its end."""
    weight: Float[ndarray, " hits"]
    """Opacity times cosine times solid angle."""
    direction: Float[ndarray, "hits 3"]

    def gathering(self, weight: Float[ndarray, " hits"], num_texels: int) -> scipy.sparse.csr_array:
        """Return the matrix that sums values of the texels that are hit, by `weight`."""
        shape = (len(self.first) - 1, num_texels)
        return scipy.sparse.csr_array((weight.astype(np.float32), self.texel, self.first), shape=shape)


def mirrored_light(
    hits: RayHits,
    normals: Float[ndarray, "texels 3"],
    roughness: Float[ndarray, " texels"],
    base_reflectance: Float[ndarray, "texels 3"],
    visibility: Float[ndarray, "texels coefficients"],
    num_coefficients: int,
) -> tuple[Float[ndarray, "receivers kept 3"], Float[ndarray, "hits 3"]]:
    """Return the environment mirrored towards each receiver, as `num_coefficients` harmonics, and the rest.

    The rest is a hit's weight times its reflectance times the share of the lobe that sees no sky.
    """
    num_receivers = len(hits.first) - 1
    bands = round(max(visibility.shape[1], num_coefficients) ** 0.5)
    mirrored = np.zeros((num_receivers, num_coefficients, 3), np.float32)
    rest = np.empty((len(hits.texel), 3), np.float32)
    arrays = [
        np.ascontiguousarray(array, np.float32)
        for array in (
            hits.weight,
            hits.direction,
            normals,
            roughness,
            base_reflectance,
            visibility,
        )
    ]
    tables = (table(), ggx_bands(bands), recurrence(bands))

    def some(start: int) -> None:
        end = min(start + _RECEIVERS_AT_ONCE, num_receivers)
        _mirror(start, end, hits.first, hits.texel, *arrays, *tables, mirrored, rest)

    for_each(some, range(0, num_receivers, _RECEIVERS_AT_ONCE), available_threads())
    return mirrored, rest


@compiled()
def _mirror(
    start,
    end,
    first_hit,
    texel,
    weight,
    direction,
    normals,
    perceptual_roughness,
    base_reflectance,
    visibility,
    split_sums,
    lobes,
    steps,
    mirrored,
    rest,
):
    one, zero = np.float32(1.0), np.float32(0.0)
    bands, num_visible, num_kept = lobes.shape[1], visibility.shape[1], mirrored.shape[1]
    basis = np.empty(bands * bands, np.float32)
    for receiver in range(start, end):
        for hit in range(first_hit[receiver], first_hit[receiver + 1]):
            t = texel[hit]
            nx, ny, nz = normals[t, 0], normals[t, 1], normals[t, 2]
            x, y, z = direction[hit, 0], direction[hit, 1], direction[hit, 2]
            cosine = -(x * nx + y * ny + z * nz)
            if cosine <= zero:
                rest[hit, 0] = rest[hit, 1] = rest[hit, 2] = zero
                continue
            roughness = min(max(perceptual_roughness[t], zero), one)
            scale, bias = _split_sum(split_sums, cosine, roughness)
            twice = np.float32(2.0) * cosine
            basis_at(x + twice * nx, y + twice * ny, z + twice * nz, steps, basis)
            place = roughness * np.float32(len(lobes) - 1)
            step = min(int(place), len(lobes) - 2)
            share, free = place - np.float32(step), zero
            for band in range(bands):
                lobe = lobes[step, band] * (one - share) + lobes[step + 1, band] * share
                for k in range(band * band, (band + 1) * (band + 1)):
                    basis[k] *= lobe
                    if k < num_visible:
                        free += basis[k] * visibility[t, k]
            free = min(max(free, zero), one)
            for channel in range(3):
                part = weight[hit] * (base_reflectance[t, channel] * scale + bias)
                rest[hit, channel] = part * (one - free)
                for k in range(num_kept):
                    mirrored[receiver, k, channel] += part * free * basis[k]


@inlined()
def _split_sum(values, cosine, roughness):
    """Return `lambent_relight.baked.split_sum.split_sum` of one cosine and roughness in [0, 1]."""
    one, last = np.float32(1.0), np.float32(TABLE_SIDE - 1)
    row, column = np.sqrt(min(cosine, one)) * last, roughness * last
    top, left = min(int(row), TABLE_SIDE - 2), min(int(column), TABLE_SIDE - 2)
    down, across = row - np.float32(top), column - np.float32(left)
    a, b = (one - down) * (one - across), (one - down) * across
    c, d = down * (one - across), down * across
    corners = values[top : top + 2, left : left + 2]
    scale = a * corners[0, 0, 0] + b * corners[0, 1, 0] + c * corners[1, 0, 0] + d * corners[1, 1, 0]
    bias = a * corners[0, 0, 1] + b * corners[0, 1, 1] + c * corners[1, 0, 1] + d * corners[1, 1, 1]
    return scale, bias

"""Importance sampling of an environment map together with a lobe of the surface.

A sampling table holds, for lobes about a grid of axes, the probability of every cell of the map in
proportion to radiance times lobe; inside a cell, pixels are drawn by their radiance and directions
uniformly in solid angle. The density is known exactly, so a coarse table increases variance but causes no
bias. Lobe 0 is the clamped cosine about the normal; lobe k > 0 is exp(sharpness (cos - 1)) about the mirror
direction. Source: paper Eq. 5 with supplement 2.7's split into a diffuse and a specular half.
"""

import math

import numpy as np
from lambent_core.directions import (
    Array,
    dot,
    pixel_directions,
    pixel_solid_angles,
)
from numpy.typing import NDArray

from lambent_relight.environment.maps import Environment

COSINE_LOBE = 0
LOBE_ALPHAS = (1.0, 0.5, 0.25, 0.125)
"""GGX widths that lobes 1, 2, ... stand for."""
_SHARPNESS_TIMES_ALPHA_SQUARED = 0.84
"""Gives the lobe exp(k (cos - 1)) the same half width as a GGX reflection of width alpha."""
_MAX_ROWS = 512
_CELL_ROWS, _CELL_COLUMNS = 32, 64
_FLOOR_SHARE = 0.02


def lobe_of_alpha(alpha: Array) -> NDArray[np.int64]:
    """Return the number of the lobe that fits GGX width `alpha` [*batch, 1] best, [*batch]."""
    edges = np.sqrt(np.array(LOBE_ALPHAS[1:]) * np.array(LOBE_ALPHAS[:-1]))
    return 1 + (alpha[..., 0, None] < edges).sum(axis=-1)


class LightSampler:
    """Draws directions in proportion to the environment's radiance times a lobe, nearly."""

    def __init__(self, environment: Environment) -> None:
        """Tabulate `environment`; linear in its number of pixels."""
        # Compiled code takes a second to import, which programs that only look at maps do not pay.
        from lambent_relight.environment.light_sampling_kernels import Table

        mass = _pixel_masses(environment.radiance)
        height, width = mass.shape
        cell = _cells(height, width)
        order = np.argsort(cell.ravel(), kind="stable")
        num_cells = int(cell.max()) + 1
        cell_ends = np.searchsorted(cell.ravel()[order], np.arange(num_cells), side="right")
        cell_mass = np.bincount(cell.ravel(), mass.ravel(), num_cells).astype(np.float64, copy=False)
        solid_angles = pixel_solid_angles(height, width)
        inside = mass / (np.maximum(cell_mass, 1e-300)[cell] * solid_angles[:, None])
        table, means = _lobe_table(cell_mass, _cell_directions(cell, solid_angles, num_cells))
        self.table = Table(
            pmf=table.astype(np.float32),
            cell_ends=(np.cumsum(table, axis=1) + np.arange(len(table))[:, None]).ravel(),
            cells=np.stack([np.concatenate([[0], cell_ends[:-1]]), cell_ends - 1], axis=1),
            ends=np.cumsum(mass.ravel()[order]),
            order=order,
            cell_of_pixel=cell.ravel(),
            inside=inside.ravel(),
            means=means,
            height=height,
            width=width,
            angle=math.radians(environment.rotate_deg),
        )

    def sample(
        self, u1: Array, u2: Array, axis: Array, lobe: NDArray[np.integer] | int
    ) -> NDArray[np.float32]:
        """Return directions [n, 3] for lobes about `axis` [n, 3], from uniforms `u1`, `u2` [n] in [0, 1).

        Nearby uniforms mostly give nearby directions, so stratified uniforms stay stratified.
        """
        from lambent_relight.environment import light_sampling_kernels as kernels

        out = np.empty((len(axis), 3), np.float32)
        uniforms = (np.ascontiguousarray(u, np.float64) for u in (u1, u2))
        kernels.sample(self.table, *uniforms, *_lobes(axis, lobe), out)
        return out

    def mean(self, axis: Array, lobe: NDArray[np.integer] | int) -> NDArray[np.float64]:
        """Return the mean of the map under lobes about `axis` [n, 3], nearly: [n], 1/sr.

        Radiance, the sum of its channels, over its integral: 1 / (4 pi) where the light is even.
        """
        from lambent_relight.environment import light_sampling_kernels as kernels

        out = np.empty(len(axis))
        kernels.means(self.table, *_lobes(axis, lobe), out)
        return out

    def pdf(self, directions: Array, axis: Array, lobe: NDArray[np.integer] | int) -> NDArray[np.float32]:
        """Return the density of `sample` at unit `directions` [n, 3], 1/sr, as [n, 1]."""
        from lambent_relight.environment import light_sampling_kernels as kernels

        out = np.empty((len(directions), 1), np.float32)
        kernels.densities(self.table, np.ascontiguousarray(directions, np.float64), *_lobes(axis, lobe), out)
        return out


def _lobes(axis: Array, lobe: NDArray[np.integer] | int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return axes [n, 3] and the lobe of each [n] as compiled code takes them."""
    numbers = np.ascontiguousarray(np.broadcast_to(np.asarray(lobe, np.int64), (len(axis),)))
    return np.ascontiguousarray(axis, np.float64), numbers


def _pixel_masses(radiance: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return radiance times solid angle of sampling pixels, at most 512 rows of them; never all zero.

    The mean of the bilinear interpolant over a pixel is taken: the centre alone would give a black pixel
    beside a bright one probability zero, although the interpolated radiance there is not zero.
    """
    values = radiance.sum(axis=-1, dtype=np.float64)
    wrapped = 0.75 * values + 0.125 * (np.roll(values, 1, axis=1) + np.roll(values, -1, axis=1))
    above = np.concatenate([wrapped[:1], wrapped[:-1]])
    below = np.concatenate([wrapped[1:], wrapped[-1:]])
    mean = 0.75 * wrapped + 0.125 * (above + below)
    height, width = mean.shape
    rows, columns = min(height, _MAX_ROWS), min(width, 2 * _MAX_ROWS)
    if height % rows or width % columns:
        # Sampling pixels must be unions of pixels with equal angles, or their solid angles would be wrong.
        rows, columns = math.gcd(height, rows), math.gcd(width, columns)
        rows, columns = (rows, columns) if rows * columns >= 2048 else (height, width)
    mean *= pixel_solid_angles(height, width)[:, None]
    mass = mean.reshape(rows, height // rows, columns, width // columns).sum(axis=(1, 3))
    if mass.sum() <= 0.0:
        mass += pixel_solid_angles(rows, columns)[:, None]
    return mass / mass.sum()


def _cells(height: int, width: int) -> NDArray[np.int64]:
    """Return the cell number of every pixel, [height, width]; cells are numbered along a Z-shaped curve."""
    row = np.arange(height) * min(_CELL_ROWS, height) // height
    column = np.arange(width) * min(_CELL_COLUMNS, width) // width
    code = np.zeros((height, width), np.int64)
    for bit in range(6):
        code |= ((row[:, None] >> bit) & 1) << (2 * bit + 1) | ((column[None, :] >> bit) & 1) << (2 * bit)
    return np.unique(code, return_inverse=True)[1].reshape(height, width)


def _cell_directions(cell: NDArray[np.int64], solid_angles: Array, num_cells: int) -> NDArray[np.float64]:
    """Return the mean direction of every cell, [cell, 3], shorter than 1 for wide cells."""
    weight = np.broadcast_to(solid_angles[:, None], cell.shape).ravel()
    directions = pixel_directions(*cell.shape).reshape(-1, 3)
    total = np.bincount(cell.ravel(), weight, num_cells)
    sums = [np.bincount(cell.ravel(), weight * directions[:, axis], num_cells) for axis in range(3)]
    return np.stack(sums, axis=-1) / total[:, None]


def _lobe_table(
    cell_mass: NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the probability of every cell for every lobe and axis, [lobe * axes, cell].

    The second result is the mean of the map under each of these lobes, [lobe * axes]; see `Table.means`.
    """
    cosine = _bin_axes() @ directions.T
    tables = [np.maximum(cosine + 0.1, 0.0)]
    tables += [np.exp(_SHARPNESS_TIMES_ALPHA_SQUARED / alpha**2 * (cosine - 1.0)) for alpha in LOBE_ALPHAS]
    # Integrals of the lobes over the sphere.
    sizes = [np.pi * 1.1**2]
    for alpha in LOBE_ALPHAS:
        sharpness = _SHARPNESS_TIMES_ALPHA_SQUARED / alpha**2
        sizes.append(2.0 * np.pi * (1.0 - math.exp(-2.0 * sharpness)) / sharpness)
    means = np.concatenate([(lobe @ cell_mass) / size for lobe, size in zip(tables, sizes, strict=True)])
    rows = []
    for lobe in tables:
        # A floor keeps every lit cell possible, wherever the axis is inside its bin.
        # The last term is for maps of a few pixels, whose cells may all lie outside a narrow lobe.
        weight = cell_mass * (lobe + _FLOOR_SHARE * lobe.mean(axis=1, keepdims=True) + 1e-12)
        rows.append(weight / weight.sum(axis=1, keepdims=True))
    return np.concatenate(rows), means


def _bin_axes() -> NDArray[np.float64]:
    """Return the unit vector at the middle of every bin of the kernels' `row_of`, [bin, 3]."""
    from lambent_relight.environment.light_sampling_kernels import AXES_SIDE

    middle = (np.arange(AXES_SIDE) + 0.5) * (2 / AXES_SIDE) - 1
    y, x = (a.ravel() for a in np.meshgrid(middle, middle, indexing="ij"))
    z = 1 - np.abs(x) - np.abs(y)
    folded_x = np.where(z < 0, (1 - np.abs(y)) * np.where(x < 0, -1, 1), x)
    folded_y = np.where(z < 0, (1 - np.abs(x)) * np.where(y < 0, -1, 1), y)
    vectors = np.stack([folded_x, folded_y, z], axis=-1)
    return vectors / np.sqrt(dot(vectors, vectors))

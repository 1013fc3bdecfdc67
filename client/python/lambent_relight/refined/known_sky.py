"""Direct light through baked shadow bits, whose mean is known: a control variate of what rays find.

The sky is divided into cells, one around each direction of the shadow bits, and a point sees a cell or does
not. Light that is constant over small pixels, times the cosine, over the cells that a point sees, is a
function of the direction whose integral is a sum over cells, exactly:

    integral of L V max(n . w, 0) dw = n . (sum of m_j over the cells j that are seen),
    m_j = integral of L w dw over the cell,

as long as only cells that are wholly above the surface count. So what the same rays find of this function
moves no mean, however wrong the bits are; where they are right, it has the noise of direct light. Source:
Glasserman, Monte Carlo Methods in Financial Engineering, 4.1; docs/decisions/0028-known-light.md.
"""

from dataclasses import dataclass, replace

import numpy as np
from lambent_core.directions import pixel_directions, rotate_about_z
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lambent_relight.brdf import RowIndex
from lambent_relight.environment.maps import Environment

_ROWS = 192
"""Least number of rows of pixels; light is constant inside one."""
_MOST_ROWS = 768
_NO_CELLS = (np.zeros((1, 1, 3), np.float32), np.zeros((1, 1), np.int32), np.zeros((0, 32), np.uint8))


@dataclass(frozen=True)
class SkyCells:
    """A light, divided among the cells of `directions`; columns and rows are those of its map."""

    radiance: NDArray[np.float32]
    """Of every pixel, [rows, columns, 3]."""
    cell: NDArray[np.int32]
    """Of every pixel, [rows, columns]."""
    directions: NDArray[np.float32]
    """In the world, [cell, 3]."""
    moment: NDArray[np.float32]
    """Integral of radiance times direction over every cell, in the world, [cell, axis, channel]."""
    least_cosine: float
    """A cell whose direction has more than this towards a normal is wholly above the surface."""
    turn: float
    """By which the light is turned about +z, as a share of a circle."""

    @classmethod
    def of(cls, environment: Environment, directions: NDArray[np.floating]) -> "SkyCells":
        """Divide `environment` among the cells around unit `directions` [cell, 3]."""
        rows, columns = _fine(*environment.radiance.shape[:2])
        centre = pixel_directions(rows, columns)
        still = replace(environment, rotate_deg=0.0)
        radiance = still.lookup(centre.reshape(-1, 3)).reshape(rows, columns, 3)
        # In the frame of the map, cells turn the other way.
        there = rotate_about_z(np.asarray(directions, np.float64), -environment.rotate_deg)
        apart, cell = cKDTree(there).query(centre.reshape(-1, 3), workers=1)
        integral = _direction_integrals(rows, columns)
        moment = np.zeros((len(there), 3, 3))
        for axis in range(3):
            for channel in range(3):
                light = (radiance[..., channel] * integral[..., axis]).ravel()
                moment[:, axis, channel] = np.bincount(cell, light, len(there))
        turned = rotate_about_z(moment.transpose(0, 2, 1), environment.rotate_deg).transpose(0, 2, 1)
        # The farthest corner of a pixel is half a diagonal from its middle.
        widest = 2.0 * np.arcsin(0.5 * float(apart.max())) + np.hypot(np.pi / rows, 2.0 * np.pi / columns)
        return cls(
            np.ascontiguousarray(radiance, np.float32),
            cell.reshape(rows, columns).astype(np.int32),
            np.asarray(directions, np.float32),
            np.ascontiguousarray(turned, np.float32),
            float(np.sin(widest)),
            environment.rotate_deg / 360.0,
        )


@dataclass(frozen=True)
class KnownSky:
    """What points reflect diffusely of the sky through their shadow bits."""

    cells: SkyCells
    seen: NDArray[np.uint8]
    """Cells that a point sees and that are above it, eight per byte, lowest bit first, [point, cell / 8]."""
    radiance: NDArray[np.float32]
    """What it reflects of them in the mean, [point, 3]."""

    @classmethod
    def of(
        cls,
        cells: SkyCells,
        bits: NDArray[np.uint8],
        normal: NDArray[np.floating],
        reflected: NDArray[np.floating],
    ) -> "KnownSky":
        """Return that of points with shadow `bits` [point, cell / 8], normal and diffuse BRDF [point, 3]."""
        from lambent_relight.refined import traced_kernels as kernels

        seen = np.ascontiguousarray(bits).copy()
        irradiance = np.empty((len(bits), 3), np.float32)
        normals = np.ascontiguousarray(normal, np.float32)
        kernels.sum_cells(
            cells.directions, cells.moment, np.float32(cells.least_cosine), normals, seen, irradiance
        )
        return cls(cells, seen, (irradiance * reflected).astype(np.float32))

    def __getitem__(self, index: RowIndex) -> "KnownSky":
        """Return that of some of the points."""
        return KnownSky(self.cells, self.seen[index], self.radiance[index])


def cells_of(sky: KnownSky | None) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
    """Return radiance and cells of a known sky's pixels and the cells that points see; of none, no points."""
    if sky is None:
        return _NO_CELLS
    return sky.cells.radiance, sky.cells.cell, np.ascontiguousarray(sky.seen)


def _fine(height: int, width: int) -> tuple[int, int]:
    """Return rows and columns of pixels: those of the map, or more, or fewer where it has very many."""
    times = -(-_ROWS // height)
    return min(times * height, _MOST_ROWS), min(times * width, 2 * _MOST_ROWS)


def _direction_integrals(rows: int, columns: int) -> NDArray[np.float64]:
    """Return the integral of the direction over the solid angle of every pixel, [rows, columns, 3]."""
    polar = np.pi * np.arange(rows + 1) / rows
    azimuth = np.pi - 2.0 * np.pi * np.arange(columns + 1) / columns
    # sin^2 and sin cos of the polar angle, from the top of a row to its bottom.
    flat = np.diff(0.5 * polar - 0.25 * np.sin(2.0 * polar))
    high = np.diff(0.5 * np.sin(polar) ** 2)
    x, y = -np.diff(np.sin(azimuth)), np.diff(np.cos(azimuth))
    across = np.full(columns, 2.0 * np.pi / columns)
    return np.stack([np.outer(flat, x), np.outer(flat, y), np.outer(high, across)], axis=-1)

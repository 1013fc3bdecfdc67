"""Shadows of dominant lights: depth maps of the mesh from the light, and filtered comparisons with them.

A map is an orthographic picture of the ball around the mesh's box along the light's direction, of depths in
[0, 1] from the side of the light. At a surface point the blockers in the cone of the light's disc give the
width of the penumbra, and the share of lit texels inside it the share of the light. Comparisons follow the
surface's tangent plane, so that a slanted surface does not shadow itself. The viewer does the same
(client/web/src/render/shaders/shadowShare.glsl). Source: Fernando 2005 (percentage-closer soft shadows);
Isidoro 2006 for planes of receivers.
"""

from dataclasses import dataclass

import numpy as np
from lambent_compute.compiling import compiled
from lambent_compute.threads import available_threads, for_each
from numpy.typing import NDArray

from lambent_relight.baked.mesh import AtlasMesh

Rows = NDArray[np.float32]

SIDE = 1024
"""Texels along a side of a map."""
BLOCKER_TAPS, FILTER_TAPS = 12, 16
LEAST_RADIUS = 1.25
"""Texels over which the border of a shadow is smoothed at least."""
BIAS = 1.5
"""Texels of depth that a blocker is nearer to the light at least."""
LEAST_COSINE = 0.08
"""Steeper planes than this are taken to be this steep."""
_GOLDEN = float(np.pi * (3.0 - np.sqrt(5.0)))
_ROWS_PER_TASK, _POINTS_PER_TASK = 64, 1 << 14


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """The mesh as one light sees it."""

    axes: NDArray[np.float64]
    """Right and up in the map, and the direction towards the light; rows, unit."""
    centre: NDArray[np.float64]
    radius: float
    """Of the ball around the mesh's box, scene units."""
    tangent: float
    """Of the angular radius of the light."""
    depth: NDArray[np.float32]
    """[SIDE, SIDE], rows along the second axis; 1 where nothing is."""

    def shares(self, position: Rows, normal: Rows, turn: Rows) -> Rows:
        """Return the share of the light that reaches points [point, 3], in [0, 1]; 0 where they face away.

        `normal` [point, 3] is unit; `turn` [point] in radians turns the pattern of comparisons.
        """
        out = np.zeros(len(position), np.float32)
        arrays = [np.ascontiguousarray(values, np.float32) for values in (position, normal, turn)]
        frame = (self.axes.astype(np.float32), self.centre.astype(np.float32))
        sizes = np.array([self.radius, self.tangent], np.float32)

        def look(first: int) -> None:
            part = slice(first, first + _POINTS_PER_TASK)
            _shares(*(values[part] for values in arrays), *frame, sizes, self.depth, out[part])

        for_each(look, range(0, len(position), _POINTS_PER_TASK), available_threads())
        return out


def shadow_map(mesh: AtlasMesh, direction: NDArray[np.floating], radius_rad: float) -> ShadowMap:
    """Return the map of a light in the unit `direction` [3], a disc of `radius_rad`."""
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
    centre, radius = 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-9)
    axes = light_axes(direction)
    points = (mesh.vertices.astype(np.float64) - centre) @ axes.T / radius
    points[:, 2] = 0.5 - 0.5 * points[:, 2]
    depth = np.ones((SIDE, SIDE), np.float32)
    faces = np.ascontiguousarray(mesh.faces, np.int32)

    def draw(first: int) -> None:
        _draw(points, faces, first, min(first + _ROWS_PER_TASK, SIDE), depth)

    for_each(draw, range(0, SIDE, _ROWS_PER_TASK), available_threads())
    return ShadowMap(axes, centre, radius, float(np.tan(radius_rad)), depth)


def light_axes(direction: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return two unit vectors across a direction [3], and itself, as rows."""
    x, y, z = np.asarray(direction, np.float64)
    level = np.hypot(x, y)
    first = np.array([-y / level, x / level, 0.0]) if level > 1e-3 else np.array([1.0, 0.0, 0.0])
    return np.stack([first, np.cross((x, y, z), first), (x, y, z)])


def pattern_turns(row: NDArray[np.integer], column: NDArray[np.integer]) -> Rows:
    """Return the turn of the pattern of comparisons at samples of a picture, radians.

    Interleaved gradient noise: neighbours differ much, and 3 x 3 of them are spread evenly. Source: Jimenez
    2014.
    """
    x, y = np.asarray(column, np.float32), np.asarray(row, np.float32)
    inner = np.float32(0.06711056) * x + np.float32(0.00583715) * y
    outer = np.float32(52.9829189) * (inner - np.floor(inner))
    return (np.float32(2.0 * np.pi) * (outer - np.floor(outer))).astype(np.float32)


@compiled(fastmath=False)
def _draw(points, faces, first, end, depth):
    side = depth.shape[1]
    for f in range(faces.shape[0]):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        half = 0.5 * side
        ax, ay = (a[0] + 1.0) * half, (a[1] + 1.0) * half
        bx, by = (b[0] + 1.0) * half, (b[1] + 1.0) * half
        cx, cy = (c[0] + 1.0) * half, (c[1] + 1.0) * half
        bottom, top = max(first, int(min(ay, by, cy) - 0.5)), min(end - 1, int(max(ay, by, cy) + 0.5))
        if bottom > top:
            continue
        left, right = max(0, int(min(ax, bx, cx) - 0.5)), min(side - 1, int(max(ax, bx, cx) + 0.5))
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        for row in range(bottom, top + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                x = column + 0.5
                wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                wc = ((ax - x) * (by - y) - (ay - y) * (bx - x)) / area
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                own = np.float32(wa * a[2] + wb * b[2] + wc * c[2])
                if own < depth[row, column]:
                    depth[row, column] = own


@compiled()
def _shares(position, normal, turn, axes, centre, sizes, depth, out):
    side = depth.shape[0]
    one, half, zero, two = np.float32(1.0), np.float32(0.5), np.float32(0.0), np.float32(2.0)
    radius, tangent = sizes[0], sizes[1]
    texel = two / np.float32(side)
    least = np.float32(LEAST_RADIUS) * texel
    for p in range(len(position)):
        nl = zero
        place = np.zeros(3, np.float32)
        slope = np.zeros(2, np.float32)
        for k in range(3):
            nl += normal[p, k] * axes[2, k]
        if nl <= zero:
            continue
        for axis in range(3):
            for k in range(3):
                place[axis] += (position[p, k] - centre[k]) * axes[axis, k]
            place[axis] /= radius
        steep = max(nl, np.float32(LEAST_COSINE))
        for axis in range(2):
            for k in range(3):
                slope[axis] += normal[p, k] * axes[axis, k]
            slope[axis] *= half / steep
        own = half - half * place[2] - half * np.float32(BIAS) * texel * (one + (one - nl) / steep)
        reach = max(tangent * (one - place[2]), least)
        count, width = 0, zero
        for i in range(BLOCKER_TAPS):
            away = reach * np.sqrt((np.float32(i) + half) / np.float32(BLOCKER_TAPS))
            angle = np.float32(i) * np.float32(_GOLDEN) + turn[p]
            du, dv = away * np.cos(angle), away * np.sin(angle)
            blocker = _look(depth, place[0] + du, place[1] + dv)
            gap = own + slope[0] * du + slope[1] * dv - blocker
            if gap > zero:
                count += 1
                width += gap
        if count == 0:
            out[p] = one
            continue
        if count == BLOCKER_TAPS:
            continue
        spread = min(max(two * tangent * width / np.float32(count), least), reach)
        lit = 0
        for i in range(FILTER_TAPS):
            away = spread * np.sqrt((np.float32(i) + half) / np.float32(FILTER_TAPS))
            angle = np.float32(i) * np.float32(_GOLDEN) + turn[p]
            du, dv = away * np.cos(angle), away * np.sin(angle)
            if own + slope[0] * du + slope[1] * dv <= _look(depth, place[0] + du, place[1] + dv):
                lit += 1
        out[p] = np.float32(lit) / np.float32(FILTER_TAPS)


@compiled()
def _look(depth, u, v):
    side = depth.shape[0]
    half = np.float32(0.5) * np.float32(side)
    column = min(max(int((u + np.float32(1.0)) * half), 0), side - 1)
    row = min(max(int((v + np.float32(1.0)) * half), 0), side - 1)
    return depth[row, column]

"""Compiled search of a ray's first face, for whole batches and for the loops of refined pictures.

Source: Möller and Trumbore 1997 (ray against triangle).
"""

import numpy as np
from lambent_compute.compiling import CONTRACTED, compiled, inlined

STACK = 96
"""Nodes that wait at once: one per level, and none is as deep."""
_FAR = np.float32(np.inf)


@inlined(fastmath=CONTRACTED)
def _enters(box, ox, oy, oz, ix, iy, iz, nearest):
    """Return the distance at which a ray enters a box before `nearest`, or infinity."""
    ax, bx = (box[0] - ox) * ix, (box[3] - ox) * ix
    ay, by = (box[1] - oy) * iy, (box[4] - oy) * iy
    az, bz = (box[2] - oz) * iz, (box[5] - oz) * iz
    enter = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), np.float32(0.0)))
    leave = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), nearest))
    return enter if enter <= leave else _FAR


@inlined(fastmath=False)
def _inverse(x):
    # A ray along an axis would meet 0 times infinity at a box's border.
    if abs(x) < np.float32(1e-12):
        return np.float32(1e12) if x >= np.float32(0.0) else np.float32(-1e12)
    return np.float32(1.0) / x


@inlined(fastmath=CONTRACTED)
def first_face(tree, one_sided, ox, oy, oz, dx, dy, dz, stack):
    """Return (place among the hierarchy's faces or -1, distance, u, v) of the first face in a ray's way.

    Single precision throughout. `one_sided` rays pass through faces that they meet from behind. `stack`
    [STACK] is scratch. The hit is at (1 - u - v) times the first corner, u and v times the others.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
    best, nearest, best_u, best_v = -1, _FAR, zero, zero
    size, node = 0, 0
    while True:
        left = _enters(tree.boxes[node, 0], ox, oy, oz, ix, iy, iz, nearest)
        right = _enters(tree.boxes[node, 1], ox, oy, oz, ix, iy, iz, nearest)
        following = -1
        for turn in range(2):
            side = turn if left <= right else 1 - turn
            if (left if side == 0 else right) == _FAR:
                continue
            if tree.counts[node, side] == 0 and tree.children[node, side] > 0:
                if following < 0:
                    following = tree.children[node, side]
                else:
                    stack[size] = tree.children[node, side]
                    size += 1
                continue
            begin = -1 - tree.children[node, side]
            for f in range(begin, begin + tree.counts[node, side]):
                c = tree.corners[f]
                e1x, e1y, e1z, e2x, e2y, e2z = c[3], c[4], c[5], c[6], c[7], c[8]
                px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
                det = e1x * px + e1y * py + e1z * pz
                # Positive: the ray meets the side whose corners run counter-clockwise.
                if det == zero or (one_sided and det < zero):
                    continue
                inverse = one / det
                tx, ty, tz = ox - c[0], oy - c[1], oz - c[2]
                u = (tx * px + ty * py + tz * pz) * inverse
                if u < zero or u > one:
                    continue
                qx, qy, qz = ty * e1z - tz * e1y, tz * e1x - tx * e1z, tx * e1y - ty * e1x
                v = (dx * qx + dy * qy + dz * qz) * inverse
                if v < zero or u + v > one:
                    continue
                t = (e2x * qx + e2y * qy + e2z * qz) * inverse
                if zero < t < nearest:
                    best, nearest, best_u, best_v = f, t, u, v
        if following >= 0:
            node = following
        elif size > 0:
            size -= 1
            node = stack[size]
        else:
            return best, nearest, best_u, best_v


@compiled(fastmath=CONTRACTED)
def trace(tree, one_sided, origin, direction, face, distance, place):
    """Write each ray's first face (-1: none), its distance, and (u, v) there, [ray], [ray], [ray, 2]."""
    stack = np.empty(STACK, np.int32)
    for r in range(len(origin)):
        hit, far, u, v = first_face(
            tree,
            one_sided,
            origin[r, 0],
            origin[r, 1],
            origin[r, 2],
            direction[r, 0],
            direction[r, 1],
            direction[r, 2],
            stack,
        )
        face[r] = tree.face[hit] if hit >= 0 else -1
        distance[r], place[r, 0], place[r, 1] = far, u, v

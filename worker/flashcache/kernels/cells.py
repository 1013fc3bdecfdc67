"""Compiled loops over lattices of cells and rays through them."""

import numpy as np
from lambent_compute.compiling import compiled


@compiled(fastmath=False)
def write_stretches(origins, directions, near, far, cells, low, high, step, first, last):
    """Write the stretches of rays into `first` and `last` [rays]; arguments and rule as in `march`."""
    step = np.float32(step)
    count = cells.shape[0]
    limit = np.float32(count)
    scale = limit / (high - low)
    half = np.float32(0.5)
    for ray in range(len(near)):
        begin = end = np.float32(-1.0)
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        k = np.float32(0.0)
        while True:
            t = near[ray] + (k + half) * step
            k += np.float32(1.0)
            if not t < far[ray]:
                break
            x, y, z = (
                (ox + t * dx - low[0]) * scale[0],
                (oy + t * dy - low[1]) * scale[1],
                (oz + t * dz - low[2]) * scale[2],
            )
            if not (0.0 <= x < limit and 0.0 <= y < limit and 0.0 <= z < limit):
                continue
            if cells[int(x), int(y), int(z)]:
                if begin < 0.0:
                    begin = t
                end = t
        if begin < 0.0:
            first[ray] = last[ray] = near[ray]
        else:
            first[ray] = max(near[ray], begin - step)
            last[ray] = min(far[ray], end + step)


@compiled(fastmath=False)
def count_cells(world_to_camera, lens, frame, away, low, size, radius, margin_px, seen, denied):
    """Add to `seen` and `denied` [x, y, z] what a view shows of each cell; see `flashcache.data.hull`.

    `lens` has the focal lengths and the centre, `frame` what lies left, above, right and below of the
    picture, `away` [height, width] the distance of each pixel from the mask, all in pixels. `low`, `size` and
    `radius` are the lattice's corner, a cell's sides and half its diagonal, scene units.
    """
    height, width = away.shape
    for i in range(seen.shape[0]):
        for j in range(seen.shape[1]):
            for k in range(seen.shape[2]):
                x = low[0] + (i + 0.5) * size[0]
                y = low[1] + (j + 0.5) * size[1]
                z = low[2] + (k + 0.5) * size[2]
                m = world_to_camera
                depth = -(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
                if depth <= 1e-9:
                    continue
                column = lens[2] + lens[0] * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / depth
                row = lens[3] - lens[1] * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / depth
                if column < -frame[0] or column >= width + frame[2]:
                    continue
                if row < -frame[1] or row >= height + frame[3]:
                    continue
                seen[i, j, k] += 1
                # Outside of the picture: of its nearest pixel, and on from there.
                u = min(max(column, 0.5), width - 0.5)
                v = min(max(row, 0.5), height - 0.5)
                distance = away[int(v), int(u)] + np.hypot(column - u, row - v)
                if distance > radius * max(lens[0], lens[1]) / depth + margin_px:
                    denied[i, j, k] += 1

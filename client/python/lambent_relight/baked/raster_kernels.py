"""Compiled loops of the rasteriser. All release the interpreter lock and write nothing but their outputs.

Edge functions are products of two corners, so that an edge shared by two triangles has exactly opposite
values in them and no pixel falls between. No `fastmath`: contraction would break that.
"""

import numpy as np
from lambent_compute.compiling import compiled

_BEHIND = -1e-6
"""Corners nearer than this to the camera's plane, or behind it, have no place in the picture."""


@compiled(fastmath=False)
def draw_faces(points, faces, lens, rows, face_of, weights, depth):
    """Draw triangles into the rows `rows` = (first, end) of a picture; the nearest surface stays.

    `points` [vertex, 3] are camera coordinates (x right, y up, looking along -z, float64), `lens` is
    (focal_x, focal_y, centre_x, centre_y). A ray d meets the plane of corners a, b, c with weights
    d.(b x c), d.(c x a), d.(a x b) divided by their sum, at the distance a.(b x c) / sum: there is nothing
    to clip. Both sides are drawn.
    """
    focal_x, focal_y, centre_x, centre_y = lens[0], lens[1], lens[2], lens[3]
    width = face_of.shape[1]
    for f in range(faces.shape[0]):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        behind = (a[2] >= _BEHIND) + (b[2] >= _BEHIND) + (c[2] >= _BEHIND)
        if behind == 3:
            continue
        left, right, top, bottom = 0, width - 1, rows[0], rows[1] - 1
        if behind == 0:
            x0, x1, x2 = -a[0] / a[2], -b[0] / b[2], -c[0] / c[2]
            y0, y1, y2 = -a[1] / a[2], -b[1] / b[2], -c[1] / c[2]
            # One pixel more on each side: the box must not decide, the edges do.
            near = centre_x + focal_x * min(x0, x1, x2) - 1.5
            far = centre_x + focal_x * max(x0, x1, x2) + 0.5
            high = centre_y - focal_y * max(y0, y1, y2) - 1.5
            low = centre_y - focal_y * min(y0, y1, y2) + 0.5
            if far < left or near > right or low < top or high > bottom:
                continue
            left, right = max(left, int(near)), min(right, int(far) + 1)
            top, bottom = max(top, int(high)), min(bottom, int(low) + 1)
        ax, ay, az = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        bx, by, bz = c[1] * a[2] - c[2] * a[1], c[2] * a[0] - c[0] * a[2], c[0] * a[1] - c[1] * a[0]
        cx, cy, cz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        volume = a[0] * ax + a[1] * ay + a[2] * az
        if volume == 0.0:
            continue
        sign = 1.0 if volume > 0.0 else -1.0
        for r in range(top, bottom + 1):
            dy = (centre_y - r - 0.5) / focal_y
            ra, rb, rc = ay * dy - az, by * dy - bz, cy * dy - cz
            for column in range(left, right + 1):
                dx = (column + 0.5 - centre_x) / focal_x
                ea, eb, ec = ax * dx + ra, bx * dx + rb, cx * dx + rc
                if sign * ea < 0.0 or sign * eb < 0.0 or sign * ec < 0.0:
                    continue
                total = ea + eb + ec
                if total == 0.0:
                    continue
                distance = volume / total * np.sqrt(dx * dx + dy * dy + 1.0)
                if distance < depth[r, column]:
                    depth[r, column] = distance
                    face_of[r, column] = f
                    weights[r, column, 0] = eb / total
                    weights[r, column, 1] = ec / total


@compiled(fastmath=False)
def draw_charts(uv, faces, size, face_of, weights):
    """Draw the triangles of an atlas; where charts overlap the first stays. `uv` [vertex, 2] in texels."""
    for f in range(faces.shape[0]):
        a, b, c = uv[faces[f, 0]], uv[faces[f, 1]], uv[faces[f, 2]]
        left = max(0, int(min(a[0], b[0], c[0]) - 1.5))
        right = min(size - 1, int(max(a[0], b[0], c[0]) + 0.5))
        top = max(0, int(min(a[1], b[1], c[1]) - 1.5))
        bottom = min(size - 1, int(max(a[1], b[1], c[1]) + 0.5))
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(left, right + 1):
                if face_of[row, column] >= 0:
                    continue
                x = column + 0.5
                ea = (b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)
                eb = (c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)
                ec = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x)
                inside = (ea >= 0.0 and eb >= 0.0 and ec >= 0.0) or (ea <= 0.0 and eb <= 0.0 and ec <= 0.0)
                total = ea + eb + ec
                if inside and total != 0.0:
                    face_of[row, column] = f
                    weights[row, column, 0] = eb / total
                    weights[row, column, 1] = ec / total


@compiled(fastmath=False)
def spread(owner, queue, count):
    """Give every empty (-1) cell of `owner` [height, width] the value of a covered cell near it.

    `queue` [height * width] begins with the row-major places of the `count` covered cells, in the order of
    their values. Cells are reached in rings of 8 neighbours, and each takes the nearest of the cells that
    its neighbours know.
    """
    height, width = owner.shape
    places = queue[:count].copy()
    first = 0
    while first < count:
        row, column = queue[first] // width, queue[first] % width
        best = -1
        for dr, dc in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            r, c = row + dr, column + dc
            if 0 <= r < height and 0 <= c < width and owner[r, c] >= 0:
                place = places[owner[r, c]]
                away = (place // width - row) ** 2 + (place % width - column) ** 2
                if best < 0 or away < best:
                    best = away
                    owner[row, column] = owner[r, c]
        for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            r, c = row + dr, column + dc
            if 0 <= r < height and 0 <= c < width and owner[r, c] < 0:
                owner[r, c] = owner[row, column]
                queue[count] = r * width + c
                count += 1
        first += 1

"""The compiled loop that follows the rays of a pass to the first face of a mesh, or to the sky."""

import math

import numpy as np
from lambent_compute.compiling import compiled

from lambent_relight.environment.level_lookup import map_at, place_on_map
from lambent_relight.tracing.kernels import STACK, first_face


@compiled()
def follow(mesh, sky, points, known, drawn, listed, rays, where, out):
    """Add the means of light from the sky to `out` [6, point, 3], and return how many rays met a face.

    `mesh` is (hierarchy, one-sided), `sky` (map, turn), `points` (origins, normals), `known` what `cells_of`
    returns, `drawn` (directions, diffuse and specular weights, densities). Rays divide evenly among the
    points, in their order. Of those that met a face, where they are `listed`, `rays` [2, ray] become (number
    of the ray, face), and `where` [ray, 3] (distance, u, v).
    """
    tree, one_sided = mesh
    image, turn = sky
    origin, normal = points
    omega_i, diffuse, specular, pdf = drawn
    radiance, cells, seen = known
    rows, columns = cells.shape
    stack = np.empty(STACK, np.int32)
    per_point = len(omega_i) // max(len(origin), 1)
    count = 0
    for p in range(len(origin)):
        free = 0.0
        for r in range(p * per_point, (p + 1) * per_point):
            if pdf[r] <= 0.0:
                continue
            x, y, z = omega_i[r, 0], omega_i[r, 1], omega_i[r, 2]
            u, v = place_on_map(turn, x, y, z)
            if len(seen) > 0:
                row, column = min(int(v * rows), rows - 1), min(int(u * columns), columns - 1)
                cell = cells[row, column]
                if (seen[p, cell >> 3] >> (cell & 7)) & 1:
                    for k in range(3):
                        out[5, p, k] += diffuse[r, k] * radiance[row, column, k] / per_point
            face, distance, across, down = first_face(
                tree, one_sided, origin[p, 0], origin[p, 1], origin[p, 2], x, y, z, stack
            )
            if face >= 0:
                if listed:
                    rays[0, count], rays[1, count] = r, tree.face[face]
                    where[count, 0], where[count, 1], where[count, 2] = distance, across, down
                    count += 1
                continue
            cosine = max(normal[p, 0] * x + normal[p, 1] * y + normal[p, 2] * z, np.float32(0.0))
            free += cosine / (math.pi * pdf[r])
            light = map_at(image, u, v)
            for k in range(3):
                out[0, p, k] += (diffuse[r, k] + specular[r, k]) * light[k] / per_point
                out[2, p, k] += specular[r, k] * light[k] / per_point
        for k in range(3):
            out[3, p, k] += free / per_point
    return count


@compiled()
def add_bounces(rays, known, diffuse, specular, bouncing, out):
    """Add the means of light [ray, 3] that rays of these numbers brought from faces to `out` [6, point, 3].

    Of points where the diffuse part is `known` [point] it goes to the fifth.
    """
    per_point = len(diffuse) // len(known)
    for i in range(len(rays)):
        r = rays[i]
        p = r // per_point
        for k in range(3):
            glossy, matt = specular[r, k] * bouncing[i, k], diffuse[r, k] * bouncing[i, k]
            out[2, p, k] += glossy / per_point
            out[1, p, k] += (glossy if known[p] else glossy + matt) / per_point
            if known[p]:
                out[4, p, k] += matt / per_point


@compiled()
def sum_cells(directions, moment, least_cosine, normal, seen, out):
    """Clear the bits of `seen` [point, cell / 8] whose cells are not above the surface, and sum the others.

    `out` [point, 3] becomes the irradiance of the cells that are seen, from their moments.
    """
    total = np.empty((3, 3), np.float32)
    for p in range(len(seen)):
        total[:] = np.float32(0.0)
        x, y, z = normal[p, 0], normal[p, 1], normal[p, 2]
        for j in range(len(directions)):
            bit = np.uint8(1 << (j & 7))
            if not seen[p, j >> 3] & bit:
                continue
            if x * directions[j, 0] + y * directions[j, 1] + z * directions[j, 2] <= least_cosine:
                seen[p, j >> 3] &= ~bit
                continue
            for axis in range(3):
                for k in range(3):
                    total[axis, k] += moment[j, axis, k]
        for k in range(3):
            out[p, k] = x * total[0, k] + y * total[1, k] + z * total[2, k]

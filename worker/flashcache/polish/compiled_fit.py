"""Costs of materials at surface elements as compiled functions; formulas: `flashcache.polish.fit`."""

import math
from typing import NamedTuple

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray

ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
INVERSE_PI = np.float32(1.0 / math.pi)
GOLDEN_ANGLE = np.float32(math.pi * (3.0 - math.sqrt(5.0)))
MOST_OBSERVATIONS = 32
MOST_DIRECTIONS = 64
LEAST_COSINE = np.float32(0.02)


class Noise(NamedTuple):
    """How far observations may be from what is predicted."""

    floor: np.float32
    """Added to an observation's radiance, which is the variance of its error up to a factor."""
    outlier: np.float32
    """Weighted error beyond which an observation hardly counts."""
    dielectric: np.float32
    """Reflectance of dielectrics at normal incidence."""
    least_albedo: np.float32


class Observations(NamedTuple):
    """What photographs show of the elements, an element after another; see `flashcache.polish.elements`."""

    first: NDArray[np.int64]
    """Number of each element's first observation, and of all."""
    omega_o: NDArray[np.float32]
    detail: NDArray[np.float32]
    colour: NDArray[np.float32]
    clipped: NDArray[np.bool_]
    light: NDArray[np.int64]


class Arriving(NamedTuple):
    """The light at the elements, over the cells of a square of directions."""

    clear: NDArray[np.float32]
    """[elements, cells]"""
    near: NDArray[np.float32]
    """[lights, elements, cells, 3]"""
    sky: NDArray[np.float32]
    """[lights, fine cells, 3]"""
    directions: NDArray[np.float32]
    solid_angles: NDArray[np.float32]


class Lobes(NamedTuple):
    """The GGX widths that are tried, and the half vectors that sample each."""

    alphas: NDArray[np.float32]
    halves: NDArray[np.float32]
    """Variates [widths, most, 3]; see `_lobe_directions`."""
    counts: NDArray[np.int64]


class Costs(NamedTuple):
    """Results with the axes element, width, hypothesis (0 dielectric, 1 metal)."""

    cost: NDArray[np.float32]
    tilt: NDArray[np.int64]
    albedo: NDArray[np.float32]


@inlined()
def _place(side, x, y, z):
    """Return the first of the four cells around a direction, and how far it is from there across and down.

    The square's border is not crossed: outside of its outermost centres they count alone.
    """
    scale = ONE / (abs(x) + abs(y) + abs(z))
    u, v = x * scale, y * scale
    if z < ZERO:
        u, v = (
            (ONE - abs(v)) * (ONE if u >= ZERO else -ONE),
            (ONE - abs(u)) * (ONE if v >= ZERO else -ONE),
        )
    column = (u + ONE) * HALF * np.float32(side) - HALF
    row = (v + ONE) * HALF * np.float32(side) - HALF
    column = min(max(column, ZERO), np.float32(side - 1))
    row = min(max(row, ZERO), np.float32(side - 1))
    left, top = min(int(column), side - 2), min(int(row), side - 2)
    return top * side + left, column - np.float32(left), row - np.float32(top)


@inlined()
def _lookup(picture, side, x, y, z, out):
    """Write to `out` the picture's radiance in a direction, bilinear in the square."""
    a, fx, fy = _place(side, x, y, z)
    for c in range(3):
        upper = picture[a, c] + fx * (picture[a + 1, c] - picture[a, c])
        lower = picture[a + side, c] + fx * (picture[a + side + 1, c] - picture[a + side, c])
        out[c] = upper + fy * (lower - upper)


@inlined()
def _incoming(picture, clear, near, sky, side, scale):
    """Fill `picture` [fine cells, 3] with what arrives: near radiance and the clear share of the sky."""
    fine = side * scale
    for row in range(fine):
        for column in range(fine):
            cell = (row // scale) * side + column // scale
            place = row * fine + column
            for c in range(3):
                picture[place, c] = near[cell, c] + clear[cell] * sky[place, c]


@inlined()
def _tilted(normal, across, up, out):
    """Write to `out` the unit normal moved by `across` and `up` in its tangent plane, and the frame there."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    sign = ONE if nz >= ZERO else -ONE
    a = -ONE / (sign + nz)
    b = nx * ny * a
    tx, ty, tz = ONE + sign * nx * nx * a, sign * b, -sign * nx
    bx, by, bz = b, sign + ny * ny * a, -ny
    x, y, z = nx + across * tx + up * bx, ny + across * ty + up * by, nz + across * tz + up * bz
    length = ONE / np.float32(math.sqrt(x * x + y * y + z * z))
    out[0], out[1], out[2] = x * length, y * length, z * length


@inlined()
def _irradiance(coarse, directions, solid_angles, normal, out):
    """Write to `out` the irradiance over pi from a picture at its cells' directions."""
    red, green, blue = ZERO, ZERO, ZERO
    for d in range(directions.shape[0]):
        cosine = directions[d, 0] * normal[0] + directions[d, 1] * normal[1] + directions[d, 2] * normal[2]
        weight = cosine * solid_angles[d] if cosine > ZERO else ZERO
        red += weight * coarse[d, 0]
        green += weight * coarse[d, 1]
        blue += weight * coarse[d, 2]
    out[0], out[1], out[2] = red * INVERSE_PI, green * INVERSE_PI, blue * INVERSE_PI


@inlined()
def _lobe_directions(omega_o, normal, alpha, halves, count, turn, drawn):
    """Write to `drawn` [n, 5] the directions of one observation's specular integral, and their weights.

    The weights are what F0 multiplies, and the rest (Schlick); both are 0 for directions below the surface.
    Half vectors come from the density D (n.h), `count` of them with the variates `halves` [n, 3]: the tangent
    over alpha, and cosine and sine of the azimuth, which is turned by the angle `turn`.
    """
    nx, ny, nz = normal[0], normal[1], normal[2]
    cos_o = nx * omega_o[0] + ny * omega_o[1] + nz * omega_o[2]
    sign = ONE if nz >= ZERO else -ONE
    a = -ONE / (sign + nz)
    b = nx * ny * a
    tx, ty, tz = ONE + sign * nx * nx * a, sign * b, -sign * nx
    bx, by, bz = b, sign + ny * ny * a, -ny
    k = HALF * alpha
    towards_eye = ONE / (max(cos_o, LEAST_COSINE) * (ONE - k) + k)
    share = ONE / np.float32(count)
    turn_cosine, turn_sine = np.float32(math.cos(turn)), np.float32(math.sin(turn))
    for j in range(count):
        tangent = alpha * halves[j, 0]
        cosine = ONE / np.float32(math.sqrt(ONE + tangent * tangent))
        sine = tangent * cosine
        p = sine * (halves[j, 1] * turn_cosine - halves[j, 2] * turn_sine)
        q = sine * (halves[j, 1] * turn_sine + halves[j, 2] * turn_cosine)
        hx = p * tx + q * bx + cosine * nx
        hy = p * ty + q * by + cosine * ny
        hz = p * tz + q * bz + cosine * nz
        across = hx * omega_o[0] + hy * omega_o[1] + hz * omega_o[2]
        drawn[j, 0] = TWO * across * hx - omega_o[0]
        drawn[j, 1] = TWO * across * hy - omega_o[1]
        drawn[j, 2] = TWO * across * hz - omega_o[2]
        cos_i = drawn[j, 0] * nx + drawn[j, 1] * ny + drawn[j, 2] * nz
        drawn[j, 3], drawn[j, 4] = ZERO, ZERO
        if cos_i <= ZERO or across <= ZERO:
            continue
        weight = share * towards_eye * cos_i / (cos_i * (ONE - k) + k) * across / cosine
        grazing = ONE - min(across, ONE)
        fresnel = grazing * grazing
        fresnel = fresnel * fresnel * grazing
        drawn[j, 3], drawn[j, 4] = weight * (ONE - fresnel), weight * fresnel


@inlined()
def _lobe(picture, side, omega_o, normal, alpha, halves, count, turn, first, second, radiance, drawn):
    """Write the specular integrals of one observation: what F0 multiplies, and the rest."""
    _lobe_directions(omega_o, normal, alpha, halves, count, turn, drawn)
    for c in range(3):
        first[c], second[c] = ZERO, ZERO
    for j in range(count):
        if drawn[j, 3] + drawn[j, 4] > ZERO:
            _lookup(picture, side, drawn[j, 0], drawn[j, 1], drawn[j, 2], radiance)
            for c in range(3):
                first[c] += drawn[j, 3] * radiance[c]
                second[c] += drawn[j, 4] * radiance[c]


@inlined()
def _solved(metal, irradiance, first, second, seen, begin, end, noise, albedo, robust):
    """Write the best albedo of one hypothesis for observations `begin` to `end`, and return its cost.

    Reweighted least squares: the albedo for the present weights, then the weights for what it leaves, so that
    outliers hardly count.
    """
    detail, colour, clipped, light = seen.detail, seen.colour, seen.clipped, seen.light
    count = end - begin
    for o in range(count):
        robust[o] = ONE
    cost = ZERO
    for turn in range(3):
        for c in range(3):
            above, below = np.float32(3e-4), np.float32(1e-3)
            for o in range(count):
                measured = colour[begin + o, c]
                if metal:
                    factor, rest = detail[begin + o, c] * first[o, c], second[o, c]
                else:
                    factor = detail[begin + o, c] * irradiance[light[begin + o], c]
                    rest = noise.dielectric * first[o, c] + second[o, c]
                if clipped[begin + o, c] and albedo[c] * factor + rest > measured and turn > 0:
                    continue
                weight = robust[o] / (measured + noise.floor)
                above += weight * factor * (measured - rest)
                below += weight * factor * factor
            albedo[c] = min(max(above / below, noise.least_albedo), ONE)
        cost = ZERO
        for o in range(count):
            squared = ZERO
            for c in range(3):
                measured = colour[begin + o, c]
                if metal:
                    predicted = albedo[c] * detail[begin + o, c] * first[o, c] + second[o, c]
                else:
                    predicted = (
                        albedo[c] * detail[begin + o, c] * irradiance[light[begin + o], c]
                        + noise.dielectric * first[o, c]
                        + second[o, c]
                    )
                error = predicted - measured
                if clipped[begin + o, c] and error > ZERO:
                    error = ZERO
                squared += error * error / (measured + noise.floor)
            limit = noise.outlier * noise.outlier
            robust[o] = ONE / (ONE + squared / limit)
            cost += squared * robust[o]
    return cost / np.float32(count)


@compiled()
def sweep(
    begin, end, first_tilt, rows, observations, arriving, lobes, normal, tilts, tilt_cost, noise, costs
):
    """Write for the elements `rows` the cost, tilt and albedo of every width and both hypotheses.

    For `begin` to `end` of these. Tilts of `normal` [elements, 3] are tried from `first_tilt` on and chosen
    where they cost less than the results so far. The groups are `Observations`, `Arriving`, `Lobes`, `Noise`
    and `Costs` as plain tuples.
    """
    seen, light, lobe = Observations(*observations), Arriving(*arriving), Lobes(*lobes)
    noise, best = Noise(*noise), Costs(*costs)
    num_lights, cells = light.near.shape[0], light.clear.shape[1]
    side = int(math.sqrt(cells) + 0.5)
    fine = int(math.sqrt(light.sky.shape[1]) + 0.5)
    scale = fine // side
    pictures = np.zeros((num_lights, fine * fine, 3), np.float32)
    coarse = np.zeros((num_lights, cells, 3), np.float32)
    irradiance = np.zeros((num_lights, 3), np.float32)
    # The specular integrals of an element's observations by width: what F0 multiplies, and the rest.
    by_f0 = np.zeros((len(lobe.alphas), MOST_OBSERVATIONS, 3), np.float32)
    rest = np.zeros((len(lobe.alphas), MOST_OBSERVATIONS, 3), np.float32)
    robust = np.zeros(MOST_OBSERVATIONS, np.float32)
    drawn = np.zeros((MOST_DIRECTIONS, 5), np.float32)
    tilted, radiance, albedo = np.zeros(3, np.float32), np.zeros(3, np.float32), np.zeros(3, np.float32)
    area = ONE / np.float32(scale * scale)
    for row in range(begin, end):
        e = rows[row]
        start, stop = seen.first[e], seen.first[e + 1]

        # 1. What arrives at the element from all directions under each light: at full detail for reflections,
        # and as means over cells for the irradiance, which is blind to detail.
        for number in range(num_lights):
            _incoming(pictures[number], light.clear[e], light.near[number, e], light.sky[number], side, scale)
            for d in range(cells):
                for c in range(3):
                    coarse[number, d, c] = ZERO
            for place in range(fine * fine):
                cell = (place // fine // scale) * side + (place % fine) // scale
                for c in range(3):
                    coarse[number, cell, c] += area * pictures[number, place, c]
        for t in range(first_tilt, len(tilts)):
            # 2. The irradiance depends on the normal alone, not on the observation.
            _tilted(normal[e], tilts[t, 0], tilts[t, 1], tilted)
            for number in range(num_lights):
                _irradiance(coarse[number], light.directions, light.solid_angles, tilted, irradiance[number])
            for k in range(len(lobe.alphas)):
                # 3. The specular integral of every observation. Each turns the pattern of half vectors by
                # another angle, so that errors of few directions differ and cancel.
                for o in range(start, stop):
                    _lobe(
                        pictures[seen.light[o]], fine, seen.omega_o[o], tilted, lobe.alphas[k],
                        lobe.halves[k], lobe.counts[k], GOLDEN_ANGLE * np.float32(o - start),
                        by_f0[k, o - start], rest[k, o - start], radiance, drawn,
                    )  # fmt: skip
                # 4. Both hypotheses share these integrals; the best albedo of each has a closed form.
                for m in range(2):
                    tried = tilt_cost[t] + _solved(
                        m == 1, irradiance, by_f0[k], rest[k], seen, start, stop, noise, albedo, robust
                    )
                    if tried < best.cost[e, k, m]:
                        best.cost[e, k, m], best.tilt[e, k, m] = tried, t
                        for c in range(3):
                            best.albedo[e, k, m, c] = albedo[c]


@compiled()
def reflections(
    begin, end, element, first, omega_o, light, normal, alpha, halves, count, clear, near, fine, cells,
    weights, constant,
):  # fmt: skip
    """Write for the observations `begin` to `end` their specular integrals as sums over the sky's cells.

    `cells` [observations, 4 n] are places in a square of `fine` cells per side, `weights` [observations,
    4 n, 2] what F0 multiplies and the rest; `constant` [observations, 2, 3] is what comes from near surfaces.
    """
    side = int(math.sqrt(clear.shape[1]) + 0.5)
    scale = fine // side
    drawn = np.zeros((MOST_DIRECTIONS, 5), np.float32)
    for o in range(begin, end):
        e = element[o]
        turn = GOLDEN_ANGLE * np.float32(o - first[e])
        _lobe_directions(omega_o[o], normal[e], alpha[e], halves, count, turn, drawn)
        for part in range(2):
            for c in range(3):
                constant[o, part, c] = ZERO
        for j in range(count):
            a, fx, fy = _place(fine, drawn[j, 0], drawn[j, 1], drawn[j, 2])
            for corner in range(4):
                right, down = corner % 2, corner // 2
                place = a + right + down * fine
                share = (fx if right else ONE - fx) * (fy if down else ONE - fy)
                cell = (place // fine // scale) * side + (place % fine) // scale
                cells[o, 4 * j + corner] = place
                for part in range(2):
                    weight = share * drawn[j, 3 + part]
                    weights[o, 4 * j + corner, part] = weight * clear[e, cell]
                    for c in range(3):
                        constant[o, part, c] += weight * near[light[o], e, cell, c]


@compiled()
def reflected(begin, end, cells, weights, f0, light, sky, radiance):
    """Write for the observations `begin` to `end` the specular `radiance` [observations, 3] under `sky`.

    `cells` and `weights` are those of `reflections`, without near surfaces; `sky` [lights, cells, 3].
    """
    for o in range(begin, end):
        red, green, blue = ZERO, ZERO, ZERO
        f_red, f_green, f_blue = f0[o, 0], f0[o, 1], f0[o, 2]
        picture = sky[light[o]]
        for j in range(cells.shape[1]):
            cell, a, b = cells[o, j], weights[o, j, 0], weights[o, j, 1]
            red += (f_red * a + b) * picture[cell, 0]
            green += (f_green * a + b) * picture[cell, 1]
            blue += (f_blue * a + b) * picture[cell, 2]
        radiance[o, 0], radiance[o, 1], radiance[o, 2] = red, green, blue


@compiled()
def gathered(begin, end, rows, cells, weights, f0, light, residual, gradient):
    """Add what `reflected` does to its observations' residuals, backwards: to the cells of the sky.

    For parts `begin` to `end` of `rows` observations each. `gradient` [parts, lights, cells, 3] begins with
    zeros.
    """
    for part in range(begin, end):
        for o in range(part * rows, min((part + 1) * rows, len(cells))):
            of_light = gradient[part, light[o]]
            r_red, r_green, r_blue = residual[o, 0], residual[o, 1], residual[o, 2]
            f_red, f_green, f_blue = f0[o, 0], f0[o, 1], f0[o, 2]
            for j in range(cells.shape[1]):
                cell, a, b = cells[o, j], weights[o, j, 0], weights[o, j, 1]
                of_light[cell, 0] += (f_red * a + b) * r_red
                of_light[cell, 1] += (f_green * a + b) * r_green
                of_light[cell, 2] += (f_blue * a + b) * r_blue

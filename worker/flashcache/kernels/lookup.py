"""Feature grids for a block of points, as [feature, point]; the formula is that of `layout`.

First the rows around all points of a level are computed, in vector code over the points; then they are
mixed, in vector code over the features of a row. Row numbers are 32 bits wide: what a mask keeps of a sum is
the same as with 64 bits.
"""

from typing import Any, NamedTuple

import numpy as np
from lambent_compute.compiling import inlined
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

ZERO = np.float32(0.0)
STEP = np.uint32(1)

AHEAD = 8
"""Points by which rows are requested from memory before they are mixed, in levels that are larger than the
core's own cache."""
LARGE_VALUES = 2**18
"""Values of a level from which this pays (1 MiB)."""


class Grid(NamedTuple):
    """A feature grid as the compiled loops read it; see `cpu.Levels`."""

    table: NDArray[np.float32]
    counts: NDArray[np.uint64]
    scales: NDArray[np.float32]
    output_scale: np.float32


class Voxels(NamedTuple):
    """Scratch memory: the 8 rows around each point of a level, x fastest, and its position between them."""

    rows: NDArray[np.uint32]
    """[8, points and AHEAD more]"""
    between: NDArray[np.float32]
    """[3, points]"""


@inlined()
def voxels_of(num_points):
    """Return scratch memory for blocks of at most `num_points` points."""
    return Voxels(np.zeros((8, num_points + 64), np.uint32), np.empty((3, num_points), np.float32))


@inlined()
def _axis(coordinate, scale, centre, largest):
    """Return the place along an axis, clamped to the grid; a NaN fails the comparison and becomes 0."""
    u = coordinate * scale + centre
    u = u if u > ZERO else ZERO
    return u if u < largest else largest


@inlined()
def _locate(points, count, grid, level, voxels):
    """Write the rows around the first `count` of `points` [3, any] and the positions between them."""
    scale, centre, largest = grid.scales[level, 0], grid.scales[level, 1], grid.scales[level, 2]
    first, mask = np.uint32(grid.counts[level, 0]), np.uint32(grid.counts[level, 1] & np.uint64(0xFFFFFFFF))
    along_y, along_z = np.uint32(grid.counts[level, 2]), np.uint32(grid.counts[level, 3])
    top = np.int32(grid.counts[level, 4])
    rows, between = voxels.rows, voxels.between
    for i in range(count):
        x = _axis(points[0, i], scale, centre, largest)
        y = _axis(points[1, i], scale, centre, largest)
        z = _axis(points[2, i], scale, centre, largest)
        cell_x, cell_y, cell_z = np.int32(x), np.int32(y), np.int32(z)
        cell_x = top if cell_x > top else cell_x
        cell_y = top if cell_y > top else cell_y
        cell_z = top if cell_z > top else cell_z
        between[0, i] = x - np.float32(cell_x)
        between[1, i] = y - np.float32(cell_y)
        between[2, i] = z - np.float32(cell_z)
        near = np.uint32(
            np.uint32(cell_x)
            + np.uint32(np.uint32(cell_y) * along_y)
            + np.uint32(np.uint32(cell_z) * along_z)
        )
        upper = np.uint32(near + along_y)
        rows[0, i] = first + np.uint32(near & mask)
        rows[1, i] = first + np.uint32(np.uint32(near + STEP) & mask)
        rows[2, i] = first + np.uint32(upper & mask)
        rows[3, i] = first + np.uint32(np.uint32(upper + STEP) & mask)
        near, upper = np.uint32(near + along_z), np.uint32(upper + along_z)
        rows[4, i] = first + np.uint32(near & mask)
        rows[5, i] = first + np.uint32(np.uint32(near + STEP) & mask)
        rows[6, i] = first + np.uint32(upper & mask)
        rows[7, i] = first + np.uint32(np.uint32(upper + STEP) & mask)


def _mixer(num_features: int) -> Any:
    """Return a function that mixes the 8 rows of a point as vectors of `num_features` numbers.

    Its arguments are the table, the rows and the positions as in `Voxels`, the number of the point, the
    factor of the features, the result [any, any] and the row of the first feature in it.
    """

    @intrinsic
    def mix(typing_context, table, rows, between, i, scale, result, first):
        signature = types.void(table, rows, between, i, scale, result, first)

        def code(context, builder, signature, arguments):
            number = ir.IntType(64)
            vector = ir.VectorType(ir.FloatType(), num_features)
            made = [
                context.make_array(signature.args[k])(context, builder, arguments[k]) for k in (0, 1, 2, 5)
            ]
            table, rows, between, result = (array.data for array in made)
            widths = [builder.extract_value(array.shape, 1) for array in made]
            i, scale, first = arguments[3], arguments[4], arguments[6]
            mask = ir.Constant(ir.VectorType(ir.IntType(32), num_features), [0] * num_features)
            nothing = ir.Constant(vector, ir.Undefined)

            def at(base, width, line):
                return builder.gep(base, [builder.add(i, builder.mul(width, line))])

            def splat(value):
                one = builder.insert_element(nothing, value, ir.Constant(ir.IntType(32), 0))
                return builder.shuffle_vector(one, nothing, mask)

            def lerp(a, b, t):
                flags = ("contract",)
                return builder.fadd(a, builder.fmul(t, builder.fsub(b, a), flags=flags), flags=flags)

            corners = []
            for corner in range(8):
                row = builder.load(at(rows, widths[1], ir.Constant(number, corner)))
                offset = builder.mul(builder.zext(row, number), ir.Constant(number, num_features))
                place = builder.bitcast(builder.gep(table, [offset]), vector.as_pointer())
                corners.append(builder.load(place))
                corners[-1].align = 4
            for axis in range(3):
                t = splat(builder.load(at(between, widths[2], ir.Constant(number, axis))))
                corners = [lerp(a, b, t) for a, b in zip(corners[::2], corners[1::2], strict=True)]
            values = builder.fmul(corners[0], splat(scale))
            for f in range(num_features):
                value = builder.extract_element(values, ir.Constant(ir.IntType(32), f))
                builder.store(value, at(result, widths[3], builder.add(first, ir.Constant(number, f))))
            return context.get_dummy_value()

        return signature, code

    return mix


_mix_2, _mix_4, _mix_8 = (_mixer(count) for count in (2, 4, 8))


@intrinsic
def _request(typing_context, table, row):
    """Ask for the memory of a row of the table, without waiting."""

    def code(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        number, byte = ir.IntType(64), ir.IntType(8).as_pointer()
        offset = builder.mul(builder.zext(arguments[1], number), builder.extract_value(array.shape, 1))
        place = builder.bitcast(builder.gep(array.data, [offset]), byte)
        options = [ir.IntType(32)] * 3
        function = ir.FunctionType(ir.VoidType(), [byte, *options])
        prefetch = cgutils.get_or_insert_function(builder.module, function, "llvm.prefetch.p0i8")
        # To be read (0), kept close to the core (3), as data (1).
        builder.call(prefetch, [place, *(ir.Constant(ir.IntType(32), value) for value in (0, 3, 1))])
        return context.get_dummy_value()

    return types.void(table, types.uint32), code


@inlined()
def _request_rows(table, rows, i):
    """Ask for the rows around point `i`; the neighbour along x mostly lies in the same piece of memory."""
    for corner in range(0, 8, 2):
        _request(table, rows[corner, i])


@inlined()
def _lerp(a, b, t):
    return a + t * (b - a)


@inlined()
def encode(points, count, grid, voxels, features, first):
    """Write the features of the first `count` of `points` [3, any] to `features`, from row `first` on."""
    table, scale, num_features = grid.table, grid.output_scale, grid.table.shape[1]
    rows, between = voxels.rows, voxels.between
    for level in range(grid.counts.shape[0]):
        _locate(points, count, grid, level, voxels)
        row = first + level * num_features
        large = np.int64(grid.counts[level, 5]) * num_features >= LARGE_VALUES
        if num_features == 2 and large:
            for i in range(count):
                _request_rows(table, rows, i + AHEAD)
                _mix_2(table, rows, between, i, scale, features, row)
        elif num_features == 2:
            for i in range(count):
                _mix_2(table, rows, between, i, scale, features, row)
        elif num_features == 4:
            for i in range(count):
                _mix_4(table, rows, between, i, scale, features, row)
        elif num_features == 8:
            for i in range(count):
                _mix_8(table, rows, between, i, scale, features, row)
        else:
            for f in range(num_features):
                for i in range(count):
                    x, y, z = between[0, i], between[1, i], between[2, i]
                    c0 = _lerp(table[rows[0, i], f], table[rows[1, i], f], x)
                    c1 = _lerp(table[rows[2, i], f], table[rows[3, i], f], x)
                    c2 = _lerp(table[rows[4, i], f], table[rows[5, i], f], x)
                    c3 = _lerp(table[rows[6, i], f], table[rows[7, i], f], x)
                    features[row + f, i] = scale * _lerp(_lerp(c0, c1, y), _lerp(c2, c3, y), z)

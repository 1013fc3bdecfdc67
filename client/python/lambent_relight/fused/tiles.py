"""Affine layers on blocks of rows, with vector instructions of the width that the processor has.

Compilers vectorise a plain loop over rows, but load and store every sum again for each input. Here the sums
of a tile of outputs and rows stay in registers while all inputs pass; it is written as LLVM instructions.
"""

from typing import Any

from llvmlite import binding, ir
from numba import njit, types
from numba.extending import intrinsic

from lambent_relight.compiling import COMPILE_OPTIONS

BLOCK = 64
"""Rows that are evaluated together."""
STRIDE = BLOCK + 16
"""Row length of arrays of activations: with a power of two, rows would share a few lines of the cache."""

_WIDE = bool(binding.get_host_cpu_features().get("avx512f"))
_LANES = 16 if _WIDE else 8
"""Numbers in a vector; a machine with narrower registers takes several for one."""
_VECTORS = 4 if _WIDE else 2
"""Vectors of rows in a tile: six outputs by so many fill 24 of 32 registers, or 12 of 16."""

_FLOAT, _INDEX = ir.FloatType(), ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, _LANES)


def _splat(builder: Any, value: Any) -> Any:
    """Return a vector of `value` in every lane."""
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
    return builder.shuffle_vector(one, undefined, zeros)


def _vector_at(builder: Any, pointer: Any, index: Any) -> Any:
    return builder.bitcast(builder.gep(pointer, [index]), _VECTOR.as_pointer())


def _tile(num_outputs: int) -> Any:
    """Return the compiled function of a tile of `num_outputs` outputs; its arguments are addresses.

    It writes the sums over `count` inputs: weights [output, `count`] times source [`count`, STRIDE], plus
    bias, to out [output, STRIDE].
    """

    @intrinsic
    def tile(_context, weights, bias, source, out, count):
        signature = types.void(weights, bias, source, out, count)

        def generate(context, builder, _signature, arguments):
            *addresses, count = arguments
            weights, bias, source, out = (
                builder.inttoptr(address, _FLOAT.as_pointer()) for address in addresses
            )

            def index(number: int) -> ir.Constant:
                return ir.Constant(_INDEX, number)

            starts = [
                _splat(builder, builder.load(builder.gep(bias, [index(o)]))) for o in range(num_outputs)
            ]
            before = builder.block
            loop, done = builder.append_basic_block("inputs"), builder.append_basic_block("done")
            builder.branch(loop)
            builder.position_at_end(loop)
            i = builder.phi(_INDEX)
            i.add_incoming(index(0), before)
            sums = [[builder.phi(_VECTOR) for _ in range(_VECTORS)] for _ in range(num_outputs)]
            for start, row in zip(starts, sums, strict=True):
                for total in row:
                    total.add_incoming(start, before)
            first = builder.mul(i, index(STRIDE))
            values = []
            for v in range(_VECTORS):
                place = _vector_at(builder, source, builder.add(first, index(v * _LANES)))
                values.append(builder.load(place, align=4))
            after = []
            for o, row in enumerate(sums):
                place = builder.gep(weights, [builder.add(builder.mul(count, index(o)), i)])
                weight = _splat(builder, builder.load(place))
                after.append(
                    [
                        builder.fadd(
                            total, builder.fmul(weight, value, flags=("contract",)), flags=("contract",)
                        )
                        for total, value in zip(row, values, strict=True)
                    ]
                )
            following = builder.add(i, index(1))
            i.add_incoming(following, loop)
            for row, new in zip(sums, after, strict=True):
                for total, value in zip(row, new, strict=True):
                    total.add_incoming(value, loop)
            builder.cbranch(builder.icmp_signed("<", following, count), loop, done)
            builder.position_at_end(done)
            for o, row in enumerate(after):
                for v, value in enumerate(row):
                    place = _vector_at(builder, out, index(o * STRIDE + v * _LANES))
                    builder.store(value, place, align=4)
            return context.get_dummy_value()

        return signature, generate

    return tile


_six, _four, _two, _one = (_tile(count) for count in (6, 4, 2, 1))


@njit(**COMPILE_OPTIONS)
def affine(weights, bias, source, out):
    """Write weights [out, in] times `source` [in, STRIDE] plus bias to the first rows of `out`.

    All arrays are contiguous float32; the first BLOCK columns count, and there is at least one input.
    """
    num_out, num_in = weights.shape
    columns = _LANES * _VECTORS
    for column in range(0, BLOCK, columns):
        values, target = source.ctypes.data + 4 * column, out.ctypes.data + 4 * column
        row = 0
        while row < num_out:
            w, b = weights.ctypes.data + 4 * row * num_in, bias.ctypes.data + 4 * row
            to, left = target + 4 * row * STRIDE, num_out - row
            if left >= 6:
                _six(w, b, values, to, num_in)
                row += 6
            elif left >= 4:
                _four(w, b, values, to, num_in)
                row += 4
            elif left >= 2:
                _two(w, b, values, to, num_in)
                row += 2
            else:
                _one(w, b, values, to, num_in)
                row += 1

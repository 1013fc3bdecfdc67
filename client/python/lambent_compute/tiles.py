"""Matrix products of small networks for blocks of 64 rows, in the processor's vector registers.

Activations of a block lie as [feature, row], so that one weight is multiplied with neighbouring rows. A tile
of the product stays in registers while the inputs pass by; LLVM alone would store it after every few inputs.
"""

from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba.core import types
from numba.extending import intrinsic

from lambent_compute.compiling import inlined

COLUMNS = 64
"""Rows of a batch that a tile holds: the columns of its arrays."""


def _register_tile() -> tuple[int, int, int]:
    """Return the lanes of a vector, and the vectors and the outputs of a tile that fits the registers."""
    features = binding.get_host_cpu_features()
    if features.get("avx512f"):
        return 16, 4, 6
    if features.get("avx2"):
        return 8, 2, 6
    return 4, 4, 4


LANES, VECTORS, OUTPUTS = _register_tile()
CHUNK = LANES * VECTORS


def _product(num_outputs: int) -> Any:
    """Return a function that writes `num_outputs` rows of CHUNK columns of weights times source plus bias.

    Its arguments are the parameters (1-D), the offsets of the weights [outputs, inputs] and of the bias, the
    number of inputs, the source [inputs, any] and its first column, the result [any, any], its first row and
    column, and the least value of a result.
    """

    @intrinsic
    def product(
        typing_context, parameters, weight, bias, inputs, source, source_column, result, row, column, least
    ):
        signature = types.void(
            parameters, weight, bias, inputs, source, source_column, result, row, column, least
        )

        def code(context, builder, signature, arguments):
            number, single = ir.IntType(64), ir.FloatType()
            vector = ir.VectorType(single, LANES)
            arrays = [
                context.make_array(signature.args[i])(context, builder, arguments[i]) for i in (0, 4, 6)
            ]
            parameters, source, result = (array.data for array in arrays)
            widths = [builder.extract_value(array.shape, 1) for array in arrays[1:]]
            weight, bias, inputs, source_column, row, column = (arguments[i] for i in (1, 2, 3, 5, 7, 8))

            def splat(value):
                one = builder.insert_element(
                    ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
                )
                mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
                return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), mask)

            def place(base, offset, extra):
                address = builder.gep(base, [builder.add(offset, ir.Constant(number, extra))])
                return builder.bitcast(address, vector.as_pointer())

            weights = [
                builder.gep(
                    parameters, [builder.add(weight, builder.mul(inputs, ir.Constant(number, output)))]
                )
                for output in range(num_outputs)
            ]
            starts = []
            for output in range(num_outputs):
                address = builder.gep(parameters, [builder.add(bias, ir.Constant(number, output))])
                starts.append(splat(builder.load(address)))
            before = builder.block
            loop, done = builder.append_basic_block("inputs"), builder.append_basic_block("done")
            builder.branch(loop)
            builder.position_at_end(loop)
            k = builder.phi(number)
            k.add_incoming(ir.Constant(number, 0), before)
            sums = [[builder.phi(vector) for _ in range(VECTORS)] for _ in range(num_outputs)]
            for start, several in zip(starts, sums, strict=True):
                for one in several:
                    one.add_incoming(start, before)
            offset = builder.add(source_column, builder.mul(k, widths[0]))
            values = []
            for v in range(VECTORS):
                values.append(builder.load(place(source, offset, LANES * v)))
                values[-1].align = 4
            later = []
            for output in range(num_outputs):
                factor = splat(builder.load(builder.gep(weights[output], [k])))
                later.append(
                    [
                        builder.fadd(
                            sums[output][v],
                            builder.fmul(factor, values[v], flags=("contract",)),
                            flags=("contract",),
                        )
                        for v in range(VECTORS)
                    ]
                )
            following = builder.add(k, ir.Constant(number, 1))
            k.add_incoming(following, loop)
            for several, new in zip(sums, later, strict=True):
                for one, value in zip(several, new, strict=True):
                    one.add_incoming(value, loop)
            builder.cbranch(builder.icmp_signed("<", following, inputs), loop, done)
            builder.position_at_end(done)
            floor = splat(arguments[9])
            for output in range(num_outputs):
                line = builder.add(row, ir.Constant(number, output))
                offset = builder.add(column, builder.mul(line, widths[1]))
                for v in range(VECTORS):
                    value = later[output][v]
                    # A number that is none stays so.
                    value = builder.select(builder.fcmp_ordered("<", value, floor), floor, value)
                    builder.store(value, place(result, offset, LANES * v)).align = 4
            return context.get_dummy_value()

        return signature, code

    return product


_many, _two, _one = _product(OUTPUTS), _product(2), _product(1)

NO_FLOOR = np.float32(-np.inf)
ZERO = np.float32(0.0)


@inlined()
def affine(parameters, layer, source, column, result, row, relu):
    """Write weights times source plus bias to `result` [any, COLUMNS or more], from row `row` on.

    `layer` holds the offset of the weights [outputs, inputs] in `parameters`, that of the bias, and the
    numbers of inputs (one or more) and outputs. `source` is [inputs or more, any]; COLUMNS of its columns
    from `column` on are taken.
    """
    weight, bias, inputs, outputs = layer[0], layer[1], layer[2], layer[3]
    least = ZERO if relu else NO_FLOOR
    for c in range(0, COLUMNS, CHUNK):
        first, o = column + c, 0
        while o < outputs:
            w, b, to = weight + o * inputs, bias + o, row + o
            if outputs - o >= OUTPUTS:
                _many(parameters, w, b, inputs, source, first, result, to, c, least)
                o += OUTPUTS
            elif outputs - o >= 2:
                _two(parameters, w, b, inputs, source, first, result, to, c, least)
                o += 2
            else:
                _one(parameters, w, b, inputs, source, first, result, to, c, least)
                o += 1

"""Elementary functions of single precision as polynomials without branches.

LLVM turns these into vector code, but not calls of the mathematical library.
"""

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from lambent_compute.compiling import CONTRACTED, inlined

_in_order = inlined(CONTRACTED)

HALF, ONE, TWO = np.float32(0.5), np.float32(1.0), np.float32(2.0)
ZERO = np.float32(0.0)


@intrinsic
def _float_of_bits(typing_context, bits):
    """Return the single-precision number that 32 bits stand for."""

    def code(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.FloatType())

    return types.float32(types.int32), code


@intrinsic
def _bits_of_float(typing_context, value):
    """Return the 32 bits of a single-precision number."""

    def code(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], ir.IntType(32))

    return types.int32(types.float32), code


@_in_order
def exponential(x):
    """Return e^x, between e^-87 and e^88 for all x but NaN (Cephes; relative error 2e-7)."""
    x = np.float32(88.0) if x > np.float32(88.0) else x
    x = np.float32(-87.0) if x < np.float32(-87.0) else x
    whole = np.floor(x * np.float32(1.4426950408889634) + HALF)
    # log 2 in two parts, of which the first has a short product with whole numbers.
    y = x - whole * np.float32(0.693359375)
    y = y - whole * np.float32(-2.12194440e-4)
    value = np.float32(1.9875691500e-4) * y + np.float32(1.3981999507e-3)
    value = value * y + np.float32(8.3334519073e-3)
    value = value * y + np.float32(4.1665795894e-2)
    value = value * y + np.float32(1.6666665459e-1)
    value = value * y + np.float32(5.0000001201e-1)
    value = value * y * y + y + ONE
    return value * _float_of_bits(np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)))


@_in_order
def logarithm(x):
    """Return log(x) for a normal positive number (Cephes; error 1e-7 + 1e-7 |log x|)."""
    bits = _bits_of_float(x)
    # The exponent with which the rest lies between sqrt(1/2) and sqrt(2).
    shifted = np.int32(bits - np.int32(0x3F3504F3))
    exponent = np.int32(shifted >> np.int32(23))
    rest = _float_of_bits(np.int32(bits - np.int32(exponent << np.int32(23)))) - ONE
    z = rest * rest
    value = np.float32(7.0376836292e-2) * rest + np.float32(-1.1514610310e-1)
    value = value * rest + np.float32(1.1676998740e-1)
    value = value * rest + np.float32(-1.2420140846e-1)
    value = value * rest + np.float32(1.4249322787e-1)
    value = value * rest + np.float32(-1.6668057665e-1)
    value = value * rest + np.float32(2.0000714765e-1)
    value = value * rest + np.float32(-2.4999993993e-1)
    value = value * rest + np.float32(3.3333331174e-1)
    value = value * rest * z - HALF * z
    whole = np.float32(exponent)
    value = value + whole * np.float32(-2.12194440e-4)
    return rest + value + whole * np.float32(0.693359375)


@_in_order
def power(x, exponent):
    """Return x to the `exponent`, for a normal positive x (relative error 1e-6 for results of 1e-3..1e3)."""
    return exponential(exponent * logarithm(x))


@_in_order
def softplus(x):
    """Return log(1 + e^x), as max(x, 0) + log(1 + e^-|x|) (error 2e-7 + 1e-7 |x|)."""
    t = exponential(-abs(x))
    # log(1 + t) / t, by Chebyshev interpolation on 0..1.
    value = np.float32(-0.0031760570127516985)
    value = value * t + np.float32(0.019542528316378593)
    value = value * t + np.float32(-0.05637361481785774)
    value = value * t + np.float32(0.10543623566627502)
    value = value * t + np.float32(-0.1526966691017151)
    value = value * t + np.float32(0.1966327428817749)
    value = value * t + np.float32(-0.24951615929603577)
    value = value * t + np.float32(0.33329710364341736)
    value = value * t + np.float32(-0.49999892711639404)
    value = value * t + ONE
    # A NaN fails the comparison and stays one.
    return (ZERO if x < ZERO else x) + value * t


@_in_order
def sigmoid(x):
    """Return 1 / (1 + e^-x)."""
    return ONE / (ONE + exponential(-x))


@_in_order
def opaque_share(depth):
    """Return 1 - e^-depth for depths of zero or more, small ones exactly as well (relative error 3e-7)."""
    series = np.float32(1.0 / 720.0) * depth - np.float32(1.0 / 120.0)
    series = series * depth + np.float32(1.0 / 24.0)
    series = series * depth - np.float32(1.0 / 6.0)
    series = (series * depth + HALF) * depth
    return depth - depth * series if depth < np.float32(0.25) else ONE - exponential(-depth)


@_in_order
def sine_and_cosine(x):
    """Return sin(x) and cos(x) for |x| below 1000 (Cephes; error 2e-7)."""
    quarters = np.floor(x * np.float32(0.6366197723675814) + HALF)
    # A quarter turn in three parts, of which the first has a short product with whole numbers.
    y = x - quarters * np.float32(1.5703125)
    y = y - quarters * np.float32(4.837512969970703e-4)
    y = y - quarters * np.float32(7.549789948768648e-8)
    z = y * y
    sine = np.float32(-1.9515295891e-4) * z + np.float32(8.3321608736e-3)
    sine = (sine * z + np.float32(-1.6666654611e-1)) * z * y + y
    cosine = np.float32(2.443315711809948e-5) * z + np.float32(-1.388731625493765e-3)
    cosine = (cosine * z + np.float32(4.166664568298827e-2)) * z * z - HALF * z + ONE
    halves = np.floor(quarters * HALF)
    odd = quarters - halves * TWO
    later = halves + odd
    first = (sine + odd * (cosine - sine)) * (ONE - TWO * (halves - TWO * np.floor(halves * HALF)))
    second = (cosine + odd * (sine - cosine)) * (ONE - TWO * (later - TWO * np.floor(later * HALF)))
    return first, second

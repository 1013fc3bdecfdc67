"""Compiled loop over the elements of scrambled Sobol sequences.

Digits are scrambled from the highest down, each by what the higher ones are: with the digits in reverse,
that is any chain of additions, odd multiplications and x ^= x * even. Source: Owen 1995; Burley 2020,
"Practical hash-based Owen scrambling", with the constants of Vegdahl 2021.
"""

import numpy as np
from lambent_compute.compiling import compiled, inlined

_LOW = np.uint64(0xFFFFFFFF)
_ONE = np.uint64(1)
_HALF = np.uint64(32)


@inlined(fastmath=False)
def _reversed(x):
    """Return the 32 lowest bits of `x` in reverse."""
    x = ((x & np.uint64(0x55555555)) << _ONE) | ((x >> _ONE) & np.uint64(0x55555555))
    x = ((x & np.uint64(0x33333333)) << np.uint64(2)) | ((x >> np.uint64(2)) & np.uint64(0x33333333))
    x = ((x & np.uint64(0x0F0F0F0F)) << np.uint64(4)) | ((x >> np.uint64(4)) & np.uint64(0x0F0F0F0F))
    x = ((x & np.uint64(0x00FF00FF)) << np.uint64(8)) | ((x >> np.uint64(8)) & np.uint64(0x00FF00FF))
    return ((x & np.uint64(0xFFFF)) << np.uint64(16)) | (x >> np.uint64(16))


@inlined(fastmath=False)
def _scrambled(digits, seed):
    """Return 32 digits scrambled by a seed of 64 random bits: every result is equally likely."""
    x = _reversed(digits)
    x ^= (x * np.uint64(0x3D20ADEA)) & _LOW
    x = (x + (seed >> _HALF)) & _LOW
    x = (x * ((seed & _LOW) | _ONE)) & _LOW
    x ^= (x * np.uint64(0x05526C56)) & _LOW
    x ^= (x * np.uint64(0x53A22864)) & _LOW
    return _reversed(x)


@compiled(fastmath=False)
def write_elements(numbers, seeds, sequence, first, per_point, u):
    """Write `per_point` consecutive elements of a sequence for each point to `u` [point * per_point, 3].

    `numbers` [3, 32] are the direction numbers and `seeds` [sequence, 3] the random bits of every sequence,
    uint64. Point p gets elements `first[p]` and following of the sequence `sequence[p]`.
    """
    for p in range(len(sequence)):
        for k in range(per_point):
            for dimension in range(3):
                digits, bit, rest = np.uint64(0), 0, np.uint64(first[p] + k)
                while rest:
                    if rest & _ONE:
                        digits ^= numbers[dimension, bit]
                    rest >>= _ONE
                    bit += 1
                element = _scrambled(digits, seeds[sequence[p], dimension])
                u[p * per_point + k, dimension] = element / 4294967296.0

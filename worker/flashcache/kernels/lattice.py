"""The additive lattice hash: row = (x + b y + c z) mod T, and the search for its multipliers.

The voxels that share a row with voxel 0 form a lattice; b and c are chosen so that its shortest vector is as
long as possible, so colliding voxels are as far from each other as T rows allow. Unlike the exclusive-or
hash of instant NGP the formula needs neither integer overflow nor bit operations, which some runtimes lack.
"""

from typing import Final

MAX_COORDINATE: Final = 2048
"""Largest voxel coordinate: 2048 (1 + (T - 1) + (T - 1)) stays below 2**31 for T up to 2**19."""

MULTIPLIERS: Final[dict[int, tuple[int, int]]] = {
    12: (1099, 1191),
    13: (1162, 4744),
    14: (6024, 4829),
    15: (25950, 9244),
    16: (37642, 4945),
    17: (53974, 15840),
    18: (177852, 190581),
    19: (5468, 133766),
}
"""log2(T) -> (b, c), found by `search` (benchmarks/lattice_search.py in revision 41a0d66)."""

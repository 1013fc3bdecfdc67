"""Search multipliers of the additive hash (x + b y + c z) mod T for `flashcache.kernels.lattice`.

    python benchmarks/lattice_search.py 17 --candidates 2000000

Draws pairs (b, c) at random and keeps the one whose shortest collision vector is longest. Two million pairs
take seconds for T = 2^12 and minutes for T = 2^19, and come within two percent of the densest packing.
"""

import argparse

import numba
import numpy as np


@numba.njit
def shortest_collision_squared(b: int, c: int, table_size: int, floor: int) -> int:
    """Return the squared length of the shortest offset that maps to row 0, or early a value below `floor`."""
    best = table_size * table_size
    z = 0
    while z * z < best:
        reach = int(np.sqrt(best)) + 1
        # Offsets come in pairs (v, -v): half of space is enough.
        for y in range(1 if z == 0 else -reach, reach + 1):
            rest = y * y + z * z
            if rest < best:
                x = (b * y + c * z) % table_size
                x = min(x, table_size - x)
                best = min(best, rest + x * x)
                if best <= floor:
                    return best
        z += 1
    return best


@numba.njit
def search(table_size: int, candidates: int, seed: int) -> tuple[int, int, int]:
    """Return (squared length, b, c) of the best of `candidates` random pairs."""
    np.random.seed(seed)
    found = (0, 0, 0)
    for _ in range(candidates):
        b, c = np.random.randint(1, table_size), np.random.randint(1, table_size)
        squared = shortest_collision_squared(b, c, table_size, found[0])
        if squared > found[0]:
            found = (squared, b, c)
    return found


def main() -> None:
    """Print the best pair for each table size asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log2_table_size", type=int, nargs="+")
    parser.add_argument("--candidates", type=int, default=2_000_000)
    parser.add_argument("--seed", type=int, help="default: the logarithm of the table size")
    arguments = parser.parse_args()
    for exponent in arguments.log2_table_size:
        seed = exponent if arguments.seed is None else arguments.seed
        squared, b, c = search(2**exponent, arguments.candidates, seed)
        bound = (2.0**0.5 * 2**exponent) ** (2 / 3)
        print(f"{exponent}: ({b}, {c}),  # shortest^2 {squared}, densest packing {bound:.0f}", flush=True)


if __name__ == "__main__":
    main()

"""Compiled code is kept on disk, until something changes that it was compiled from."""

import subprocess
import sys
from pathlib import Path

import numba
import pytest
from lambent_compute.compiling import compiled, digest_of

CALLER = """
import helpers
from lambent_compute.compiling import compiled, inlined

@inlined()
def twice(x):
    return 2.0 * x

@compiled()
def answer(x):
    return twice(helpers.shifted(x)) + helpers.EXTRA

if __name__ == "__main__":
    print(answer(1.0), sum(answer.stats.cache_hits.values()))
"""
HELPERS = """
import numpy as np
from lambent_compute.compiling import inlined

EXTRA = 100.0
FACTOR = 1
OTHER = 2
SHIFT = 1
TABLE = np.array([10.0])

@inlined()
def shifted(x):
    return FACTOR * (x + 1.0 + TABLE[0]) + OTHER * SHIFT - 2
"""


def run(folder: Path, *arguments: str) -> tuple[float, int]:
    """Return the answer of a process of its own, and how many compiled functions it found on disk."""
    command = [sys.executable, "caller.py", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_a_change_of_another_file_is_not_overlooked(tmp_path: Path):
    """numba alone would go by the file of the function that is kept."""
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "helpers.py").write_text(HELPERS)
    assert run(tmp_path) == (124.0, 0)
    assert run(tmp_path) == (124.0, 1)
    for old, new, wanted in (
        ("x + 1.0", "x + 2.0", 126.0),
        ("EXTRA = 100.0", "EXTRA = 200.0", 226.0),
        ("[10.0]", "[20.0]", 246.0),
        # A number that another one, which is used before it, has already.
        ("SHIFT = 1", "SHIFT = 2", 250.0),
    ):
        text = (tmp_path / "helpers.py").read_text()
        assert old in text
        (tmp_path / "helpers.py").write_text(text.replace(old, new))
        assert run(tmp_path) == (wanted, 0)
        assert run(tmp_path) == (wanted, 1)


VARIANTS = """
import sys
import numpy as np
from lambent_compute.compiling import compiled

def variant(count):
    def total(values):
        found = 0.0
        for i in range(count):
            found += values[i]
        return found
    return compiled()(total)

if __name__ == "__main__":
    total = variant(int(sys.argv[1]))
    print(total(np.ones(4, sys.argv[2])), sum(total.stats.cache_hits.values()))
"""


def test_variants_of_a_closure_and_signatures_never_share_a_file(tmp_path: Path):
    """Each is written as if no index were there yet, which is what two processes at once find."""
    (tmp_path / "caller.py").write_text(VARIANTS)
    wanted = [(count, kind) for count in (1, 2) for kind in ("float32", "float64")]
    for count, kind in wanted:
        assert run(tmp_path, str(count), kind) == (float(count), 0)
    folder = tmp_path / "__pycache__"
    assert len(list(folder.glob("*.nbi"))) == 2
    assert len(list(folder.glob("*.nbc"))) == 4
    for count, kind in wanted:
        assert run(tmp_path, str(count), kind) == (float(count), 1)
    for index in folder.glob("*.nbi"):
        index.unlink()
    for count, kind in reversed(wanted):
        assert run(tmp_path, str(count), kind) == (float(count), 0)
    assert len(list(folder.glob("*.nbc"))) == 4


def test_code_compiles_where_nothing_can_be_kept():
    """A function without a file has no place for a cache, as in a read-only installation."""
    names: dict = {}
    exec(compile("def add(a, b):\n    return a + b\n", "/nowhere/kernel.py", "exec"), names)
    with pytest.raises(RuntimeError, match="no locator"):
        numba.njit(cache=True)(names["add"])
    assert compiled()(names["add"])(1, 2) == 3


def test_a_number_that_is_none_passes_through():
    """`fastmath` must not let a compiler assume that there are none."""

    @compiled()
    def clamped(x):
        return x if x > 0.0 else 0.0

    assert clamped(float("nan")) == 0.0


def test_the_digest_is_the_same_in_every_process():
    command = (
        "from lambent_relight.fused.fields import surfaces\n"
        "from flashcache.kernels.surface_query import outgoing\n"
        "from lambent_compute.compiling import digest_of\n"
        "print(digest_of(surfaces), digest_of(outgoing))"
    )
    found = {
        subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=True).stdout
        for _ in range(3)
    }
    assert len(found) == 1
    first, second = found.pop().split()
    assert first != second


def test_functions_with_other_options_have_another_digest():
    def double(x):
        return 2.0 * x

    assert digest_of(compiled()(double)) != digest_of(compiled(fastmath=False)(double))

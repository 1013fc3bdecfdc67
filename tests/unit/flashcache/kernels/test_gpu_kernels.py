"""The GPU's kernels, compiled without a GPU for the processors they are meant for."""

import itertools
import re
from typing import Any

import pytest

pytest.importorskip("triton", reason="needs Triton, which there is for Linux only")
gpu = pytest.importorskip("flashcache.kernels.gpu")
gpu_kernels = gpu.gpu_kernels
compiled_kernels = pytest.importorskip("support.compiled_kernels")
TARGETS = compiled_kernels.TARGETS

pytestmark = pytest.mark.slow

MAX_REGISTERS = {1: 64, 2: 64, 3: 80, 4: 64, 5: 96, 8: 64}
"""Per thread, by the number of features. 64 allow eight programs of 128 threads at once, 96 five."""
KERNELS = {
    "forward": (gpu_kernels.forward, {"JACOBIAN": False}),
    "forward with Jacobian": (gpu_kernels.forward, {"JACOBIAN": True}),
    "position gradient": (gpu_kernels.position_gradient, {}),
    "table gradient": (gpu_kernels.table_gradient, {"JACOBIAN": False}),
    "table gradient with Jacobian": (gpu_kernels.table_gradient, {"JACOBIAN": True}),
}


@pytest.fixture(autouse=True)
def nothing_is_compiled_before(monkeypatch, tmp_path):
    monkeypatch.setenv("TRITON_CACHE_DIR", str(tmp_path / "cache"))


def compiled(name: str, num_features: int, target: int, counts: str = "*i32") -> Any:
    """Return a kernel for grids with this number of features."""
    kernel, constants = KERNELS[name]
    constants = constants | gpu.block_sizes(num_features)
    return compiled_kernels.compiled(
        kernel, constants, target, counts=counts, num_points="i32", num_levels="i32"
    )


@pytest.mark.long
@pytest.mark.parametrize("name", KERNELS)
def test_kernels_fit_into_registers(name):
    for target, num_features in itertools.product(TARGETS, MAX_REGISTERS):
        registers, memory = compiled_kernels.resources(compiled(name, num_features, target))
        assert registers <= MAX_REGISTERS[num_features], (target, num_features)
        assert memory == 0, (target, num_features)


@pytest.mark.long
@pytest.mark.parametrize("name", KERNELS)
def test_kernels_with_64_bit_offsets_fit_into_registers(name):
    for target, num_features in itertools.product(TARGETS, (2, 8)):
        registers, memory = compiled_kernels.resources(compiled(name, num_features, target, "*i64"))
        assert registers <= MAX_REGISTERS[num_features], (target, num_features)
        assert memory == 0, (target, num_features)


@pytest.mark.parametrize(("num_features", "vector"), [(2, "v2"), (4, "v4"), (8, "v4")])
def test_rows_are_read_and_added_to_as_vectors(num_features, vector):
    ptx = compiled("forward", num_features, 90).asm["ptx"]
    assert len(re.findall(rf"ld\.global\.{vector}\.b32", ptx)) == 8
    assert len(re.findall(rf"st\.global\.{vector}\.b32", ptx)) == 1
    ptx = compiled("table gradient", num_features, 90).asm["ptx"]
    assert len(re.findall(rf"atom\.global\.gpu\.relaxed\.add\.{vector}\.f32", ptx)) == 8


@pytest.mark.parametrize("name", ["table gradient", "table gradient with Jacobian"])
@pytest.mark.parametrize("target", TARGETS)
def test_additions_to_the_table_are_relaxed(name, target):
    ptx = compiled(name, 2, target).asm["ptx"]
    atomics = re.findall(r"\batom\.\S+", ptx)
    assert atomics
    assert all(".relaxed." in atomic for atomic in atomics)


@pytest.mark.parametrize("target", TARGETS)
def test_positions_are_computed_without_fused_multiply_add(target):
    """The table's gradient has none of its own, so that any would be one that the compiler made."""
    ptx = compiled("table gradient", 2, target).asm["ptx"]
    assert "fma" not in ptx
    assert len(re.findall(r"mul\.rn\.f32", ptx)) >= 3

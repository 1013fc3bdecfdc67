"""Stretches of rays in a lattice: in Triton's interpreter, compiled, and on a GPU where there is one."""

import pytest
import torch
from support import fused_cases
from support.fused_cases import Answers

gpu_march = pytest.importorskip("flashcache.kernels.gpu_march", reason="needs Triton")
compiled_kernels = pytest.importorskip("support.compiled_kernels")

pytestmark = pytest.mark.slow

MAX_REGISTERS = 80


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, Answers]:
    """Return what the kernel answers in the interpreter; five seconds."""
    return compiled_kernels.interpreted(tmp_path_factory.mktemp("march"), "interpreted_fused.py", "march")


def test_stretches_are_those_of_the_compiled_loop(found):
    wanted = fused_cases.stretches(torch.device("cpu"))
    assert (wanted["near"] < wanted["far"]).float().mean() > 0.3
    assert (wanted["near"] == wanted["far"]).any()
    for end, value in wanted.items():
        assert torch.equal(found["ball"][end], value), end


def test_no_rays_have_no_stretches(found):
    assert found["nothing"]["near"].shape == (0,)


@pytest.mark.parametrize("target", compiled_kernels.TARGETS)
def test_the_kernel_fits_into_registers(target):
    types = {"cells": "*u8", "step": "fp32", "num_cells": "i32", "num_rays": "i32"}
    code = compiled_kernels.compiled(gpu_march.write_stretches, gpu_march.SIZES, target, **types)
    registers, memory = compiled_kernels.resources(code)
    assert registers <= MAX_REGISTERS
    assert memory == 0


@pytest.mark.gpu
def test_on_a_gpu_stretches_are_those_of_a_processor():
    found = fused_cases.stretches(torch.device("cuda"))
    for end, value in fused_cases.stretches(torch.device("cpu")).items():
        # A point on a cell's border may be rounded to either side.
        different = (found[end].cpu() - value).abs() > 1e-5
        assert different.float().mean() <= 0.01, end

"""The fused directional encoding: in Triton's interpreter, compiled, and on a GPU where there is one."""

import itertools

import pytest
import torch
from flashcache.encoding.directional import IntegratedDirectionalEncoding
from flashcache.kernels import dispatch
from support import fused_cases
from support.fused_cases import Answers

gpu_directional = pytest.importorskip("flashcache.kernels.gpu_directional", reason="needs Triton")
compiled_kernels = pytest.importorskip("support.compiled_kernels")

pytestmark = pytest.mark.slow

MAX_REGISTERS = {"forward": 48, "backward": 96}
"""Per thread; 96 allow five programs of 128 threads at once."""


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, Answers]:
    """Return what the kernels answer in the interpreter; five seconds."""
    folder = tmp_path_factory.mktemp("directional")
    return compiled_kernels.interpreted(folder, "interpreted_fused.py", "directional")


def test_values_and_gradients_are_those_of_plain_torch(found):
    fused_cases.assert_as_exact("directional", found, torch.device("cpu"))


def test_no_directions_are_encoded_as_none(found):
    assert found["nothing"]["encoded"].shape == (0, IntegratedDirectionalEncoding(3).out_features)


@pytest.mark.parametrize("name", MAX_REGISTERS)
def test_kernels_fit_into_registers(name):
    for degrees, target in itertools.product((1, 4, 5), compiled_kernels.TARGETS):
        made = IntegratedDirectionalEncoding(degrees)
        terms = gpu_directional.Terms(made.polynomials, made.slopes, made.rates, made.term_orders)
        kernel, sizes = getattr(gpu_directional, name), gpu_directional.block_sizes(terms)
        code = compiled_kernels.compiled(kernel, sizes, target, term_orders="*i32", num_directions="i32")
        registers, memory = compiled_kernels.resources(code)
        assert registers <= MAX_REGISTERS[name], (degrees, target)
        assert memory == 0, (degrees, target)


@pytest.mark.gpu
def test_on_a_gpu_values_and_gradients_are_those_of_plain_torch():
    device = torch.device("cuda")
    assert dispatch.is_fused(device, torch.float32)
    fused_cases.assert_as_exact("directional", fused_cases.answers("directional", device), device)

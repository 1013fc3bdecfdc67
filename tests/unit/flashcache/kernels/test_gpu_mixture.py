"""The fused mixture along rays: in Triton's interpreter, compiled, and on a GPU where there is one."""

import itertools
import re
from typing import Any

import pytest
import torch
from flashcache.encoding.hash_grid import HashGrid
from flashcache.kernels import dispatch
from support import fused_cases
from support.fused_cases import Answers

gpu_mixture = pytest.importorskip("flashcache.kernels.gpu_mixture", reason="needs Triton")
compiled_kernels = pytest.importorskip("support.compiled_kernels")

pytestmark = pytest.mark.slow

KERNELS = ("forward", "table_gradient", "sample_gradient")
MAX_REGISTERS = {1: 64, 2: 64, 3: 96, 4: 80, 5: 144, 8: 80}
"""Per thread, by the number of features. 80 allow six programs of 128 threads at once."""


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, Answers]:
    """Return what the kernels answer in the interpreter; ten seconds."""
    folder = tmp_path_factory.mktemp("mixture")
    return compiled_kernels.interpreted(folder, "interpreted_fused.py", "mixture")


def close(found: torch.Tensor, wanted: torch.Tensor) -> bool:
    return bool((found - wanted).detach().abs().max() <= 1e-5 * wanted.detach().abs().max())


def compiled(name: str, num_features: int, target: int, counts: str = "*i32") -> Any:
    constants = gpu_mixture.gpu.block_sizes(num_features)
    sizes = dict.fromkeys(("num_samples", "num_rays", "num_levels"), "i32")
    kernel = getattr(gpu_mixture, name)
    return compiled_kernels.compiled(kernel, constants, target, counts=counts, inverse_radius="fp32", **sizes)


def test_values_and_gradients_are_those_of_plain_torch(found):
    fused_cases.assert_as_exact("mixture", found, torch.device("cpu"))


def test_the_fast_cache_answers_and_learns_as_without_fused_kernels(found):
    wanted = fused_cases.fast_cache(torch.device("cpu"))
    assert found["fast cache"].keys() == wanted.keys()
    for what, value in wanted.items():
        assert close(found["fast cache"][what], value), what


def test_gradients_may_be_added_in_place(found):
    assert close(found["in place"]["table"], found["2 features"]["table"] + 1.0)


def test_no_rays_give_an_empty_mixture(found):
    assert found["nothing"]["mixture"].shape == (0, HashGrid(fused_cases.GRIDS["2 features"]).out_features)


@pytest.mark.long
@pytest.mark.parametrize("name", KERNELS)
def test_kernels_fit_into_registers(name):
    for target, num_features in itertools.product(compiled_kernels.TARGETS, MAX_REGISTERS):
        registers, memory = compiled_kernels.resources(compiled(name, num_features, target))
        assert registers <= MAX_REGISTERS[num_features], (target, num_features)
        assert memory == 0, (target, num_features)


@pytest.mark.long
@pytest.mark.parametrize("name", KERNELS)
def test_kernels_with_64_bit_offsets_need_no_memory_of_their_own(name):
    for target in compiled_kernels.TARGETS:
        assert compiled_kernels.resources(compiled(name, 4, target, "*i64"))[1] == 0


def test_rows_are_read_and_added_to_as_vectors():
    ptx = compiled("forward", 4, 90).asm["ptx"]
    assert len(re.findall(r"ld\.global\.v4\.b32", ptx)) >= 8
    ptx = compiled("table_gradient", 4, 90).asm["ptx"]
    assert len(re.findall(r"atom\.global\.gpu\.relaxed\.add\.v4\.f32", ptx)) >= 8


@pytest.mark.gpu
def test_on_a_gpu_values_and_gradients_are_those_of_plain_torch():
    device = torch.device("cuda")
    assert dispatch.is_fused(device, torch.float32)
    fused_cases.assert_as_exact("mixture", fused_cases.answers("mixture", device), device)


@pytest.mark.gpu
def test_on_a_gpu_the_fast_cache_answers_and_learns_as_without_fused_kernels():
    device = torch.device("cuda")
    found = fused_cases.fast_cache(device)
    with dispatch.using("reference"):
        wanted = fused_cases.fast_cache(device)
    for what, value in wanted.items():
        assert close(found[what], value), what

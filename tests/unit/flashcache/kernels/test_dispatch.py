"""The choice of the backend, and the part of each in differentiation."""

import importlib
import os
import subprocess
import sys

import pytest
import torch
from flashcache.kernels import cpu, dispatch, reference
from flashcache.kernels.layout import build_layout

LAYOUT = build_layout((5, 30), num_features=2, log2_table_size=12, half_extent=1.0)


@pytest.fixture
def calls(monkeypatch):
    """Return the names of the compiled functions that are called during the test."""
    names = []
    for name in ("encode", "encode_with_jacobian", "position_gradient", "add_table_gradient"):
        original = getattr(cpu, name)

        def record(*args, name=name, original=original, **kwargs):
            names.append(name)
            return original(*args, **kwargs)

        monkeypatch.setattr(cpu, name, record)
    return names


def inputs(dtype: torch.dtype = torch.float32) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(2)
    z = torch.rand(64, 3, generator=generator, dtype=dtype) * 2.2 - 1.1
    return z, torch.randn(LAYOUT.num_rows, 2, generator=generator, dtype=dtype)


def test_single_precision_is_compiled_and_double_precision_is_not(calls):
    dispatch.encode(*inputs(), LAYOUT)
    dispatch.encode(*inputs(torch.float64), LAYOUT)
    assert calls == ["encode"]


def test_positions_are_looked_up_in_the_precision_of_the_table(calls):
    z, table = inputs()
    assert torch.equal(dispatch.encode(z.double(), table, LAYOUT), dispatch.encode(z, table, LAYOUT))
    assert calls == ["encode", "encode"]


def test_nothing_is_recorded_without_gradients():
    z, table = inputs()
    table.requires_grad_()
    with torch.no_grad():
        assert dispatch.encode(z, table, LAYOUT).grad_fn is None
        assert dispatch.encode_with_jacobian(z, table, LAYOUT)[1].grad_fn is None
    assert dispatch.encode(z, table, LAYOUT).grad_fn is not None


@pytest.mark.parametrize("wanted", ["z", "table", "both"])
def test_gradients_equal_the_reference(wanted, calls):
    gradients = []
    for encode in (dispatch.encode, reference.encode):
        z, table = inputs()
        z.requires_grad_(wanted != "table")
        table.requires_grad_(wanted != "z")
        encode(z, table, LAYOUT).square().sum().backward()
        gradients.append([t.grad for t in (z, table) if t.requires_grad])
    for found, expected in zip(*gradients, strict=True):
        assert torch.allclose(found, expected, rtol=1e-5, atol=1e-5)
    assert ("position_gradient" in calls) == (wanted != "table")
    assert ("add_table_gradient" in calls) == (wanted != "z")


def test_an_unused_output_of_the_pair_counts_as_zero():
    z, table = inputs()
    table.requires_grad_()
    features, jacobian = dispatch.encode_with_jacobian(z, table, LAYOUT)
    (by_features,) = torch.autograd.grad(features.square().sum(), table, retain_graph=True)
    (by_both,) = torch.autograd.grad(features.square().sum() + 0.0 * jacobian.sum(), table)
    assert torch.allclose(by_features, by_both)
    assert by_features.any()


def test_gradients_in_place_equal_gradients_handed_out():
    gradients = []
    for in_place in (False, True):
        z, table = inputs()
        table.requires_grad_()
        table.grad = buffer = torch.ones_like(table)
        features = dispatch.encode(z, table, LAYOUT, in_place_gradient=in_place)
        more, jacobian = dispatch.encode_with_jacobian(z, table, LAYOUT, in_place_gradient=in_place)
        (features.square().sum() + more.sum() + jacobian.square().sum()).backward()
        assert table.grad is buffer
        gradients.append(table.grad)
    assert torch.allclose(*gradients, rtol=1e-5)


def test_the_first_gradient_in_place_creates_the_buffer():
    z, table = inputs()
    table.requires_grad_()
    dispatch.encode(z, table, LAYOUT, in_place_gradient=True).sum().backward()
    assert torch.allclose(table.grad.sum(), torch.tensor(64.0 * 4), rtol=1e-4)


def test_a_position_with_a_gradient_gets_the_second_derivative_from_the_reference(calls):
    z, table = inputs()
    z.requires_grad_()
    _, jacobian = dispatch.encode_with_jacobian(z, table, LAYOUT)
    (gradient,) = torch.autograd.grad(jacobian.square().sum(), z)
    assert gradient.any()
    assert calls == []


def test_single_precision_on_a_gpu_has_kernels_where_triton_is_installed(monkeypatch):
    pytest.importorskip("triton", reason="needs Triton, which there is for Linux only")
    cuda, single = torch.device("cuda"), torch.float32
    assert dispatch.has_gpu_kernels()
    assert dispatch._backend(cuda, single) is importlib.import_module("flashcache.kernels.gpu")
    assert dispatch._backend(cuda, torch.float64) is None
    assert dispatch._backend(torch.device("mps"), single) is None
    assert dispatch.is_fused(cuda, single)
    assert not dispatch.is_fused(cuda, torch.float64)
    assert not dispatch.is_fused(torch.device("cpu"), single)
    with dispatch.using("reference"):
        assert dispatch._backend(cuda, single) is None
        assert not dispatch.is_fused(cuda, single)
    monkeypatch.setattr(dispatch, "_has_triton", lambda: False)
    assert dispatch._backend(cuda, single) is None
    assert not dispatch.has_gpu_kernels()


@pytest.mark.slow
def test_grids_on_a_processor_never_import_triton():
    """torch does so itself, in the first step of an optimiser."""
    code = (
        "import sys, torch\n"
        "import flashcache.presets, flashcache.training.stage_two, flashcache.evaluation.gbuffer\n"
        "from flashcache.encoding.hash_grid import HashGrid, HashGridConfig\n"
        "grid = HashGrid(HashGridConfig(log2_table_size=12))\n"
        "grid(torch.zeros(1, 3)).sum().backward()\n"
        "assert 'numba' in sys.modules and 'triton' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("choice", ["reference", "fastest"])
@pytest.mark.slow
def test_the_environment_selects_the_reference_and_an_unknown_name_is_refused(choice):
    code = (
        "import sys, torch\n"
        "from flashcache.encoding.hash_grid import HashGrid, HashGridConfig\n"
        "HashGrid(HashGridConfig(log2_table_size=12))(torch.zeros(1, 3))\n"
        "assert 'numba' not in sys.modules\n"
    )
    environment = os.environ | {"LAMBENT_KERNELS": choice}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert (done.returncode == 0) == (choice == "reference"), done.stderr
    assert ("ConfigError" in done.stderr) == (choice == "fastest")

"""The GPU's encoder against the reference: in Triton's interpreter, and on a GPU where there is one."""

import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.kernels import dispatch, reference
from flashcache.kernels.layout import GridLayout, build_layout, dense_layout, level_resolutions
from support.grid_cases import INTERPRETED, case, close

pytest.importorskip("triton", reason="needs Triton, which there is for Linux only")
gpu = pytest.importorskip("flashcache.kernels.gpu")
compiled_kernels = pytest.importorskip("support.compiled_kernels")
Answers = dict[str, torch.Tensor]


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, Answers]:
    """Return what the kernels answer in the interpreter, case by case; ten seconds."""
    return compiled_kernels.interpreted(tmp_path_factory.mktemp("grid"), "interpreted_grid.py")


def expected(layout: GridLayout, points: int) -> Answers:
    """Return what the reference answers for the points of `case`."""
    z, table, by_features, by_jacobian = (torch.from_numpy(array) for array in case(layout, points))
    z.requires_grad_()
    table.requires_grad_()
    features = reference.encode(z, table, layout)
    position, of_features = torch.autograd.grad(features, (z, table), by_features)
    outputs = reference.encode_with_jacobian(z.detach(), table, layout)
    (of_both,) = torch.autograd.grad(outputs, table, [by_features, by_jacobian])
    return {
        "features": features,
        "jacobian": outputs[1],
        "features alone": features,
        "table": of_features + 1.0,
        "table of both": of_both + 1.0,
        "position": position,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", INTERPRETED)
def test_values_and_gradients_equal_the_reference(name, found):
    wanted = expected(INTERPRETED[name], 300)
    assert found[name].keys() == wanted.keys()
    for what, value in wanted.items():
        assert close(found[name][what].numpy(), value), what


@pytest.mark.slow
def test_offsets_of_64_bits_give_the_same_values_and_gradients(found):
    for what, value in found["mixed, 2 features"].items():
        assert torch.equal(found["64 bits"][what], value), what


@pytest.mark.slow
def test_a_point_that_is_not_a_number_reads_inside_the_table(found):
    answers = found["nan"]
    assert torch.equal(answers["nan: features"], answers["corner: features"])
    assert torch.equal(answers["nan: table"], answers["corner: table"])
    assert not answers["nan: position"].any()


@pytest.mark.slow
def test_no_points_give_no_features_and_no_gradient(found):
    layout = INTERPRETED["mixed, 2 features"]
    answers = found["no points"]
    assert answers["features"].shape == (0, layout.num_outputs)
    assert answers["jacobian"].shape == (0, layout.num_outputs, 3)
    assert answers["position"].shape == (0, 3)
    assert not answers["table"].any()


@pytest.mark.slow
@pytest.mark.parametrize("way", ["handed out", "in place"])
def test_gradients_recorded_on_the_backend_equal_the_reference(way, found):
    layout = INTERPRETED["mixed, 2 features"]
    wanted = expected(layout, 40)
    assert close(found[way]["table"].numpy(), wanted["table"] + wanted["table of both"] - 1.0)
    assert close(found[way]["position"].numpy(), wanted["position"])


def test_where_triton_cannot_start_kernels_the_user_is_told_what_to_do(monkeypatch):
    class NoCompiler:
        @property
        def active(self):
            raise RuntimeError("Failed to find C compiler.")

    monkeypatch.setattr(gpu.gpu_kernels, "driver", NoCompiler())
    gpu.gpu_kernels.require_launcher.cache_clear()
    with pytest.raises(ConfigError, match=r"C compiler.*LAMBENT_KERNELS=reference"):
        gpu.gpu_kernels.require_launcher()


CUDA = torch.device("cuda")
REALISTIC = {
    "proposal": build_layout(
        level_resolutions(16, 128, 6), num_features=1, log2_table_size=15, half_extent=1.0
    ),
    "density": build_layout(
        level_resolutions(16, 256, 8), num_features=2, log2_table_size=17, half_extent=1.0
    ),
    "finest": build_layout(
        level_resolutions(16, 2048, 8), num_features=4, log2_table_size=19, half_extent=1.0
    ),
}


def realistic(layout: GridLayout, points: int, device: torch.device) -> tuple[torch.Tensor, ...]:
    """Return points, some outside, a table, and upstream gradients of features and Jacobian."""
    torch.manual_seed(3)
    z = torch.rand(points, 3, device=device) * 2.2 - 1.1
    table = torch.randn(layout.num_rows, layout.num_features, device=device)
    by_features = torch.randn(points, layout.num_outputs, device=device)
    return z, table, by_features, torch.randn(points, layout.num_outputs, 3, device=device)


def error(found: torch.Tensor, wanted: torch.Tensor) -> float:
    """Return the largest difference as a share of the largest value."""
    return float((found - wanted).detach().abs().max() / wanted.detach().abs().max())


def skip_without_memory(gibibytes: int) -> None:
    if torch.cuda.mem_get_info()[0] < gibibytes * 2**30:
        pytest.skip(f"needs {gibibytes} GiB of the GPU's memory")


@pytest.mark.gpu
@pytest.mark.slow
@pytest.mark.parametrize("name", REALISTIC)
def test_on_a_gpu_values_and_gradients_equal_the_reference(name):
    layout = REALISTIC[name]
    z, table, by_features, by_jacobian = realistic(layout, 2**17 + 1, CUDA)
    gradients = []
    for backend in (dispatch, reference):
        points, values = z.clone().requires_grad_(), table.clone().requires_grad_()
        features = backend.encode(points, values, layout)
        features.backward(by_features)
        of_features, values.grad = values.grad, None
        outputs = backend.encode_with_jacobian(z, values, layout)
        torch.autograd.backward(outputs, [by_features, by_jacobian])
        gradients.append((features, *outputs, points.grad, of_features, values.grad))
    assert gradients[0][0].grad_fn.name().startswith("_Encode")
    # Sums over many points are rounded in another order.
    for found, wanted in zip(*gradients, strict=True):
        assert error(found, wanted) < 1e-5


@pytest.mark.gpu
@pytest.mark.parametrize("in_place", [False, True])
def test_on_a_gpu_gradients_are_added_to_what_is_there(in_place):
    layout = REALISTIC["density"]
    z, table, by_features, _ = realistic(layout, 5000, CUDA)
    table.requires_grad_()
    table.grad = buffer = torch.ones_like(table)
    dispatch.encode(z, table, layout, in_place_gradient=in_place).backward(by_features)
    assert table.grad is buffer
    (wanted,) = torch.autograd.grad(reference.encode(z, table, layout), table, by_features)
    assert error(buffer, wanted + 1.0) < 1e-5


@pytest.mark.gpu
def test_on_a_gpu_there_may_be_no_points_and_points_that_are_not_numbers():
    layout = REALISTIC["density"]
    _, table, _, _ = realistic(layout, 1, CUDA)
    features, jacobian = dispatch.encode_with_jacobian(torch.empty(0, 3, device=CUDA), table, layout)
    assert features.shape == (0, layout.num_outputs)
    assert jacobian.shape == (0, layout.num_outputs, 3)
    nan, corner = torch.full((2, 3), torch.nan, device=CUDA), torch.full((2, 3), -1.0, device=CUDA)
    assert torch.equal(dispatch.encode(nan, table, layout), dispatch.encode(corner, table, layout))


@pytest.mark.gpu
@pytest.mark.slow
def test_on_a_gpu_there_may_be_more_values_than_32_bits_count():
    skip_without_memory(16)
    layout = REALISTIC["density"]
    points = 2**31 // (3 * layout.num_outputs) + 1000
    assert 3 * points * layout.num_outputs > 2**31
    _, table, by_features, by_jacobian = realistic(layout, 1000, CUDA)
    z = torch.rand(points, 3, device=CUDA) * 2.2 - 1.1
    features, jacobian = gpu.encode_with_jacobian(z, table, layout)
    last = gpu.encode_with_jacobian(z[-1000:], table, layout)
    assert torch.equal(features[-1000:], last[0])
    assert torch.equal(jacobian[-1000:], last[1])
    features.zero_()[-1000:] = by_features
    jacobian.zero_()[-1000:] = by_jacobian
    found, wanted = torch.zeros_like(table), torch.zeros_like(table)
    gpu.add_table_gradient(z, layout, features, jacobian, found)
    gpu.add_table_gradient(z[-1000:], layout, by_features, by_jacobian, wanted)
    assert error(found, wanted) < 1e-5


@pytest.mark.gpu
@pytest.mark.slow
def test_on_a_gpu_a_table_may_have_more_rows_than_32_bits_count():
    skip_without_memory(12)
    layout = dense_layout(1300)
    table = torch.rand(layout.num_rows, 1, device=CUDA)
    assert table.numel() > 2**31
    z = torch.rand(1000, 3, device=CUDA) * 2.2 - 1.1
    z[0] = 1.0
    assert error(gpu.encode(z, table, layout), reference.encode(z, table, layout)) < 1e-5

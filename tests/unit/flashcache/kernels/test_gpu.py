"""The GPU's encoder in Triton's interpreter, against the reference; on a GPU: `test_cuda.py`."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.kernels import reference
from flashcache.kernels.layout import GridLayout
from support import grid_cases
from support.grid_cases import INTERPRETED, case, close

pytest.importorskip("triton", reason="needs Triton, which there is for Linux only")
SCRIPT = Path(grid_cases.__file__).with_name("interpreted_grid.py")
Answers = dict[str, torch.Tensor]


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, Answers]:
    """Return what the kernels answer in the interpreter, case by case; ten seconds."""
    path = tmp_path_factory.mktemp("interpreted") / "answers.pt"
    command = [sys.executable, str(SCRIPT), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return torch.load(path)


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
    from flashcache.kernels import gpu_kernels

    class NoCompiler:
        @property
        def active(self):
            raise RuntimeError("Failed to find C compiler.")

    monkeypatch.setattr(gpu_kernels, "driver", NoCompiler())
    gpu_kernels.require_launcher.cache_clear()
    with pytest.raises(ConfigError, match=r"C compiler.*LAMBENT_KERNELS=reference"):
        gpu_kernels.require_launcher()

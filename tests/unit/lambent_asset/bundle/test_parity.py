"""The comparison of a graph with the function it was made from."""

from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from flashcache.export.stored_grids import exported_grids
from lambent_asset.bundle.parity import compare, fits_half, rounding_of, with_half_tables
from lambent_core.errors import WorkerError
from onnx import TensorProto, helper, numpy_helper
from support.sphere_model import sphere_model

MODEL = torch.nn.Linear(1, 1)


def saved(folder: Path, name: str, constants: dict[str, float], nodes: list, outputs: str = "y") -> Path:
    """Write a graph of one input `x`, and return its file."""
    made = [numpy_helper.from_array(np.float32(value), each) for each, value in constants.items()]
    ends = [
        helper.make_tensor_value_info(each, TensorProto.FLOAT, ["row", 1]) for each in ("x", *outputs.split())
    ]
    graph = helper.make_graph(nodes, name, ends[:1], ends[1:], made)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.save(model, folder / f"{name}.onnx")
    return folder / f"{name}.onnx"


def step_graph(folder: Path, threshold: float) -> Path:
    """Write the graph x -> 1 where x < threshold, else 0."""
    nodes = [
        helper.make_node("Less", ["x", "threshold"], ["below"]),
        helper.make_node("Where", ["below", "one", "zero"], ["y"]),
    ]
    return saved(folder, "step", {"threshold": threshold, "one": 1.0, "zero": 0.0}, nodes)


def step_at_half(model: torch.nn.Module, inputs) -> dict[str, torch.Tensor]:
    return {"y": (inputs["x"] < 0.5).to(inputs["x"].dtype)}


def inputs(*values: float, count: int = 1000) -> dict[str, torch.Tensor]:
    """Return `values` followed by numbers away from one half."""
    rest = torch.linspace(-0.4, 0.4, count - len(values))
    return {"x": torch.cat([torch.tensor(values), rest])[:, None]}


def test_an_equal_graph_has_no_error(tmp_path):
    result = compare("step", step_graph(tmp_path, 0.5), step_at_half, MODEL, inputs())
    assert (result.max_abs_error, result.num_samples, result.num_left_out) == (0.0, 1000, 0)


def test_a_different_graph_is_refused_with_its_error_and_what_to_do(tmp_path):
    with pytest.raises(WorkerError, match=r"1\.00e\+00.*Report this") as raised:
        compare("step", step_graph(tmp_path, 0.6), step_at_half, MODEL, inputs(0.55))
    assert raised.value.code == "export.parity"


def test_an_input_on_the_edge_of_a_step_does_not_count(tmp_path):
    graph = step_graph(tmp_path, 0.5 + 3e-7)
    result = compare("step", graph, step_at_half, MODEL, inputs(0.5 + 1.2e-7))
    assert (result.max_abs_error, result.num_samples, result.num_left_out) == (0.0, 999, 1)


def test_only_few_inputs_may_be_left_out(tmp_path):
    graph = step_graph(tmp_path, 0.5 + 3e-7)
    with pytest.raises(WorkerError, match="11 of 1000"):
        compare("step", graph, step_at_half, MODEL, inputs(*[0.5 + 1.2e-7] * 11))


def test_a_value_that_is_not_a_number_is_refused(tmp_path):
    def broken(model: torch.nn.Module, inputs) -> dict[str, torch.Tensor]:
        return {"y": torch.where(inputs["x"] == inputs["x"][0], torch.nan, step_at_half(model, inputs)["y"])}

    with pytest.raises(WorkerError):
        compare("step", step_graph(tmp_path, 0.5), broken, MODEL, inputs())


def test_the_model_is_asked_with_full_precision_products(tmp_path):
    seen = []

    def watching(model: torch.nn.Module, inputs) -> dict[str, torch.Tensor]:
        seen.append(torch.get_float32_matmul_precision())
        return step_at_half(model, inputs)

    torch.set_float32_matmul_precision("medium")
    try:
        compare("step", step_graph(tmp_path, 0.5), watching, MODEL, inputs())
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision("highest")
    assert set(seen) == {"highest"}


def shifted_graph(folder: Path, shift: float) -> Path:
    """Write the graph x -> x / 4 + 16 max(x - 0.5, 0) + shift where x > 0.5."""
    constants = {"half": 0.5, "steep": 16.0, "flat": 0.25, "shift": shift, "zero": 0.0}
    nodes = [
        helper.make_node("Sub", ["x", "half"], ["above"]),
        helper.make_node("Relu", ["above"], ["ramp"]),
        helper.make_node("Mul", ["ramp", "steep"], ["rise"]),
        helper.make_node("Mul", ["x", "flat"], ["base"]),
        helper.make_node("Add", ["base", "rise"], ["sum"]),
        helper.make_node("Less", ["half", "x"], ["beyond"]),
        helper.make_node("Where", ["beyond", "shift", "zero"], ["more"]),
        helper.make_node("Add", ["sum", "more"], ["y"]),
    ]
    return saved(folder, "ramp", constants, nodes)


def ramp(model: torch.nn.Module, inputs) -> dict[str, torch.Tensor]:
    return {"y": 0.25 * inputs["x"] + 16.0 * (inputs["x"] - 0.5).relu()}


def test_what_rounding_of_the_input_moves_is_allowed_on_top(tmp_path):
    # A nudge of 5e-7 moves the ramp by 8e-6.
    result = compare("ramp", shifted_graph(tmp_path, 1.5e-5), ramp, MODEL, inputs(0.51))
    assert result.num_left_out == 1
    with pytest.raises(WorkerError, match=r"export\.parity.*1 of 1000"):
        compare("ramp", shifted_graph(tmp_path, 3e-5), ramp, MODEL, inputs(0.51))


def jumping_graph(folder: Path, threshold: float) -> Path:
    """Write the graph x -> x, and 2 where x < threshold, else 0."""
    nodes = [
        helper.make_node("Identity", ["x"], ["opacity"]),
        helper.make_node("Less", ["x", "threshold"], ["below"]),
        helper.make_node("Where", ["below", "two", "zero"], ["distance"]),
    ]
    constants = {"threshold": threshold, "two": 2.0, "zero": 0.0}
    return saved(folder, "jump", constants, nodes, "opacity distance")


def test_an_output_on_the_edge_at_which_another_jumps_does_not_count(tmp_path, monkeypatch):
    """A nudge of the input does not reach the edge, as behind a flat network."""
    monkeypatch.setattr("lambent_asset.bundle.parity.NUDGE", 0.0)

    def jump(model: torch.nn.Module, inputs) -> dict[str, torch.Tensor]:
        x = inputs["x"]
        return {"opacity": x, "distance": 2.0 * (x < 1e-3).to(x.dtype)}

    graph, edge = jumping_graph(tmp_path, 1.000004e-3), ("opacity", 1e-3)
    result = compare("jump", graph, jump, MODEL, inputs(1.000002e-3), edge=edge)
    assert (result.max_abs_error, result.num_left_out) == (0.0, 1)
    with pytest.raises(WorkerError, match=r"1 of 1000"):
        compare("jump", graph, jump, MODEL, inputs(1.000002e-3))
    with pytest.raises(WorkerError, match=r"1 of 1000"):
        compare("jump", jumping_graph(tmp_path, 1.2e-3), jump, MODEL, inputs(1.1e-3), edge=edge)


@pytest.mark.parametrize("gloss_grid", [False, True])
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_only_exported_tables_are_rounded_as_readers_see_them_and_the_model_itself_is_not(scale, gloss_grid):
    model = sphere_model(output_scale=scale, gloss_grid=gloss_grid)
    before = {name: value.clone() for name, value in model.named_parameters()}
    rounded = dict(with_half_tables(model).named_parameters())
    tables = {f"{name}.table" for name in exported_grids(model)}
    # It is stored as further levels of the other.
    tables |= {"materials.gloss.grid.table"} if gloss_grid else set()
    for name, value in model.named_parameters():
        assert torch.equal(value, before[name])
        changed = not torch.equal(value, rounded[name])
        assert changed == (name in tables), name
        if changed:
            assert torch.equal(rounded[name], (scale * value).half().float())


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_features_beyond_float16_are_noticed(scale):
    model = sphere_model(output_scale=scale)
    assert fits_half(model)
    with torch.no_grad():
        model.fast.feature_grid.table[-1, -1] = -65_520.0 / scale
    assert not fits_half(model)


def test_errors_count_by_how_much_of_the_ray_is_seen():
    exact = {
        "opacity": np.array([[1.0], [0.0]]),
        "radiance": np.zeros((2, 3)),
        "distance": np.array([[4.0], [4.0]]),
    }
    rounded = {
        "opacity": exact["opacity"] + 0.1,
        "radiance": exact["radiance"] + 0.2,
        "distance": exact["distance"] + np.array([[1.0], [100.0]]),
    }
    found = {item.output: item for item in rounding_of(rounded, exact)}
    assert np.isclose(found["opacity"].rms_error, 0.1)
    assert np.isclose(found["radiance"].max_abs_error, 0.2)
    # Relative above 1; the second ray sees nothing, so its distance says nothing.
    assert np.isclose(found["distance"].max_abs_error, 0.25)
    assert np.isclose(found["distance"].rms_error, 0.25 / np.sqrt(2.0))
    assert found["distance"].num_samples == 2


def test_properties_of_points_count_in_full_without_an_opacity():
    (found,) = rounding_of({"albedo": np.full((1, 3), 0.6)}, {"albedo": np.full((1, 3), 0.5)})
    assert np.isclose(found.rms_error, 0.1)

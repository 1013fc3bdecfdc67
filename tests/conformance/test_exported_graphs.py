"""The exported graphs, run by onnxruntime, against the torch functions they were made from."""

import itertools
import json

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from flashcache.export import graphs, reference
from flashcache.export.onnx import WeightFile
from flashcache.export.reference import GbufferRule
from flashcache.export.signatures import SIGNATURES
from flashcache.kernels import dispatch
from lambent_asset.bundle.parity import with_half_tables
from onnx import TensorProto
from support.sphere_model import sphere_model

NUM_ROWS = 1024
RULE = GbufferRule(box_min=(-0.9, -0.8, -0.7), box_max=(0.9, 0.8, 0.75), num_samples=32)
FORMS = {
    "own normal grid, softplus, skip": {"own_normal_grid": True, "softplus_beta": 10.0, "distance_layers": 4},
    "linear normals, relu, no skip, scaled tables": {
        "own_normal_grid": False,
        "softplus_beta": None,
        "distance_layers": 2,
        "output_scale": 10.0,
    },
    "occupancy": {"cells": 12},
    "gloss grid, scaled tables": {"gloss_grid": True, "output_scale": 10.0},
}
# What onnxruntime's browser interface to graphics hardware runs without going back to the processor.
OPERATORS = {
    *("Abs", "Add", "Cast", "Clip", "Concat", "Div", "Exp", "Floor", "Gather", "Gemm", "Identity"),
    *("Less", "Log", "MatMul", "Mul", "Neg", "Pow", "ReduceMax", "ReduceMin", "ReduceSum", "Relu", "Reshape"),
    *("Sigmoid", "Softmax", "Sqrt", "Sub", "Tanh", "Unsqueeze", "Where"),
}
# Where ONNX itself wants 64-bit integers: input index of axes or shape.
AXES_INPUT = {"ReduceMax": 1, "ReduceMin": 1, "ReduceSum": 1, "Reshape": 1, "Unsqueeze": 1}


@pytest.fixture(scope="module", params=[*FORMS, "float16 tables"])
def model(request):
    """Return a model; with float16 tables the one whose tables float16 holds exactly."""
    if request.param in FORMS:
        return sphere_model(**FORMS[request.param])
    return with_half_tables(sphere_model())


def is_half(model) -> bool:
    """Return whether float16 holds the tables without loss, as no random float32 table would."""
    table = model.materials.grid.table
    return bool((table == table.half().float()).all())


@pytest.fixture(scope="module")
def exported(model, tmp_path_factory):
    """Return the graphs of a model by name, and the folder they lie in."""
    weights = WeightFile(half_tables=is_half(model))
    made = {
        "gbuffer": graphs.gbuffer_graph(model, RULE, weights, {"made for": "tests"}),
        "material": graphs.material_graph(model, weights, {}),
        "fast_cache_0": graphs.fast_cache_graph(model, 0, weights, {}),
        "fast_cache_1": graphs.fast_cache_graph(model, 1, weights, {}),
    }
    folder = tmp_path_factory.mktemp("models")
    (folder / "weights.bin").write_bytes(weights.to_bytes())
    for name, graph in made.items():
        (folder / f"{name}.onnx").write_bytes(graph.SerializeToString())
    return folder, made, weights


def unit(vectors: torch.Tensor) -> torch.Tensor:
    return torch.nn.functional.normalize(vectors, dim=-1)


def inputs_of(name: str) -> dict[str, torch.Tensor]:
    """Return random inputs: camera rays from around the ball; points in and around its box; directions."""
    generator = torch.Generator().manual_seed(3)
    points = torch.rand(NUM_ROWS, 3, generator=generator) * 2.4 - 1.2
    directions = unit(torch.randn(NUM_ROWS, 3, generator=generator))
    if name == "material":
        return {"position": points}
    if name == "gbuffer":
        origins = 3.0 * directions
        return {"origin": origins, "direction": unit(0.7 * points - origins)}
    return {"origin": points, "direction": directions}


def expected(model, name: str, inputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    with torch.no_grad(), dispatch.using("encoder"):
        if name == "gbuffer":
            return reference.gbuffer(model, RULE, **inputs)
        if name == "material":
            return reference.material(model, **inputs)
        return reference.fast_cache(model, int(name[-1]), **inputs)


def run(folder, name: str, inputs: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(folder / f"{name}.onnx", providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    results = session.run(names, {key: value.numpy() for key, value in inputs.items()})
    return dict(zip(names, results, strict=True))


@pytest.mark.parametrize("name", ["gbuffer", "material", "fast_cache_0", "fast_cache_1"])
def test_graphs_equal_their_torch_twins(model, exported, name):
    inputs = inputs_of(name)
    found, wanted = run(exported[0], name, inputs), expected(model, name, inputs)
    assert set(found) == set(wanted)
    for output, values in wanted.items():
        error = np.abs(found[output] - values.numpy()) / values.abs().clamp_min(1.0).numpy()
        assert found[output].shape == values.shape
        assert error.max() <= 1e-5, f"{output}: {error.max():.1e}"
        assert values.std() > 1e-3, f"{output} does not vary, so nothing was compared"


@pytest.mark.parametrize("name", ["gbuffer", "fast_cache_0"])
def test_rows_are_answered_one_by_one(exported, name):
    inputs = inputs_of(name)
    alone = run(exported[0], name, {key: value[:1] for key, value in inputs.items()})
    together = run(exported[0], name, {key: value[:7] for key, value in inputs.items()})
    for output, values in alone.items():
        assert np.allclose(values, together[output][:1], atol=1e-6)


def test_graphs_pass_the_checker_with_inferred_shapes(exported):
    folder, made, _ = exported
    for name in made:
        onnx.checker.check_model(str(folder / f"{name}.onnx"), full_check=True)


def test_every_node_has_a_name_of_its_own_and_every_input_and_output_is_described(exported):
    for name, graph in exported[1].items():
        names = [node.name for node in graph.graph.node]
        assert all(names)
        assert len(set(names)) == len(names)
        signature = SIGNATURES[name.rstrip("_01")]
        assert graph.doc_string == graph.graph.doc_string == signature.summary
        assert {item.name: item.doc_string for item in graph.graph.input} == signature.inputs
        assert {item.name: item.doc_string for item in graph.graph.output} == signature.outputs
    parts = {node.name.rpartition("/")[0] for node in exported[1]["fast_cache_0"].graph.node}
    assert {"fast.distance_grid", "fast.offset_head", "fast.feature_grid", "sample_distances"} <= parts


def test_graphs_state_their_version_and_names(exported):
    _, made, _ = exported
    for name, graph in made.items():
        assert (graph.ir_version, [(item.domain, item.version) for item in graph.opset_import]) == (
            9,
            [("", 18)],
        )
        row_axis = "point" if name == "material" else "ray"
        for item in (*graph.graph.input, *graph.graph.output):
            first, second = item.type.tensor_type.shape.dim
            assert first.dim_param == row_axis
            assert second.dim_value in (1, 3)


def test_graphs_carry_the_constants_of_their_networks(model, exported):
    metadata = {
        name: {item.key: item.value for item in graph.metadata_props} for name, graph in exported[1].items()
    }
    assert metadata["gbuffer"]["made for"] == "tests"
    constants = {name: json.loads(values["lambent.network"]) for name, values in metadata.items()}
    kinds = {name: values["kind"] for name, values in constants.items()}
    version = "v1" if model.nerf.occupancy is None else "v2"
    assert kinds == {
        "gbuffer": f"gbuffer.{version}",
        "material": f"material.{version}",
        "fast_cache_0": "fast_cache.v1",
        "fast_cache_1": "fast_cache.v1",
    }
    assert constants["gbuffer"]["box_max"] == [0.9, 0.8, 0.75]
    assert constants["material"]["softplus_beta"] == model.config.nerf.density.softplus_beta
    assert constants["fast_cache_1"]["far"] == model.fast.far


def test_graphs_use_only_operators_that_every_runtime_has(exported):
    used = {node.op_type for graph in exported[1].values() for node in graph.graph.node}
    assert used <= OPERATORS
    assert {"Gather", "Gemm", "Pow"} <= used


def test_64_bit_integers_are_only_axes_and_shapes_and_rows_are_32_bit(model, exported):
    for graph in exported[1].values():
        inferred = onnx.shape_inference.infer_shapes(graph).graph
        kinds = {
            item.name: item.type.tensor_type.elem_type for item in (*inferred.value_info, *inferred.output)
        }
        kinds |= {tensor.name: tensor.data_type for tensor in inferred.initializer}
        assert TensorProto.DOUBLE not in kinds.values()
        # Halves are looked up and widened at once: no runtime computes with them.
        halves = {name for name, kind in kinds.items() if kind == TensorProto.FLOAT16}
        assert bool(halves) == is_half(model)
        for node in inferred.node:
            if halves.intersection(node.input):
                assert node.op_type == ("Gather" if node.input[0].endswith(".table") else "Cast")
        for node in inferred.node:
            for index, name in enumerate(node.input):
                if kinds.get(name) == TensorProto.INT64:
                    assert AXES_INPUT.get(node.op_type) == index
            if node.op_type == "Gather":
                assert kinds[node.input[1]] == TensorProto.INT32
            assert TensorProto.INT64 not in {kinds.get(name) for name in node.output}


def test_large_tensors_lie_aligned_in_one_file(exported):
    folder, made, weights = exported
    data = (folder / "weights.bin").read_bytes()
    for graph in made.values():
        for tensor in graph.graph.initializer:
            if tensor.data_location != TensorProto.EXTERNAL:
                assert len(tensor.raw_data) <= 8192
                continue
            place = {entry.key: entry.value for entry in tensor.external_data}
            offset, length = int(place["offset"]), int(place["length"])
            assert place["location"] == "weights.bin"
            assert offset % 256 == 0
            dtype = "<f2" if tensor.data_type == TensorProto.FLOAT16 else "<f4"
            stored = np.frombuffer(data[offset : offset + length], dtype).reshape(tuple(tensor.dims))
            assert np.array_equal(stored, weights.tensors[tensor.name].values)
    offsets = sorted((item.offset_bytes, item.values.nbytes) for item in weights.tensors.values())
    assert all(a + size <= b for (a, size), (b, _) in itertools.pairwise(offsets))


def test_lights_share_everything_but_their_colours(exported):
    _, made, _ = exported
    names = [{tensor.name for tensor in made[f"fast_cache_{light}"].graph.initializer} for light in (0, 1)]
    different = {name for name in names[0] ^ names[1] if not name.startswith("constant")}
    assert different == {
        f"fast.decoder_head.{light}.{part}" for light in ("day", "night") for part in ("weight", "bias")
    }


def test_a_bent_weight_shows(model, exported, tmp_path):
    """The comparison of this file would notice a graph that reads one wrong row."""
    folder, _, weights = exported
    data = bytearray((folder / "weights.bin").read_bytes())
    table = weights.tensors["materials.grid.table"]
    values = np.frombuffer(data, table.values.dtype, table.values.size, table.offset_bytes).copy()
    data[table.offset_bytes : table.offset_bytes + values.nbytes] = np.roll(values, 2).tobytes()
    (tmp_path / "weights.bin").write_bytes(data)
    (tmp_path / "material.onnx").write_bytes((folder / "material.onnx").read_bytes())
    inputs = inputs_of("material")
    found, wanted = run(tmp_path, "material", inputs), expected(model, "material", inputs)
    assert np.abs(found["albedo"] - wanted["albedo"].numpy()).max() > 1e-2

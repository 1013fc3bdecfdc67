"""A bundle's graphs in a browser: onnxruntime-web on processor and WebGPU, and the refinement's tracer on it.

WebGPU is computed in software (SwiftShader). Sessions on it may not hand any node back to the processor.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from flashcache.export.onnx import WeightFile
from flashcache.export.relight_graph import relight_graph
from onnx import TensorProto, helper
from support.chromium import program
from support.engine_page import WEB, EnginePage, engine_page
from support.network_bundle import write_network_bundle
from support.preset_models import RULE, preset_model

pytestmark = [pytest.mark.browser, pytest.mark.slow]
TOLERANCE = 1e-5
GRAPHS = ("gbuffer", "material", "fast_cache_sky", "relight")
ROWS = {"gbuffer": 24, "material": 192, "fast_cache_sky": 192, "relight": 192}
"""Few, because graphics emulated on a processor are slow."""


def xor_graph() -> onnx.ModelProto:
    """Return y = x xor 1, which WebGPU's provider leaves to the processor."""
    ends = [helper.make_tensor_value_info(name, TensorProto.INT32, ["row", 3]) for name in "xy"]
    one = helper.make_tensor("one", TensorProto.INT32, [1], [1])
    node = helper.make_node("BitwiseXor", ["x", "one"], ["y"])
    graph = helper.make_graph([node], "xor", ends[:1], ends[1:], [one])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    """Return a bundle of the preset `tiny` with float16 tables, and a graph that must be refused."""
    folder = tmp_path_factory.mktemp("bundle") / "a.relight"
    write_network_bundle(folder, preset_model("tiny"), RULE, half_tables=True)
    relight = relight_graph(49, 16, WeightFile(), {})
    (folder / "models" / "relight.onnx").write_bytes(relight.SerializeToString())
    (folder / "models" / "xor.onnx").write_bytes(xor_graph().SerializeToString())
    return folder


@pytest.fixture(scope="module")
def page(bundle, tmp_path_factory) -> Iterator[EnginePage]:
    if program() is None or not (WEB / "node_modules").is_dir():
        pytest.skip("needs Chromium and `npm ci` in client/web")
    with engine_page(bundle, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def inputs_of(name: str, rows: int) -> dict[str, np.ndarray]:
    """Return random rows: camera rays towards the box, points in and around it, pixels."""
    rng = np.random.default_rng(5)
    if name == "relight":
        widths = {"transfer_direct": 49, "transfer_indirect": 27, "visibility": 16, "sh_reflect": 16}
        found = {key: rng.normal(0.0, 0.3, (rows, width)) for key, width in widths.items()}
        found |= {key: rng.uniform(0.0, 1.0, (rows, 3)) for key in ("albedo_diffuse", "spec_prefiltered")}
        found["light_sh"] = rng.normal(0.0, 1.0, (49, 3))
        return {key: values.astype(np.float32) for key, values in found.items()}
    points = rng.uniform(-1.2, 1.2, (rows, 3)).astype(np.float32)
    ways = rng.normal(size=(rows, 3))
    ways = (ways / np.linalg.norm(ways, axis=1, keepdims=True)).astype(np.float32)
    if name == "material":
        return {"position": points}
    if name == "gbuffer":
        return {"origin": 0.6 * points - 3.0 * ways, "direction": ways}
    return {"origin": points, "direction": ways}


def expected(bundle: Path, name: str, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what onnxruntime answers on a processor."""
    path = bundle / "models" / f"{name}.onnx"
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, inputs), strict=True))


def largest_error(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> float:
    """Return the largest error of all outputs, absolute below 1 and relative above."""
    assert set(found) == set(wanted)
    for name, values in wanted.items():
        assert values.std() > 1e-4, f"{name} does not vary, so nothing is compared"
    return max(
        float((np.abs(found[name] - values) / np.maximum(1.0, np.abs(values))).max())
        for name, values in wanted.items()
    )


@pytest.mark.parametrize("name", GRAPHS)
def test_the_browsers_processor_answers_as_ours(page, bundle, name):
    inputs = inputs_of(name, 8 * ROWS[name])
    page.open(f"{name} wasm", f"models/{name}.onnx", "wasm")
    error = largest_error(page.run(f"{name} wasm", inputs), expected(bundle, name, inputs))
    assert error <= TOLERANCE


@pytest.mark.parametrize("name", GRAPHS)
def test_webgpu_alone_answers_every_graph(page, bundle, name):
    inputs = inputs_of(name, ROWS[name])
    page.open(f"{name} webgpu", f"models/{name}.onnx", "webgpu")
    error = largest_error(page.run(f"{name} webgpu", inputs), expected(bundle, name, inputs))
    assert error <= TOLERANCE


def test_a_graph_that_needs_the_processor_is_refused_on_webgpu(page):
    with pytest.raises(AssertionError, match=r"(?i)fallback|not assigned|execution provider"):
        page.open("xor", "models/xor.onnx", "webgpu")
    page.open("xor on the processor", "models/xor.onnx", "wasm")


def test_trimmed_graphs_answer_what_is_left(page, bundle):
    inputs = inputs_of("fast_cache_sky", 64)
    page.open("trimmed", "models/fast_cache_sky.onnx", "wasm", ["opacity", "distance"])
    wanted = expected(bundle, "fast_cache_sky", inputs)
    wanted.pop("radiance")
    assert largest_error(page.run("trimmed", inputs), wanted) <= TOLERANCE


@pytest.mark.parametrize(
    ("wanted", "taken", "note"),
    [
        ("webgpu", "webgpu", ""),
        ("wasm", "wasm", ""),
        # The browser of the tests has no graphics hardware, and computes WebGPU itself.
        ("cache", "wasm", "this browser computes WebGPU on the processor"),
    ],
)
def test_the_refinements_tracer_answers_as_the_graph(page, bundle, wanted, taken, note):
    inputs = inputs_of("fast_cache_sky", 64)
    wanted_answers = expected(bundle, "fast_cache_sky", inputs)
    wanted_answers.pop("radiance")
    rays = np.concatenate([inputs["origin"], inputs["direction"]], axis=1)
    found, backend, said = page.trace("models/fast_cache_sky.onnx", wanted, rays)
    assert (backend, said) == (taken, note)
    assert largest_error(found, wanted_answers) <= TOLERANCE

"""Compiled code, the bundle's graphs and the torch model give the same answers."""

from dataclasses import fields

import numpy as np
import pytest
from google.protobuf import json_format
from lambent_core.errors import BundleError, SettingError
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.bundle.graphs import OnnxCaches
from lambent_relight.fused import kernels
from lambent_relight.fused.reader import FusedCaches
from lambent_relight.fused.weights import NotFused
from lambent_relight.renderer import Renderer
from support.analytic_bundle import write_manifest
from support.network_bundle import network_constants, set_network_metadata, write_network_bundle
from support.preset_models import RULE, preset_model


@pytest.fixture(
    scope="module", params=["tiny", "fast", "other shapes", "occupancy", "fast, float16 tables", "gloss grid"]
)
def readers(request, tmp_path_factory):
    """Return the two readers of one bundle."""
    folder = tmp_path_factory.mktemp("bundle") / "a.relight"
    variant, _, tables = request.param.partition(", ")
    bundle = load_bundle(
        write_network_bundle(folder, preset_model(variant), RULE, half_tables=tables == "float16 tables")
    )
    return FusedCaches(bundle, num_threads=2), OnnxCaches(bundle, num_threads=1)


def points_and_directions(count: int, *, extent: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return rng.uniform(-extent, extent, (count, 3)).astype(np.float32), directions.astype(np.float32)


def assert_alike(found, expected, atol: float = 1e-5) -> None:
    """Compare all outputs; normals get the slack that dividing by a short vector's length gives them."""
    for field in fields(expected):
        ours, theirs = getattr(found, field.name), getattr(expected, field.name)
        assert ours.shape == theirs.shape
        if field.name == "normal":
            assert np.quantile(np.abs(ours - theirs), 0.99) < atol
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=100 * atol)
        else:
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=atol, err_msg=field.name)


def test_secondary_rays_are_answered_as_by_the_graph(readers):
    fused, graphs = readers
    rays = points_and_directions(4000, extent=2.0)
    found = fused.secondary(*rays)
    assert found.opacity.std() > 0.01
    assert_alike(found, graphs.secondary(*rays))


def test_materials_are_answered_as_by_the_graph(readers):
    fused, graphs = readers
    positions, _ = points_and_directions(4000, extent=1.6)
    found = fused.material(positions)
    assert found.albedo.std() > 0.01
    assert_alike(found, graphs.material(positions))


def test_camera_rays_are_answered_as_by_the_graph(readers):
    fused, graphs = readers
    targets, directions = points_and_directions(500, extent=1.0)
    rays = (targets - 3.0 * directions).astype(np.float32), directions
    found, expected = fused.gbuffer(*rays), graphs.gbuffer(*rays)
    assert 0.05 < expected.opacity.mean() < 0.999
    assert_alike(found, expected, atol=4e-5)


def test_camera_rays_that_miss_the_box_see_nothing(readers):
    fused, graphs = readers
    origin = np.float32([[5.0, 5.0, 0.0], [3.0, 0.0, 0.0]])
    direction = np.float32([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    found = fused.gbuffer(origin, direction)
    assert (found.opacity == 0.0).all()
    assert_alike(found, graphs.gbuffer(origin, direction))


def test_any_number_of_rows_is_answered_alike(readers):
    fused, _ = readers
    rays = points_and_directions(5000, extent=1.0)
    whole, surfaces = fused.secondary(*rays), fused.material(rays[0])
    for count in (0, 1, 255, 257):
        some = fused.secondary(rays[0][:count], rays[1][:count])
        np.testing.assert_array_equal(some.opacity, whole.opacity[:count])
        np.testing.assert_array_equal(some.distance, whole.distance[:count])
        np.testing.assert_array_equal(fused.material(rays[0][:count]).albedo, surfaces.albedo[:count])


@pytest.fixture(scope="module")
def tiny():
    return preset_model("tiny")


@pytest.fixture
def folder(tiny, tmp_path):
    return write_network_bundle(tmp_path / "a.relight", tiny, RULE)


def change(folder, edit) -> None:
    manifest = json_format.Parse((folder / "manifest.json").read_text(encoding="utf-8"), BundleManifest())
    edit(manifest)
    write_manifest(folder, manifest)


@pytest.mark.parametrize(
    ("graph", "changes", "reason"),
    [
        ("material", {"kind": "material.v7"}, r"material\.v7"),
        ("material", {"softplus_beta": 0.0}, "must be positive"),
        ("material", {"albedo_bias": "dark"}, "incomplete"),
        ("material", {"contraction_radius": None}, "not finite"),
        ("fast_cache_sky", {"near": float("nan")}, "not finite"),
        ("fast_cache_sky", {"num_frequencies": 3}, "inputs"),
        ("fast_cache_sky", {"curve_power": 1.0}, "out of range"),
        ("gbuffer", {"num_samples": 50}, "sampling rule"),
        ("gbuffer", {"box_min": [0.0]}, "sampling rule"),
    ],
)
def test_networks_it_does_not_know_are_left_to_the_graphs_with_the_reason(
    tiny, folder, graph, changes, reason
):
    values = network_constants(tiny, RULE)[graph.removesuffix("_sky")]
    set_network_metadata(folder, graph, values | changes)
    change(folder, lambda manifest: None)
    with pytest.raises(NotFused, match=reason):
        FusedCaches(load_bundle(folder))


def test_missing_tensors_are_left_to_the_graphs_with_the_reason(folder):
    def drop(manifest):
        kept = [t for t in manifest.tensors if t.name != "fast.gate_head.bias"]
        del manifest.tensors[:]
        manifest.tensors.extend(kept)

    change(folder, drop)
    with pytest.raises(NotFused, match=r"fast\.gate_head\.bias"):
        FusedCaches(load_bundle(folder))


@pytest.mark.parametrize(("field", "value"), [("first_row", 2**31), ("num_rows", 2**31), ("num_rows", 0)])
def test_grids_that_name_rows_beyond_their_table_are_refused(folder, field, value):
    def spoil(manifest):
        level = next(grid for grid in manifest.grids if grid.name == "fast.distance_grid").levels[-1]
        setattr(level, field, value)

    change(folder, spoil)
    with pytest.raises(BundleError, match=r"bundle\.grid_invalid"):
        FusedCaches(load_bundle(folder))


@pytest.mark.parametrize("offset", [1e12, 3.0, -256.0, float("nan")])
def test_tensors_outside_the_weights_are_refused(folder, offset):
    def spoil(manifest):
        next(t for t in manifest.tensors if t.name == "materials.albedo.weight").offset_bytes = offset

    change(folder, spoil)
    with pytest.raises(BundleError, match=r"bundle\.tensor_invalid"):
        FusedCaches(load_bundle(folder))


def test_the_renderer_uses_compiled_code_where_it_can_and_says_where_not(tiny, folder, caplog):
    assert Renderer(load_bundle(folder)).caches.name == "fused"
    assert Renderer(load_bundle(folder), reader="onnx").caches.name == "onnxruntime"
    assert not caplog.records
    set_network_metadata(folder, "material", {"kind": "material.v7"})
    change(folder, lambda manifest: None)
    assert Renderer(load_bundle(folder)).caches.name == "onnxruntime"
    assert "material.v7" in caplog.text
    with pytest.raises(SettingError, match=r"relight\.reader"):
        Renderer(load_bundle(folder), reader="fused")


@pytest.mark.parametrize("far", [0.5, 2.0, 8.0])
def test_the_curve_of_distances_is_straight_between_its_places(far):
    ladder = kernels.distance_ladder(0.05, far, -1.5, 2.0).astype(np.float64)
    assert (ladder[0], ladder[-1]) == pytest.approx((0.05, far), rel=1e-6)
    start, end = ((2.5 / -1.5) * ((2.0 * t / 2.5 + 1.0) ** -1.5 - 1.0) for t in (0.05, far))
    places = (np.arange(len(ladder) - 1) + 0.5) / (len(ladder) - 1)
    y = start + places * (end - start)
    exact = (2.5 / 2.0) * ((-1.5 * y / 2.5 + 1.0) ** (1.0 / -1.5) - 1.0)
    assert np.abs(0.5 * (ladder[1:] + ladder[:-1]) - exact).max() < 1e-6 * max(1.0, far)

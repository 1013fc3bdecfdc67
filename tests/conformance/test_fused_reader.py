"""The fused reader answers as the torch model whose weights it reads."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache import presets
from flashcache.encoding.hash_grid import HashGrid
from flashcache.fields.density import NormalConfig
from flashcache.physical.model import Domain, InverseModel
from google.protobuf import json_format
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.bundle import load_bundle
from lambent_relight.errors import BundleError, SettingError
from lambent_relight.fused import FusedCaches, NotFused
from lambent_relight.renderer import Renderer
from support.analytic_bundle import write_analytic_bundle, write_manifest
from support.analytic_scene import AnalyticScene, Sphere
from support.network_bundle import add_networks, set_network_metadata

DOMAIN = Domain(
    bounds_min=(-1.0, -1.0, -1.0),
    bounds_max=(1.0, 1.0, 1.0),
    primary=(2.0, 6.0),
    secondary=(0.05, 2.0),
    contraction_radius=1.3,
    lights=("sky",),
)


def model_of(preset: str) -> InverseModel:
    """Return a model with weights as large as trained ones, in every layer."""
    torch.manual_seed(0)
    config = getattr(presets, "tiny" if preset == "no own grid, deep" else preset)().model
    if preset == "no own grid, deep":
        # Shapes that the small presets do not have: a skip connection, ReLU, linear normals.
        density = replace(config.nerf.density, softplus_beta=None)
        config = replace(
            config,
            nerf=replace(config.nerf, density=density, normals=NormalConfig(own_grid=None)),
            fast=replace(config.fast, distance_layers=4, code_layers=2),
        )
    model = InverseModel(config, DOMAIN)
    with torch.no_grad():
        for module in model.modules():
            if isinstance(module, HashGrid):
                module.table.normal_(0.0, 0.1)
            if isinstance(module, torch.nn.Linear):
                module.bias.normal_(0.0, 0.2)
        model.fast.distance_head.weight.normal_(0.0, 0.3)
    return model


@pytest.fixture(scope="module", params=["tiny", "fast", "no own grid, deep"])
def pair(request, tmp_path_factory):
    """Return a model and the reader of its bundle."""
    model = model_of(request.param)
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 1.0),))
    folder = write_analytic_bundle(tmp_path_factory.mktemp("bundle") / "a.relight", scene)
    add_networks(folder, model)
    return model, FusedCaches(load_bundle(folder), num_threads=2)


def rows(count: int, *, extent: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return rng.uniform(-extent, extent, (count, 3)).astype(np.float32), directions.astype(np.float32)


def test_opacity_and_distance_are_those_of_the_fast_cache(pair):
    model, reader = pair
    origin, direction = rows(5000, extent=2.0)
    hits = reader.secondary(origin, direction)
    with torch.no_grad():
        answer = model.fast(
            torch.from_numpy(origin), torch.from_numpy(direction), torch.zeros(5000, dtype=torch.long)
        )
    assert hits.opacity.std() > 0.01
    np.testing.assert_allclose(hits.opacity[:, 0], answer.opacity, rtol=0, atol=1e-5)
    np.testing.assert_allclose(hits.distance[:, 0], answer.distance, rtol=0, atol=1e-5)


def test_materials_and_normals_are_those_of_the_fields(pair):
    model, reader = pair
    position, _ = rows(5000, extent=1.6)
    found = reader.material(position)
    with torch.no_grad():
        points = torch.from_numpy(position)
        materials = model.materials(points)
        normal = model.nerf.normals(points, model.nerf.density(points).hidden)
    np.testing.assert_allclose(found.albedo, materials.albedo, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.perceptual_roughness**2, materials.alpha, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.metalness, materials.metalness, rtol=0, atol=1e-5)
    # A unit normal amplifies rounding where the vector before normalising is short.
    np.testing.assert_allclose(found.normal, normal, rtol=0, atol=1e-4)
    assert np.median(np.abs(found.normal - normal.numpy())) < 1e-6


def test_any_number_of_rows_is_answered_alike(pair):
    _, reader = pair
    origin, direction = rows(5000, extent=1.0)
    whole = reader.secondary(origin, direction)
    for count in (0, 1, 255, 257):
        some = reader.secondary(origin[:count], direction[:count])
        np.testing.assert_array_equal(some.opacity, whole.opacity[:count])
        np.testing.assert_array_equal(some.distance, whole.distance[:count])


@pytest.fixture
def folder(tmp_path):
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 1.0),))
    path = write_analytic_bundle(tmp_path / "a.relight", scene)
    add_networks(path, model_of("tiny"))
    return path


def change(folder, edit) -> None:
    manifest = json_format.Parse((folder / "manifest.json").read_text(encoding="utf-8"), BundleManifest())
    edit(manifest)
    write_manifest(folder, manifest)


def test_other_networks_are_left_to_the_graphs_with_the_reason(folder):
    set_network_metadata(folder, "material", {"kind": "material.v7"})
    change(folder, lambda manifest: None)
    with pytest.raises(NotFused, match=r"material\.v7"):
        FusedCaches(load_bundle(folder))
    set_network_metadata(folder, "material", {"kind": "material.v1"})
    change(folder, lambda manifest: None)
    with pytest.raises(NotFused, match="incomplete"):
        FusedCaches(load_bundle(folder))


def test_missing_tensors_and_wrong_shapes_are_left_to_the_graphs(folder):
    def drop(manifest):
        kept = [t for t in manifest.tensors if t.name != "fast.distance_head.bias"]
        del manifest.tensors[:]
        manifest.tensors.extend(kept)

    change(folder, drop)
    with pytest.raises(NotFused, match=r"fast\.distance_head\.bias"):
        FusedCaches(load_bundle(folder))


@pytest.mark.parametrize("field", ["first_row", "num_rows"])
def test_grids_that_name_rows_beyond_their_table_are_refused(folder, field):
    def spoil(manifest):
        level = next(grid for grid in manifest.grids if grid.name == "fast.distance_grid").levels[-1]
        setattr(level, field, 2**31)

    change(folder, spoil)
    with pytest.raises(BundleError, match=r"bundle\.grid_invalid"):
        FusedCaches(load_bundle(folder))


@pytest.mark.parametrize("offset", [1e12, 3.0, -256.0])
def test_tensors_outside_the_weights_are_refused(folder, offset):
    def spoil(manifest):
        next(t for t in manifest.tensors if t.name == "materials.head.weight").offset_bytes = offset

    change(folder, spoil)
    with pytest.raises(BundleError, match=r"bundle\.tensor_invalid"):
        FusedCaches(load_bundle(folder))


def test_the_renderer_uses_the_fused_reader_where_it_can_and_says_where_not(folder, caplog):
    assert Renderer(load_bundle(folder)).caches.name == "fused"
    assert Renderer(load_bundle(folder), reader="onnx").caches.name == "onnxruntime"
    assert not caplog.records
    set_network_metadata(folder, "material", {"kind": "material.v7"})
    change(folder, lambda manifest: None)
    assert Renderer(load_bundle(folder)).caches.name == "onnxruntime"
    assert "material.v7" in caplog.text
    with pytest.raises(SettingError, match=r"relight\.reader"):
        Renderer(load_bundle(folder), reader="fused")

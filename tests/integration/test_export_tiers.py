"""Bundles with float16 or float32 tables, and lite bundles without networks."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.caches.fast_cache import LEAST_OPACITY
from lambent_asset.bundle import graphs
from lambent_asset.textures import surface
from lambent_core.directions import pixel_directions
from lambent_core.errors import UnsupportedQuality, WorkerError
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.cameras import turntable
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.renderer import Renderer
from lambent_run.run.tasks import export
from support import small_export
from support.small_export import LIGHTS, small_context
from support.sphere_model import sphere_model

CAMERA = turntable(1, radius=3.0, width=24, height=24)[0]


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=LIGHTS)


def exported(tmp_path, model, monkeypatch, **settings):
    """Return the bundle that an export with these settings writes, and what the export logged and found."""
    context = small_context(tmp_path, model, monkeypatch)
    config = context.spec.config
    config = replace(config, export=replace(config.export, judge_samples=0, **settings))
    context = replace(context, spec=replace(context.spec, config=config))
    export.run(context)
    return load_bundle(context.folder), context.reporter.events | context.reporter.findings


def dtypes(bundle):
    return {(tensor.name.endswith(".table"), tensor.dtype) for tensor in bundle.manifest.tensors}


def test_tables_are_halves_and_the_manifest_says_what_that_changed(tmp_path, model, monkeypatch):
    bundle, events = exported(tmp_path, model, monkeypatch)
    assert dtypes(bundle) == {(True, "float16"), (False, "float32")}
    found = {(graph.path, item.output): item for graph in bundle.manifest.graphs for item in graph.rounding}
    assert ("models/gbuffer.onnx", "normal") in found
    assert ("models/fast_cache_day.onnx", "radiance") in found
    for item in found.values():
        assert 0.0 < item.rms_error <= item.max_abs_error
        assert item.rms_error <= 1e-2
        assert item.num_samples == 256
    assert not [graph for graph in bundle.manifest.graphs if graph.name == "relight" and graph.rounding]
    assert "export.full_precision" not in events


def test_full_precision_on_request_changes_nothing(tmp_path, model, monkeypatch):
    bundle, _ = exported(tmp_path, model, monkeypatch, weights="fp32", transport_tier="none")
    assert dtypes(bundle) == {(True, "float32"), (False, "float32")}
    assert not any(graph.rounding for graph in bundle.manifest.graphs)


def test_only_the_fast_caches_are_compared_with_an_edge_in_mind(tmp_path, model, monkeypatch):
    edges, right = {}, graphs.compare

    def watched(name, *given, edge=None, **options):
        edges[name] = edge
        return right(name, *given, edge=edge, **options)

    monkeypatch.setattr(graphs, "compare", watched)
    exported(tmp_path, model, monkeypatch, transport_tier="none")
    caches = {name for name in edges if "fast_cache" in name}
    assert caches
    assert {name for name, edge in edges.items() if edge == ("opacity", LEAST_OPACITY)} == caches


def test_tables_stay_float32_where_halves_would_move_an_answer(tmp_path, model, monkeypatch):
    monkeypatch.setattr(export, "MOST_ROUNDING", 0.0)
    bundle, events = exported(tmp_path, model, monkeypatch, transport_tier="none")
    assert dtypes(bundle) == {(True, "float32"), (False, "float32")}
    assert events["export.full_precision"]["rms_error"] > 0.0
    assert [graph.name for graph in bundle.manifest.graphs] == [
        "gbuffer",
        "material",
        "fast_cache",
        "fast_cache",
    ]


def test_halves_that_are_asked_for_must_be_able_to_hold_the_tables(tmp_path, monkeypatch):
    model = sphere_model(lights=LIGHTS)
    with torch.no_grad():
        model.materials.grid.table[0, 0] = 70_000.0
    with pytest.raises(WorkerError, match=r"export\.half_range"):
        exported(tmp_path, model, monkeypatch, weights="fp16", transport_tier="none")


def test_a_lite_bundle_shows_baked_pictures_and_says_why_it_cannot_refine(tmp_path, model, monkeypatch):
    bundle, told = exported(tmp_path, model, monkeypatch, weights="none", transport_tier="lite")
    # It is fetched as a whole: no levels of detail.
    assert not bundle.manifest.mesh_levels
    assert [file.path for file in bundle.manifest.files if file.role == "mesh"] == ["mesh/asset.glb"]
    assert not {code for code in told if code.startswith("export.")}
    assert [graph.name for graph in bundle.manifest.graphs] == ["relight"]
    assert not {file.role for file in bundle.manifest.files} & {"weights"}
    assert (len(bundle.manifest.tensors), len(bundle.manifest.grids)) == (0, 0)
    light = environment_from_array(1.0 + pixel_directions(8, 16)[..., 2:] * [0.5, 0.4, 0.3])
    renderer = Renderer(bundle)
    for quality in ("baked", "preview"):
        picture = renderer.render(CAMERA, light, quality=quality)
        assert picture.opacity.max() == 1.0
        assert picture.rgb[picture.opacity[..., 0] > 0.9].min() > 0.0
    with pytest.raises(UnsupportedQuality, match="networks") as raised:
        renderer.render(CAMERA, light)
    assert raised.value.code == "relight.networks_missing"


def test_photographs_give_detail_without_baked_transport_in_the_bundle_too(tmp_path, model, monkeypatch):
    bundle, _ = exported(tmp_path, model, monkeypatch, transport_tier="none")
    assert not bundle.manifest.HasField("transport")
    assert (bundle.manifest.atlas.size, bundle.manifest.atlas.albedo_source) == (128, "photographs")
    light = environment_from_array(np.ones((8, 16, 3), np.float32))
    assert Renderer(bundle).render(CAMERA, light, spp=4).opacity.max() > 0.9


def test_materials_alone_make_the_texture_on_request(tmp_path, model, monkeypatch):
    bundle, told = exported(tmp_path, model, monkeypatch, transport_tier="none", albedo="model")
    assert "--atlas 128" in told["export.atlas_unused"]
    atlas = bundle.manifest.atlas
    assert (atlas.size, atlas.albedo_source) == (atlas.material_size, "model")


def test_photographs_that_were_trained_at_their_full_size_say_nothing_new(tmp_path, model, monkeypatch):
    monkeypatch.setattr(small_export, "finer", lambda view: view)
    bundle, events = exported(tmp_path, model, monkeypatch, transport_tier="none")
    assert bundle.manifest.atlas.albedo_source == "model"
    assert events["texture.nothing_finer"] == {"finer": 1.0}
    assert "hardly finer" in events["export.atlas_unused"]


def test_a_mesh_with_open_edges_is_said_to_have_them(tmp_path, model, monkeypatch):
    _, events = exported(tmp_path, model, monkeypatch, transport_tier="none", albedo="model")
    assert "mesh.not_watertight" not in events
    whole = surface.build_shape

    def with_a_hole(*args, **kwargs):
        shape = whole(*args, **kwargs)
        return replace(shape, mesh=replace(shape.mesh, faces=shape.mesh.faces[1:]))

    monkeypatch.setattr(surface, "build_shape", with_a_hole)
    (tmp_path / "open").mkdir()
    _, events = exported(tmp_path / "open", model, monkeypatch, transport_tier="none", albedo="model")
    assert events["mesh.not_watertight"] == {"boundary_edges": 3, "non_manifold_edges": 0}

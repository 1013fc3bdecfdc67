"""The export step, from a model to a bundle that clients open."""

import json
from dataclasses import replace
from hashlib import sha256

import numpy as np
import onnxruntime
import pytest
import torch
import trimesh
from flashcache.export import reference
from lambent_asset.bundle.parity import with_half_tables
from lambent_core.colour import srgb_from_linear
from lambent_core.errors import Stopped, WorkerError
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.bundle.graphs import OnnxCaches
from lambent_relight.environment.maps import load_environment
from lambent_run.run.tasks import export
from PIL import Image
from support.small_export import LIGHTS, scene, small_context
from support.sphere_model import RADIUS, sphere_model
from support.texture_lookup import sample_plane
from support.turning_light import TURNS, flat


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=LIGHTS)


@pytest.fixture
def context(tmp_path, model, monkeypatch):
    return small_context(tmp_path, model, monkeypatch)


@pytest.fixture(scope="module")
def exported(tmp_path_factory, model):
    """Return the context of one export that found another bundle in its place."""
    with pytest.MonkeyPatch.context() as patched:
        context = small_context(tmp_path_factory.mktemp("exported"), model, patched)
        (context.folder / "old").write_text("the bundle of another time")
        export.run(context)
    return context


def test_a_client_opens_the_bundle_and_sees_what_the_model_sees(exported, model):
    model = with_half_tables(model)
    bundle = load_bundle(exported.folder)
    caches = OnnxCaches(bundle, num_threads=1)
    camera = bundle.cameras()[0]
    origin, direction = camera.rays()
    found = caches.gbuffer(origin, direction)
    assert (found.opacity > 0.9).any()
    assert (found.opacity < 0.1).any()
    rule = reference.GbufferRule(
        box_min=tuple(bundle.manifest.bounds.minimum),
        box_max=tuple(bundle.manifest.bounds.maximum),
        num_samples=32,
    )
    with torch.no_grad():
        expected = reference.gbuffer(model, rule, torch.from_numpy(origin), torch.from_numpy(direction))
        answer = reference.fast_cache(model, 1, torch.from_numpy(direction), torch.from_numpy(-direction))
    assert np.allclose(found.albedo, expected["albedo"], atol=1e-5)
    assert np.allclose(caches.secondary(direction, -direction).opacity, answer["opacity"], atol=1e-5)


def test_the_manifest_describes_the_bundle(exported, model):
    manifest = load_bundle(exported.folder).manifest
    assert list(manifest.train_lights) == ["day", "a_night"]
    assert [(graph.name, graph.light) for graph in manifest.graphs] == [
        ("gbuffer", ""),
        ("material", ""),
        ("fast_cache", "day"),
        ("fast_cache", "a_night"),
        ("relight", ""),
    ]
    for graph in manifest.graphs:
        assert graph.parity.max_abs_error <= graph.parity.tolerance == 1e-5
        assert graph.parity.num_samples >= 250
    assert {file.role for file in manifest.files} == {
        *("graph", "weights", "mesh", "environment", "cameras", "preview", "uncertainty", "transport"),
        *("mask", "poster"),
    }
    previews = {file.path for file in manifest.files if file.path.startswith("preview/")}
    views = {f"preview/{kind}test_00{number}.png" for kind in ("", "photo_") for number in (0, 1)}
    assert previews == {"preview/cache.png", *views}
    assert (exported.folder / "preview/photo_test_000.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert manifest.secondary_rays.origin_offset == model.limits.origin_offset
    data = (exported.folder / "models" / "weights.bin").read_bytes()
    assert len(data) == max(item.offset_bytes + item.size_bytes for item in manifest.tensors)
    grid = next(item for item in manifest.grids if item.name == "fast.feature_grid")
    table = next(item for item in manifest.tensors if item.name == grid.tensor)
    assert table.dtype == "float16"
    stored = np.frombuffer(data, "<f2", int(table.size_bytes) // 2, int(table.offset_bytes))
    assert np.array_equal(stored.reshape(table.shape), model.fast.feature_grid.table.detach().half())
    assert (grid.half_extent, grid.num_features, grid.levels[-1].num_rows) == (2.0, 4, 4096)
    assert sha256(data).hexdigest() in {file.sha256 for file in manifest.files}
    assert set(manifest.metrics) == {
        *("psnr_views", "gbuffer_opacity_error", "gbuffer_distance_error", "mesh_faces", "mesh_vertices"),
        *("mesh_boundary_edges", "mesh_non_manifold_edges", "mesh_pieces", "mesh_simplification_error"),
        *("mesh_depth_median_pixels", "mesh_depth_p95_pixels", "mesh_depth_worst_view_p95_pixels"),
        "mesh_unseen_share",
        *("mesh_silhouette_iou", "transport_rays_per_texel", "transport_blocked_share"),
        *("texture_photograph_share", "texture_photographs"),
        *(
            f"{quality}_{figure}_refined_{light}"
            for quality in ("baked", "preview")
            for figure in ("psnr", "worst")
            for light in (*manifest.train_lights, "soft_boxes", "low_sun")
        ),
    }
    assert manifest.metrics["mesh_silhouette_iou"] > 0.7
    assert manifest.schema_version == "1"
    atlas, size = manifest.atlas, manifest.transport.size
    assert (atlas.size, atlas.material_size, atlas.albedo_source) == (128, size, "photographs")
    assert 0.9 * 0.515 * 64**2 < manifest.transport.num_texels < 1.1 * 0.515 * 64**2 or size == 64
    num_texels = manifest.transport.num_texels * (128 / size) ** 2
    assert atlas.texel_size**2 * num_texels == pytest.approx(4.0 * np.pi * RADIUS**2, rel=0.3)
    # The photographs of this capture are empty.
    assert manifest.metrics["mesh_unseen_share"] == 1.0
    with Image.open(exported.folder / manifest.atlas.unseen_path) as mask:
        assert mask.mode == "L"
        assert np.asarray(mask).shape == (size, size)
        assert (np.asarray(mask) == 255).all()
    assert manifest.metrics["mesh_boundary_edges"] == manifest.metrics["mesh_non_manifold_edges"] == 0
    assert manifest.mesh_levels[0].path == "mesh/lod1.glb"
    level = trimesh.load_scene(exported.folder / "mesh" / "lod1.glb").to_mesh()
    assert len(level.faces) == manifest.mesh_levels[0].num_faces < manifest.metrics["mesh_faces"]
    assert level.visual.material.baseColorTexture.size == (64, 64)
    assert manifest.mesh_levels[0].texture_size == 64


def test_the_meshs_textures_are_the_models_materials_and_visibility(exported, model):
    mesh = trimesh.load_scene(exported.folder / "mesh" / "asset.glb").to_mesh()
    texture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"), np.float64) / 255.0
    # trimesh counts v from the bottom; x of the file is x of the world, its y is z, its z is -y.
    found = sample_plane(texture, mesh.visual.uv * [1.0, -1.0] + [0.0, 1.0])
    world = mesh.vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    with torch.no_grad():
        albedo = model.materials(torch.from_numpy(world.astype(np.float32))).albedo.numpy()
    # The field is random and the mesh has 408 vertices: where they lie depends on rounding.
    assert np.median(np.abs(found - srgb_from_linear(albedo))) < 0.07
    packed = np.asarray(mesh.visual.material.metallicRoughnessTexture.convert("RGB"), np.float64)
    # Nothing stands around a ball, whatever its untrained fast cache says.
    assert packed[..., 0].mean() / 255.0 > 0.97


def test_the_bundle_says_how_sure_it_is_of_materials_everywhere(exported):
    found = load_bundle(exported.folder).uncertainty()
    assert found is not None
    low, high = (np.array(corner) for corner in (found.low, found.high))
    assert (high - low).max() < 3.0
    values = found.at(np.random.default_rng(0).uniform(low, high, (50, 3)))
    assert np.isfinite(values).all()
    assert values[:, 0].max() <= 1.01


def test_a_usdz_file_is_written_where_it_is_asked_for(context):
    pytest.importorskip("pxr.Usd")
    config = context.spec.config
    config = replace(config, export=replace(config.export, usdz=True))
    export.run(replace(context, spec=replace(context.spec, config=config)))
    files = {file.path: file for file in load_bundle(context.folder).manifest.files}
    assert files["mesh/asset.usdz"].role == "mesh"


def test_every_field_of_the_manifest_is_written_with_its_proto_name(exported):
    record = json.loads((exported.folder / "manifest.json").read_text())
    assert record["world"]["environment_convention"] == "tensoir"
    assert record["graphs"][0]["light"] == ""
    assert record["created_at"].endswith("Z")


def test_the_recovered_environments_are_those_of_the_model(exported, model):
    bundle = load_bundle(exported.folder)
    for index, light in enumerate(bundle.manifest.train_lights):
        found = bundle.trained_environment(light).radiance
        assert np.allclose(found, model.environment.image(8, index), rtol=1e-3)


def test_progress_reaches_the_end_and_never_falls(exported):
    fractions = exported.reporter.fractions
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0
    assert exported.reporter.artifacts["asset.glb"].is_file()


def test_a_graph_that_differs_leaves_nothing_behind(context, monkeypatch):
    original = reference.material

    def shifted(model, position):
        return {name: value + 1e-4 for name, value in original(model, position).items()}

    monkeypatch.setattr(reference, "material", shifted)
    (context.folder / "old").write_text("the bundle of another time")
    with pytest.raises(WorkerError, match="material"):
        export.run(context)
    assert [path.name for path in context.folder.iterdir()] == ["old"]
    assert not context.folder.with_name("bundle.partial").exists()


def test_a_request_to_stop_leaves_nothing_behind(context):
    context.reporter.stop = True
    with pytest.raises(Stopped):
        export.run(context)
    assert not any(context.folder.iterdir())


def test_the_bundle_replaces_an_older_one(exported):
    assert not (exported.folder / "old").exists()
    load_bundle(exported.folder)


def test_two_exports_of_one_model_differ_only_in_their_time(exported, context):
    first = {path.name: path.read_bytes() for path in exported.folder.rglob("*") if path.is_file()}
    export.run(context)
    second = {path.name: path.read_bytes() for path in context.folder.rglob("*") if path.is_file()}
    assert first.keys() == second.keys()
    assert {name for name in first if first[name] != second[name]} <= {"manifest.json"}


def test_light_names_become_file_names_without_meeting():
    assert export.light_names(("sun set", "day")) == ["sun_set", "day"]
    assert export.light_names(("a b", "a/b")) == ["a_b_0", "a_b_1"]


def test_a_light_that_turns_is_exported_as_it_stood_at_the_reference(tmp_path, monkeypatch):
    model = sphere_model(lights=LIGHTS[:1], turns=flat(TURNS))
    context = small_context(tmp_path, model, monkeypatch)
    views = tuple(replace(view, light_turn=turn) for view, turn in zip(scene().test, TURNS, strict=True))
    turned = replace(scene(), lights=LIGHTS[:1], train=views, test=views)
    monkeypatch.setattr(export, "read_scene", lambda context: turned)
    export.run(context)
    bundle = load_bundle(context.folder)
    assert list(bundle.manifest.train_lights) == list(LIGHTS[:1])
    direction = torch.nn.functional.normalize(
        torch.randn(64, 3, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    path = next(graph.path for graph in bundle.manifest.graphs if graph.name == "fast_cache")
    session = onnxruntime.InferenceSession(context.folder / path)
    found = session.run(["radiance"], {"origin": direction.numpy(), "direction": -direction.numpy()})[0]
    with torch.no_grad():
        still, other = (
            reference.fast_cache(with_half_tables(model), light, direction, -direction) for light in (0, 1)
        )
    np.testing.assert_allclose(found, still["radiance"], atol=1e-5)
    assert not np.allclose(still["radiance"], other["radiance"], atol=1e-2)
    environment = load_environment(context.folder / "env" / f"trained_{LIGHTS[0]}.exr").radiance
    with torch.no_grad():
        expected = model.environment.image(len(environment)).numpy()
    np.testing.assert_allclose(environment, expected, rtol=2e-3)

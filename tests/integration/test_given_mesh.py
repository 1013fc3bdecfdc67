"""lambent export RUN --mesh: from a file that Blender wrote to a bundle that clients open and relight."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from flashcache.errors import ConfigError
from lambent_asset.given_mesh.glb_file import read_glb
from lambent_core.errors import Stopped, UsageError
from lambent_relight import Renderer, UnsupportedQuality, load_bundle
from lambent_relight.asset.textured_mesh import pixels_of, textured_mesh_from_glb
from lambent_relight.baked.raster import rasterise_uv
from lambent_relight.cameras import turntable
from lambent_relight.environment.maps import environment_from_array
from lambent_run.run import given_mesh
from lambent_run.run.tasks import export
from support.given_glb import SQUARE, glb_file
from support.small_export import LIGHTS, Listener, small_context
from support.sphere_model import sphere_model

EDITED = Path(__file__).parents[1] / "data" / "edited"
BALL = EDITED / "ball_edited.glb"
CAMERA = turntable(1, radius=3.0, width=32, height=32)[0]
LIGHT = environment_from_array(np.broadcast_to(np.float32([0.9, 1.0, 1.1]), (8, 16, 3)))


@pytest.fixture(scope="module")
def model():
    return sphere_model(lights=LIGHTS)


@pytest.fixture
def context(tmp_path, model, monkeypatch):
    """Return a context whose run is trained to its end, as the command finds it."""
    made = small_context(tmp_path, model, monkeypatch)
    config = replace(made.spec.config, export=replace(made.spec.config.export, judge_samples=0))
    made = replace(made, spec=replace(made.spec, config=config))
    monkeypatch.setattr(given_mesh, "read_scene", export.read_scene)
    monkeypatch.setattr(given_mesh, "load_final", export.load_final)
    monkeypatch.setattr(
        given_mesh, "open_task", lambda run_dir, task, reporter: replace(made, reporter=reporter)
    )
    monkeypatch.setattr(given_mesh, "require_done", lambda run_dir, task: "hash")
    return made


def digests(folder):
    return {
        path.relative_to(folder): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def test_a_mesh_from_blender_becomes_a_bundle_that_is_relit(context, tmp_path):
    before = digests(context.run_dir)
    reporter = Listener()
    out = tmp_path / "edited.relight"
    given_mesh.export_given_mesh(context.run_dir, out, BALL, reporter)
    bundle = load_bundle(out)
    manifest = bundle.manifest
    assert manifest.schema_version == "1"
    assert (manifest.given_mesh.name, manifest.given_mesh.kept_uv) == ("ball_edited.glb", True)
    data = (BALL).read_bytes()
    assert manifest.given_mesh.sha256 == hashlib.sha256(data).hexdigest()
    assert manifest.given_mesh.share_from_model == 0.0
    assert list(manifest.train_lights) == ["day", "a_night"]
    assert {file.role for file in manifest.files} == {
        "mesh",
        "transport",
        "graph",
        "environment",
        "cameras",
        "preview",
        "poster",
    }
    np.testing.assert_allclose(list(manifest.bounds.maximum), [0.55, 0.65, 0.4], atol=0.04)
    renderer = Renderer(bundle, num_threads=1)
    picture = renderer.render(CAMERA, LIGHT, quality="baked", antialias=1)
    covered = picture.opacity[..., 0] > 0.5
    assert 60 < covered.sum() < 200
    assert 0.05 < picture.rgb[covered].mean() < 1.0
    with pytest.raises(UnsupportedQuality, match=r"relight\.networks_missing"):
        renderer.render(CAMERA, LIGHT, quality="refined")
    assert reporter.events["mesh.read"]["parts"] == 1
    assert "mesh.ignored" not in reporter.events
    assert reporter.fractions[-1] == 1.0
    assert digests(context.run_dir) == before, "the run stays as it was"
    assert not list(tmp_path.glob("*.partial*"))


def test_our_own_file_put_back_is_the_same_asset(context, tmp_path, monkeypatch):
    detail = np.random.default_rng(5).random((128, 128, 3)).astype(np.float32)
    monkeypatch.setattr(export, "albedo_texture", lambda *arguments: (detail, {}))
    export.run(context)
    before = textured_mesh_from_glb((context.folder / "mesh" / "asset.glb").read_bytes())
    given_mesh.export_given_mesh(
        context.run_dir, tmp_path / "same", context.folder / "mesh" / "asset.glb", Listener(), tier="lite"
    )
    bundle = load_bundle(tmp_path / "same")
    after = textured_mesh_from_glb(bundle.read("mesh/asset.glb", 1 << 30))
    np.testing.assert_allclose(after.vertices, before.vertices, atol=1e-6)
    np.testing.assert_array_equal(after.uv, before.uv)
    np.testing.assert_array_equal(after.faces, before.faces)
    for name in ("base_colour_png", "packed_png"):
        pair = [pixels_of(getattr(mesh, name)).astype(int) for mesh in (before, after)]
        assert pair[0].shape == pair[1].shape, name
        if name == "base_colour_png":
            assert pair[0].shape == (128, 128, 3)
            # Outside the charts the file may hold anything; there it repeats the nearest texel inside.
            inside = rasterise_uv(after.uv, after.faces, 128).covered
            assert inside.mean() > 0.3
            pair = [picture[inside] for picture in pair]
        # Occlusion is that of the triangles now, and not the untrained fast cache's.
        rows = slice(0, 3) if name == "base_colour_png" else slice(1, 3)
        assert np.abs(pair[0] - pair[1])[..., rows].max() <= 1, name
    atlas = bundle.manifest.atlas
    assert (atlas.size, atlas.albedo_source) == (128, "file")
    assert atlas.material_size == len(pixels_of(after.packed_png)) < 128
    Renderer(bundle, num_threads=1).render(CAMERA, LIGHT, quality="baked", antialias=1)
    assert "transport/shadow_bits.bin" not in {file.path for file in bundle.manifest.files}


def test_what_the_bundle_does_not_hold_is_logged(context, tmp_path):
    def change(writer):
        number = writer.material({})
        writer.document["materials"][number]["emissiveFactor"] = [1.0, 1.0, 1.0]
        writer.mesh(material=number)

    reporter = Listener()
    path = glb_file(tmp_path / "lamp.glb", change)
    given_mesh.export_given_mesh(context.run_dir, tmp_path / "b", path, reporter)
    assert reporter.events["mesh.ignored"] == {"what": "emission"}
    assert len(read_glb(path).faces) == 2


def test_a_file_that_cannot_be_used_leaves_nothing_behind(context, tmp_path):
    path = glb_file(tmp_path / "far.glb", lambda w: w.mesh(node={"translation": [50.0, 0.0, 0.0]}))
    with pytest.raises(UsageError, match=r"mesh_file\.place"):
        given_mesh.export_given_mesh(context.run_dir, tmp_path / "b", path, Listener())
    (tmp_path / "exists").mkdir()
    with pytest.raises(UsageError, match=r"export\.exists"):
        given_mesh.export_given_mesh(context.run_dir, tmp_path / "exists", BALL, Listener())
    assert sorted(p.name for p in tmp_path.iterdir() if p.name[0] != ".") == [
        "exists",
        "far.glb",
        "run",
        "scene",
    ]


def test_it_stops_when_it_is_asked_to(context, tmp_path):
    reporter = Listener()
    reporter.stop = True
    with pytest.raises(Stopped):
        given_mesh.export_given_mesh(context.run_dir, tmp_path / "b", BALL, reporter)
    assert not (tmp_path / "b").exists()
    assert not list(tmp_path.glob("*.partial*"))


def test_a_stop_inside_the_bake_leaves_no_rays_for_the_next_mesh(context, tmp_path, monkeypatch):
    """The next export, of another mesh to the same place, must equal one that nothing preceded."""

    def other(writer):
        corners = SQUARE - np.float32([0.5, 0.5, 0.0])
        writer.mesh(corners, material=writer.material({}))

    whole = given_mesh.bake_transport

    def stopped(*arguments, store, advance, **options):
        def stop(share):
            assert list(store.rglob("*.npz")), "rays were stored before the stop"
            raise Stopped

        whole(*arguments, store=store, advance=stop, **options)

    monkeypatch.setattr(given_mesh, "bake_transport", stopped)
    with pytest.raises(Stopped):
        given_mesh.export_given_mesh(context.run_dir, tmp_path / "b", BALL, Listener())
    assert not list(tmp_path.glob("*.partial*"))
    # A program that is killed does not clean up behind itself.
    left = tmp_path / "b.partial.rays"
    left.mkdir()
    (left / "00000000.npz").write_bytes(b"of another mesh")
    monkeypatch.setattr(given_mesh, "bake_transport", whole)
    path = glb_file(tmp_path / "square.glb", other)
    for name in ("b", "fresh"):
        given_mesh.export_given_mesh(context.run_dir, tmp_path / name, path, Listener())
    one, two = (digests(tmp_path / name / "transport") for name in ("b", "fresh"))
    assert one == two


@pytest.mark.parametrize("weights", ["fp16", "fp32", "auto"])
def test_networks_with_a_given_mesh_are_refused(tmp_path, weights, capsys):
    from lambent_run.commands.training import export as command

    with pytest.raises(typer.Exit):
        command(tmp_path, tmp_path / "b", weights=weights, mesh=BALL)
    assert "mesh_file.no_networks" in capsys.readouterr().err


@pytest.mark.parametrize(("atlas", "side"), [("auto", 64), ("96", 96), ("", 128)])
def test_the_base_colour_has_the_side_that_is_asked_for(context, tmp_path, atlas, side):
    given_mesh.export_given_mesh(context.run_dir, tmp_path / "b", BALL, Listener(), atlas=atlas)
    bundle = load_bundle(tmp_path / "b")
    mesh = textured_mesh_from_glb(bundle.read("mesh/asset.glb", 1 << 30))
    assert bundle.manifest.atlas.size == len(pixels_of(mesh.base_colour_png)) == side


def test_a_side_that_is_none_is_refused(context, tmp_path):
    for atlas in ("9000", "many"):
        with pytest.raises(ConfigError):
            given_mesh.export_given_mesh(context.run_dir, tmp_path / "b", BALL, Listener(), atlas=atlas)


def test_a_number_of_triangles_with_a_given_mesh_is_refused(tmp_path, capsys):
    from lambent_run.commands.training import export as command

    with pytest.raises(typer.Exit):
        command(tmp_path, tmp_path / "b", faces="1000", mesh=BALL)
    assert "mesh_file.own_shape" in capsys.readouterr().err

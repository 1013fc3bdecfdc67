"""export and blender: which files come out of a run or a bundle, and what is refused."""

import json
from importlib.metadata import EntryPoint

import numpy as np
import OpenEXR
import pytest
from lambent.cli import app
from lambent_relight import write_environment
from support.asset_bundle import write_asset_bundle
from support.atlas_box import atlas_box, coloured

BOX = atlas_box(32)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return write_asset_bundle(tmp_path_factory.mktemp("formats") / "box", BOX, coloured(BOX))


def fault(capsys):
    return json.loads(capsys.readouterr().out)["error"]["code"]


def test_a_bundle_becomes_the_formats_that_are_asked_for(bundle, tmp_path, capsys):
    assert app.run(["export", str(bundle), "-o", str(tmp_path / "out"), "--glb", "--obj", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert files == [str(tmp_path / "out" / name) for name in ("asset.glb", "obj/asset.obj")]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["asset.glb", "obj"]


def test_a_run_is_exported_from_its_bundle(bundle, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    (tmp_path / "run" / "bundle").symlink_to(bundle)
    assert app.run(["export", str(tmp_path / "run"), "-o", str(tmp_path / "out"), "--glb"]) == 0
    assert (tmp_path / "out" / "asset.glb").is_file()


def test_a_run_without_a_bundle_says_how_to_get_one(tmp_path, capsys):
    (tmp_path / "run.json").write_text("{}")
    assert app.run(["export", str(tmp_path), "-o", str(tmp_path / "out"), "--glb", "--json"]) == 2
    assert fault(capsys) == "export.no_bundle"


def test_a_mitsuba_scene_takes_another_light_in_its_own_layout(bundle, tmp_path):
    radiance = np.zeros((4, 8, 3), np.float32)
    radiance[1, 0] = 5.0
    write_environment(tmp_path / "sky.exr", radiance, half=False)
    words = ["--mitsuba", "--env", str(tmp_path / "sky.exr"), "--env-axes", "mitsuba"]
    assert app.run(["export", str(bundle), "-o", str(tmp_path), *words]) == 0
    with OpenEXR.File(str(tmp_path / "mitsuba" / "environment.exr"), separate_channels=True) as file:
        red = file.parts[0].channels["R"].pixels
    # Its left edge is our +y, a quarter of the width left of our middle.
    rows, columns = np.nonzero(red)
    assert set(columns) == {2}
    assert np.average(rows + 0.5, weights=red[rows, columns]) == pytest.approx(
        red.shape[0] * 1.5 / 4, abs=1.0
    )


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ([], "export.no_format"),
        (["--webp"], "cli.bad_choice"),
        (["--obj", "--draco"], "cli.bad_choice"),
        (["--obj", "--ktx2"], "cli.bad_choice"),
        (["--glb", "--ktx2", "--webp"], "cli.bad_choice"),
        (["--glb", "--env", "sky.exr"], "cli.bad_choice"),
        (["--glb", "--tier", "lite"], "cli.bad_choice"),
        (["--glb", "--mesh", "edited.glb"], "cli.bad_choice"),
        (["--mitsuba", "--env-axes", "nothing", "--env", "sky.exr"], "cli.bad_choice"),
    ],
)
def test_options_that_do_not_belong_together_are_refused(bundle, tmp_path, capsys, words, code):
    assert app.run(["export", str(bundle), "-o", str(tmp_path / "out"), "--json", *words]) == 2
    assert fault(capsys) == code
    assert not (tmp_path / "out").exists()


def test_without_formats_the_worker_writes_the_bundle_of_a_run(monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(EntryPoint, "load", lambda self: lambda **given: calls.append((self.name, given)))
    assert (
        app.run(["export", str(tmp_path), "-o", str(tmp_path / "b"), "--tier", "lite", "--faces", "900"]) == 0
    )
    ((name, given),) = calls
    assert name == "export"
    assert given == {
        "run_dir": tmp_path,
        "out": tmp_path / "b",
        "tier": "lite",
        "weights": "",
        "mesh": None,
        "faces": "900",
        "atlas": "",
        "as_json": False,
    }


def test_without_the_worker_a_bundle_cannot_be_made_of_a_run(monkeypatch, tmp_path, capsys):
    def load(self):
        raise ModuleNotFoundError("no module", name="torch")

    monkeypatch.setattr(EntryPoint, "load", load)
    assert app.run(["export", str(tmp_path), "-o", str(tmp_path / "b")]) == 2
    assert "lambent[worker]" in capsys.readouterr().err


def test_the_blender_script_is_printed_as_it_is(capsys):
    assert app.run(["blender"]) == 0
    text = capsys.readouterr().out
    compile(text, "blender_import.py", "exec")
    assert "bpy.ops.import_scene.gltf" in text


def test_a_bundle_is_written_into_the_blender_script(bundle, tmp_path):
    (tmp_path / "sky.hdr").write_bytes(b"")
    words = ["--env", str(tmp_path / "sky.hdr"), "--rotate-deg", "-30", "--view", "2"]
    assert app.run(["blender", str(bundle), "-o", str(tmp_path / "open.py"), *words]) == 0
    script = {"__name__": "script"}
    exec(compile((tmp_path / "open.py").read_text(), "open.py", "exec"), script)
    found = script["arguments_of"](["blender", "--python", "open.py"])
    assert found.bundle == bundle.resolve()
    assert (found.env, found.rotate_deg, found.view) == ((tmp_path / "sky.hdr").resolve(), -30.0, 2)


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["{tmp}"], "bundle.missing"),
        (["{bundle}", "--env", "{tmp}/none.exr"], "environment.missing"),
        (["--view", "2"], "cli.bad_choice"),
    ],
)
def test_a_blender_script_that_could_not_work_is_refused(bundle, tmp_path, capsys, words, code):
    given = [word.format(tmp=tmp_path, bundle=bundle) for word in words]
    assert app.run(["blender", *given, "--json"]) == 2
    assert fault(capsys) == code

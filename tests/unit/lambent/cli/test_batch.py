"""lambent batch: the files that come out, what is kept, what is listed, and what is refused."""

import json
import shutil

import numpy as np
import OpenEXR
import pytest
from lambent_core.errors import SettingError
from lambent_relight import Renderer, cameras_json, load_bundle, turntable, write_environment
from lambent_relight.batch import plan as plan_module
from lambent_relight.batch.plan import make_plan
from lambent_relight.batch.reading import read_manifest
from lambent_relight.object_cameras import around_object
from PIL import Image
from support.small_batch import HEAD, ONE_PICTURE, SMALL, batch, pixels, rgb_of, states, table, write_inputs


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a bundle of one grey ball, two maps, and nothing else."""
    return write_inputs(tmp_path)


def test_a_batch_is_assets_times_environments_times_cameras_times_qualities(folder):
    text = """
schema: lambent-batch/1
assets: [ball, {name: red, bundle: ball, material: {albedo: [0.9, 0.0, 0.0]}}]
environments: [sky.exr, {map: lamp.exr, rotate_deg: [0, 90]}]
cameras: [{turntable: 1, size: 8}, {name: own, views: [turntable_002]}]
qualities: [{name: a, spp: 2, antialias: 1}, {name: b, spp: 4, antialias: 1, background: white}]
"""
    assert batch(folder, text) == 0
    lines = table(folder)
    assert len(lines) == 2 * 3 * 2 * 2
    assert {line["state"] for line in lines.values()} == {"made"}
    line = lines["red/lamp_90/b/own_turntable_002"]
    assert (line["width"], line["asset"], line["environment"]) == ("16", "red", "lamp_90")
    assert float(line["seconds"]) > 0
    assert float(line["relative_standard_error"]) > 0
    with Image.open(folder / "out" / line["png"]) as image:
        assert image.mode == "RGB", "white is behind the object"
    names = ("ball", "red")
    shown = {name: pixels(folder / "out" / lines[f"{name}/sky/a/turntable_000"]["png"]) for name in names}
    red_minus_blue = {name: (p[2:6, 2:6, 0].astype(int) - p[2:6, 2:6, 2]).mean() for name, p in shown.items()}
    assert red_minus_blue["ball"] < 0 < red_minus_blue["red"]
    assert sorted(path.name for path in (folder / "out").iterdir() if path.is_file()) == [
        ".lambent-batch.lock",
        "contact_sheet.png",
        "pictures.csv",
        "pictures.jsonl",
    ]


def test_a_picture_of_a_batch_is_the_one_that_the_renderer_makes(folder):
    text = """
schema: lambent-batch/1
assets: [{bundle: ball, object_rotate_deg: 20, material: {albedo_gain: [0.5, 1, 1], roughness_scale: 2}}]
environments: [{map: lamp.exr, axes: skylibs, rotate_deg: 40, sun_clamp: 2}]
cameras: [{turntable: 1, size: 12, elevation_deg: 40, radius: 3, field_of_view_deg: 50, start_deg: 70}]
settings: {spp: 4, antialias: 1, seed: 5, indirect: false, exposure_ev: 1, tone_mapping: agx}
output: {half: false, passes: [direct, normal]}
"""
    assert batch(folder, text) == 0
    from lambent_relight.edits import MaterialEdit
    from lambent_relight.environment.input import EnvironmentInput, open_environment
    from lambent_relight.images import encode_png

    light = open_environment(folder / "lamp.exr", EnvironmentInput(axes="skylibs", sun_clamp=2.0))
    bundle = load_bundle(folder / "ball")
    (camera,) = around_object(
        bundle, 1, size=12, elevation_deg=40.0, radius=3.0, field_of_view_deg=50.0, start_deg=70.0
    )
    expected = Renderer(bundle).render(
        camera,
        light.environment,
        rotate_deg=40.0,
        spp=4,
        antialias=1,
        seed=5,
        indirect=False,
        edit=MaterialEdit(albedo_gain=(0.5, 1.0, 1.0), roughness_scale=2.0),
        object_rotate_deg=20.0,
    )
    base = folder / "out" / "ball" / "lamp" / "refined" / "turntable_000"
    part = OpenEXR.File(str(base.with_suffix(".exr")), separate_channels=True).parts[0]
    layers = {
        f"{name}.{letter}" for name, letters in (("direct", "RGB"), ("normal", "XYZ")) for letter in letters
    }
    assert set(part.channels) == {*"RGBA"} | layers
    np.testing.assert_allclose(
        part.channels["G"].pixels, (expected.rgb * expected.opacity)[..., 1], rtol=1e-6, atol=1e-7
    )
    np.testing.assert_array_equal(
        pixels(base.with_suffix(".png")), encode_png(expected.exposed(1.0), tone_mapping="agx")
    )
    assert len(part.header["lambent:bundle"]) == 64


def test_run_again_it_makes_only_what_is_missing_or_changed(folder):
    assert batch(folder, SMALL) == 0
    assert set(states(folder).values()) == {"made"}
    before = {path: path.stat().st_mtime_ns for path in (folder / "out").rglob("turntable*")}
    assert batch(folder, SMALL) == 0
    assert set(states(folder).values()) == {"kept"}
    assert before == {path: path.stat().st_mtime_ns for path in (folder / "out").rglob("turntable*")}
    (folder / "out/ball/sky/refined/turntable_001.exr").unlink()
    (folder / "out/ball/sky/refined/turntable_000.png").write_bytes(b"scribbled over")
    assert batch(folder, SMALL) == 0
    assert set(states(folder).values()) == {"made"}
    assert pixels(folder / "out/ball/sky/refined/turntable_000.png").shape == (8, 8, 4)


@pytest.mark.parametrize(
    "change",
    [
        lambda text, folder: text.replace("spp: 2", "spp: 3"),
        lambda text, folder: text.replace("size: 8", "size: 9"),
        lambda text, folder: text.replace("[sky.exr]", "[{map: sky.exr, axes: mitsuba}]"),
        lambda text, folder: text.replace("[ball]", "[{bundle: ball, material: {roughness_scale: 0.5}}]"),
        lambda text, folder: (write_environment(folder / "sky.exr", np.ones((8, 16, 3), np.float32)), text)[
            1
        ],
        lambda text, folder: text + "output: {half: false}\n",
    ],
)
def test_changed_inputs_are_rendered_again(folder, change):
    assert batch(folder, SMALL) == 0
    assert batch(folder, change(SMALL, folder)) == 0
    assert set(states(folder).values()) == {"made"}


def test_a_file_whose_hash_is_known_under_another_name_is_copied(folder):
    assert batch(folder, SMALL) == 0
    assert batch(folder, SMALL.replace("[sky.exr]", "[{name: heaven, map: sky.exr}]")) == 0
    assert states(folder) == dict.fromkeys(
        ["ball/heaven/refined/turntable_000", "ball/heaven/refined/turntable_001"], "copied"
    )
    same = [folder / f"out/ball/{name}/refined/turntable_001.png" for name in ("sky", "heaven")]
    assert same[0].read_bytes() == same[1].read_bytes()


def test_maps_that_swap_their_names_swap_their_pictures(folder):
    text = SMALL.replace("[sky.exr]", "[{name: a, map: sky.exr}, {name: b, map: lamp.exr}]")
    assert batch(folder, text) == 0
    place = folder / "out/ball"
    before = {name: (place / name / "refined/turntable_000.png").read_bytes() for name in "ab"}
    assert (
        batch(folder, SMALL.replace("[sky.exr]", "[{name: b, map: sky.exr}, {name: a, map: lamp.exr}]")) == 0
    )
    assert (place / "b/refined/turntable_000.png").read_bytes() == before["a"]
    assert (place / "a/refined/turntable_000.png").read_bytes() == before["b"]


def test_rows_that_fail_are_listed_and_stop_no_others(folder, capsys):
    (folder / "bad.exr").write_bytes(b"no picture")
    text = SMALL.replace("[sky.exr]", "\n- bad.exr\n- sky.exr\n- gone.exr\n").replace(
        "[ball]", "[lost, ball]"
    )
    assert batch(folder, text) == 1
    err = capsys.readouterr().err
    found = states(folder)
    assert found["ball/sky/refined/turntable_001"] == "made"
    assert {name for name, state in found.items() if state == "failed"} == {
        "lost/*",
        *(f"ball/{light}/refined/turntable_00{n}" for light in ("bad", "gone") for n in (0, 1)),
    }
    assert "failed lost/*: bundle." in err
    assert "environment.missing" in err
    assert "(m.yaml:6)" in err, "the line of gone.exr"
    lines = table(folder)
    assert lines["ball/bad/refined/turntable_000"]["code"].startswith("environment.")


def test_a_dry_run_lists_the_work_and_renders_nothing(folder, capsys):
    assert batch(folder, SMALL, "--dry-run") == 0
    out = capsys.readouterr().out
    assert "make png,exr" in out
    assert "2 to make, 0 to keep, 0 cannot be made" in out
    assert not list((folder / "out").rglob("*.png"))
    assert batch(folder, SMALL) == 0
    (folder / "out/ball/sky/refined/turntable_000.png").unlink()
    capsys.readouterr()
    assert batch(folder, SMALL, "--dry-run", "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[0] == {"picture": "ball/sky/refined/turntable_000", "files": ["png"]}
    assert lines[-1]["to_make"] == 1


def test_pictures_of_a_batch_go_on_until_they_are_as_quiet_as_asked(folder):
    text = HEAD.replace("sky", "lamp") + (
        "cameras: [{turntable: 1, size: 8}]\nsettings: {spp: 4, antialias: 1}\n"
        "qualities: [{name: quick}, {name: quiet, until_stderr: 0.05}]\n"
    )
    assert batch(folder, text) == 0
    quick, quiet = (table(folder)[f"ball/lamp/{name}/turntable_000"] for name in ("quick", "quiet"))
    assert float(quiet["relative_standard_error"]) <= 0.05 < float(quick["relative_standard_error"])
    assert int(quiet["num_samples"]) > int(quick["num_samples"])


def test_a_dry_run_writes_nothing(folder, capsys):
    assert batch(folder, SMALL, "--dry-run") == 0
    assert not (folder / "out").exists()
    assert batch(folder, SMALL) == 0
    journal = folder / "out" / "pictures.jsonl"
    journal.write_text(journal.read_text() + '{"half a line')

    def on_disk():
        stats = {path: path.stat() for path in (folder / "out").rglob("*")}
        return {path: (stat.st_mtime_ns, stat.st_ino) for path, stat in stats.items()}

    before = on_disk()
    capsys.readouterr()
    assert batch(folder, SMALL, "--dry-run") == 0
    assert "0 to make, 2 to keep" in capsys.readouterr().out
    assert on_disk() == before


def test_a_bundle_and_a_map_are_read_once_for_a_plan_however_often_they_are_used(folder, monkeypatch):
    opened, hashed = [], []
    document = ONE_PICTURE | {
        "assets": ["ball", {"name": "red", "bundle": "ball", "material": {"albedo": [0.9, 0, 0]}}],
        "environments": [{"map": "sky.exr", "rotate_deg": [0, 90, 180]}],
        "cameras": [{"turntable": 2, "size": 8}],
    }
    sha256 = plan_module.file_sha256
    monkeypatch.setattr(plan_module, "file_sha256", lambda path: hashed.append(path) or sha256(path))
    plan = make_plan(
        read_manifest(document, folder), opening=lambda path: opened.append(path) or load_bundle(path)
    )
    assert len(plan.rows) == 2 * 3 * 2
    assert (opened, hashed) == ([folder / "ball"], [folder / "sky.exr"])


def test_problems_of_a_manifest_come_with_their_lines_and_exit_code_two(folder, capsys):
    assert batch(folder, HEAD + "cameras:\n  - turntable: -1\n    size: big\ncolour: 1\n") == 2
    err = capsys.readouterr().err
    assert "m.yaml:5: turntable: -1 is not from 0 to 10000" in err
    assert "m.yaml:6: size" in err
    assert "m.yaml:7: there is no 'colour'" in err
    assert not (folder / "out").exists()


def test_cameras_with_one_name_are_refused(folder, capsys):
    assert batch(folder, SMALL.replace("[{turntable: 2, size: 8}]", "[{turntable: 1}, {turntable: 2}]")) == 2
    assert "batch.same_name" in capsys.readouterr().err


def test_a_camera_whose_picture_would_be_the_contact_sheet_is_refused(folder, capsys):
    (folder / "c.json").write_text(
        cameras_json(turntable(1, radius=3.0, width=8, height=8)).replace("turntable_000", "Contact_Sheet_2")
    )
    text = HEAD + 'cameras: [c.json]\nsettings: {spp: 2}\noutput: {path: "{camera}"}\n'
    assert batch(folder, text) == 2
    assert "which is the contact sheet" in capsys.readouterr().err


def test_two_processes_make_the_same_pictures_as_one(folder):
    text = SMALL.replace("turntable: 2", "turntable: 5")
    assert batch(folder, text) == 0
    one = {path.name: path.read_bytes() for path in (folder / "out/ball/sky/refined").glob("*.png")}
    (folder / "out").rename(folder / "one")
    assert batch(folder, text, "--jobs", "2") == 0
    two = {path.name: path.read_bytes() for path in (folder / "out/ball/sky/refined").glob("*.png")}
    assert one == two
    assert len(two) == 5


def test_more_pictures_than_can_be_meant_are_refused(folder, monkeypatch):
    monkeypatch.setattr("lambent_relight.batch.plan.MAX_PICTURES", 3)
    with pytest.raises(SettingError, match=r"batch\.too_many"):
        make_plan(read_manifest(ONE_PICTURE | {"cameras": [{"turntable": 4}]}, folder))


def test_lights_that_swap_names_keep_no_file_of_each_other(folder):
    """A new exposure asks for new PNGs alone, while the EXRs of each light lie under the other's name."""

    def made(one: str, other: str, exposure_ev: float) -> dict[str, bytes]:
        text = (
            "schema: lambent-batch/1\nassets: [ball]\ncameras: [{turntable: 1, size: 8}]\n"
            "output: {files: [png, exr]}\n"
            f"environments: [{{name: a, map: {one}}}, {{name: b, map: {other}}}]\n"
            f"settings: {{spp: 2, antialias: 1, exposure_ev: {exposure_ev}}}\n"
        )
        assert batch(folder, text) == 0
        return {str(path): rgb_of(path) for path in (folder / "out/ball").rglob("*.*")}

    made("sky.exr", "lamp.exr", 0.0)
    swapped = made("lamp.exr", "sky.exr", 1.0)
    shutil.rmtree(folder / "out")
    anew = made("lamp.exr", "sky.exr", 1.0)
    assert swapped.keys() == anew.keys()
    assert len(anew) == 4
    assert all(np.array_equal(swapped[name], anew[name]) for name in anew)

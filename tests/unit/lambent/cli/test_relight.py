"""relight and turntable: the files that come out, what is kept, and what is refused."""

import json

import numpy as np
import OpenEXR
import pytest
from lambent.cli import app
from lambent_relight import Renderer, cameras_json, turntable, write_environment
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere


@pytest.fixture
def bundle(tmp_path):
    """Return a bundle of one grey ball."""
    return write_analytic_bundle(tmp_path / "ball", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))


@pytest.fixture
def sky(tmp_path):
    """Return a map that shines from +z only."""
    radiance = np.zeros((8, 16, 3), np.float32)
    radiance[:4] = (0.2, 0.4, 0.6)
    write_environment(tmp_path / "sky.exr", radiance)
    return tmp_path / "sky.exr"


def relight(bundle, sky, out, *words):
    return app.run(["relight", str(bundle), "--env", str(sky), "-o", str(out), "--spp", "8", *words])


def test_a_turntable_writes_png_and_linear_exr_for_every_view(bundle, sky, tmp_path):
    assert relight(bundle, sky, tmp_path / "out", "--turntable", "2", "--size", "12") == 0
    assert sorted(path.name for path in (tmp_path / "out" / "sky").iterdir()) == [
        "turntable_000.exr",
        "turntable_000.png",
        "turntable_001.exr",
        "turntable_001.png",
    ]
    with Image.open(tmp_path / "out/sky/turntable_000.png") as image:
        assert image.size == (12, 12)
        assert image.mode == "RGBA"
        top, bottom = np.asarray(image)[3, 6], np.asarray(image)[9, 6]
    assert top[:3].sum() > bottom[:3].sum(), "the light comes from above"
    assert top[2] > top[0], "and is blue"


def test_exposure_brightens_the_png_and_leaves_the_exr(bundle, sky, tmp_path):
    pixels = {}
    for stops in ("0", "1"):
        out = tmp_path / stops
        assert relight(bundle, sky, out, "--turntable", "1", "--size", "8", "--exposure-ev", stops) == 0
        with OpenEXR.File(str(out / "sky/turntable_000.exr"), separate_channels=True) as file:
            linear = file.parts[0].channels["B"].pixels.copy()
        pixels[stops] = (np.asarray(Image.open(out / "sky/turntable_000.png")).astype(int), linear)
    assert pixels["1"][0][2, 4, 2] > pixels["0"][0][2, 4, 2]
    np.testing.assert_array_equal(pixels["1"][1], pixels["0"][1])


@pytest.mark.parametrize(("word", "dtype"), [("--half", np.float16), ("--float", np.float32)])
def test_colour_is_half_or_float_as_asked_and_depth_is_float(bundle, sky, tmp_path, word, dtype):
    assert relight(bundle, sky, tmp_path / "out", "--turntable", "1", "--size", "8", word) == 0
    with OpenEXR.File(str(tmp_path / "out/sky/turntable_000.exr"), separate_channels=True) as file:
        channels = file.parts[0].channels
        assert channels["R"].pixels.dtype == dtype
        depth, distance = channels["Z"].pixels, channels["distance.V"].pixels
    assert depth.dtype == distance.dtype == np.float32
    assert depth[0, 0] == distance[0, 0] == np.float32(1e10), "nothing is in the corner"
    assert 0.0 < depth[4, 4] < distance[4, 4] < 100.0


def test_cameras_come_from_a_file_and_keep_their_names(bundle, sky, tmp_path):
    (view,) = turntable(1, radius=4.0, width=6, height=4)
    (tmp_path / "views.json").write_text(cameras_json([view]))
    assert relight(bundle, sky, tmp_path / "out", "--cameras", str(tmp_path / "views.json")) == 0
    with Image.open(tmp_path / "out/sky/turntable_000.png") as image:
        assert image.size == (6, 4)


def test_run_again_it_makes_only_what_is_missing_or_changed(bundle, sky, tmp_path, capsys):
    out = tmp_path / "out"
    words = ("--turntable", "2", "--size", "6", "--json")

    def made(*more):
        capsys.readouterr()
        assert relight(bundle, sky, out, *words, *more) == 0
        return json.loads(capsys.readouterr().out)["made"]

    assert made() == 2
    assert made() == 0
    (out / "sky/turntable_001.exr").unlink()
    assert made() == 1
    assert made("--rotate-deg", "90") == 2
    write_environment(sky, np.ones((8, 16, 3), np.float32))
    assert made("--rotate-deg", "90") == 2
    assert not list(out.rglob(".partial*"))


@pytest.mark.parametrize("command", ["relight", "turntable"])
def test_exposure_alone_renders_nothing_and_another_renderer_everything(
    bundle, sky, tmp_path, monkeypatch, capsys, command
):
    rendered, render = [], Renderer.render
    monkeypatch.setattr(
        Renderer, "render", lambda *given, **more: (rendered.append(1), render(*given, **more))[1]
    )
    views = ("--turntable", "2") if command == "relight" else ("--frames", "2", "--format", "none")

    def run(*more):
        words = (command, str(bundle), "--env", str(sky), "-o", str(tmp_path / "out"), *views)
        rendered.clear()
        assert app.run([*words, "--size", "6", "--spp", "4", "--json", *more]) == 0
        made = json.loads(capsys.readouterr().out.splitlines()[0])["made"]
        return len(rendered), made, [path.read_bytes() for path in sorted((tmp_path / "out").rglob("*.png"))]

    first = run()
    assert first[:2] == (2, 2)
    brighter = run("--exposure-ev", "1", "--background", "environment")
    assert brighter[:2] == (0, 2)
    assert brighter[2] != first[2]
    assert run("--exposure-ev", "1", "--background", "environment")[:2] == (0, 0)
    monkeypatch.setattr("lambent_relight.batch.plan.renderer_digest", lambda: "another version")
    assert run()[:2] == (2, 2)


def test_pictures_of_another_bundle_or_an_older_version_are_never_kept(bundle, sky, tmp_path, capsys):
    """Older versions listed their pictures in pictures.json and looked no further."""
    out = tmp_path / "out"
    other = write_analytic_bundle(tmp_path / "other", AnalyticScene([Sphere((0.0, 0.0, 0.0), 0.7)]))
    assert relight(other, sky, out, "--turntable", "1", "--size", "8") == 0
    shown = out / "sky/turntable_000.png"
    before = shown.read_bytes()
    assert relight(bundle, sky, out, "--turntable", "1", "--size", "8") == 0
    assert shown.read_bytes() != before
    right = shown.read_bytes()
    shown.write_bytes(before)
    (out / "pictures.jsonl").unlink()
    assert relight(bundle, sky, out, "--turntable", "1", "--size", "8") == 0
    assert shown.read_bytes() == right
    assert "made 1/1 sky/turntable_000" in capsys.readouterr().err


def test_what_was_measured_is_in_the_list_of_pictures(bundle, sky, tmp_path):
    relight(bundle, sky, tmp_path / "out", "--turntable", "1", "--size", "6")
    (record,) = json.loads((tmp_path / "out/pictures.json").read_text())["pictures"]
    assert record["files"] == ["sky/turntable_000.png", "sky/turntable_000.exr"]
    assert record["mean_standard_error"] > 0
    assert record["num_samples"] >= 8


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("--turntable", "1", "--quality", "best"), "cli.bad_choice"),
        (("--turntable", "1", "--quality", "baked"), "relight.quality_unsupported"),
        (("--turntable", "1", "--roughness-scale", "-1"), "--roughness-scale: -1.0 is not from 0"),
        (("--turntable", "1", "--albedo", "2", "0", "0"), "--albedo: 2.0 is not from 0 to 1"),
        (("--turntable", "1", "--until-stderr", "2"), "--until-stderr: 2.0 is not from 0 to 0.999"),
        (("--turntable", "1", "--until-stderr", "-0.02"), "--until-stderr: -0.02 is not from 0 to 0.999"),
        (("--turntable", "1", "--until-stderr", "nan"), "from 0 to 0.999 is expected, not nan"),
        (("--turntable", "1", "--spp", "0"), "--spp: 0 is not from 2 to 65536"),
        (("--turntable", "1", "--spp", "-8"), "--spp: -8 is not from 2 to 65536"),
        (("--turntable", "1", "--background", "pink"), "cli.bad_choice"),
        (("--turntable", "1", "--tone-mapping", "filmic"), "cli.bad_choice"),
        ((), "cli.cameras"),
        (("--turntable", "1", "--cameras", "x.json"), "cli.cameras"),
        (("--cameras", "missing.json"), "camera.file_missing"),
    ],
)
def test_what_cannot_be_done_exits_with_two_and_a_code(bundle, sky, tmp_path, capsys, words, code):
    assert relight(bundle, sky, tmp_path / "out", *words) == 2
    assert code in capsys.readouterr().err


def test_a_missing_map_and_a_missing_bundle_are_named(bundle, sky, tmp_path, capsys):
    assert relight(bundle, tmp_path / "no.exr", tmp_path / "out", "--turntable", "1") == 2
    assert "no.exr" in capsys.readouterr().err
    assert relight(tmp_path / "nowhere", sky, tmp_path / "out", "--turntable", "1") == 2
    assert "bundle.missing" in capsys.readouterr().err


def test_a_damaged_bundle_exits_with_one(bundle, sky, tmp_path, capsys):
    weights = bundle / "models" / "weights.bin"
    data = bytearray(weights.read_bytes())
    data[0] ^= 1
    weights.write_bytes(bytes(data))
    assert relight(bundle, sky, tmp_path / "out", "--turntable", "1") == 1
    assert "bundle." in capsys.readouterr().err


@pytest.mark.parametrize("turn", ["camera", "light"])
def test_a_turntable_is_an_animation_of_one_turn(bundle, sky, tmp_path, turn):
    words = ["turntable", str(bundle), "--env", str(sky), "-o", str(tmp_path), "--turn", turn]
    assert app.run([*words, "--frames", "3", "--size", "8", "--spp", "8", "--fps", "10"]) == 0
    with Image.open(tmp_path / "turntable.webp") as film:
        assert film.n_frames == 3
        assert film.size == (8, 8)


def turntable_frames(bundle, sky, out, *words):
    """Return the frames of a film of two views, 8-bit."""
    start = ["turntable", str(bundle), "--env", str(sky), "-o", str(out), "--frames", "2", "--size", "8"]
    assert app.run([*start, "--spp", "8", *words]) == 0
    return [np.asarray(Image.open(out / f"frames/{index:04d}.png")).astype(int) for index in range(2)]


def test_a_turntable_reads_maps_of_other_layouts_and_turns_them(bundle, tmp_path):
    """A light at one azimuth: other axes move it by a quarter turn, which --rotate-deg undoes."""
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[6:10, 14:18] = 20.0
    write_environment(tmp_path / "lamp.exr", radiance)
    plain = turntable_frames(bundle, tmp_path / "lamp.exr", tmp_path / "a")
    skylibs = turntable_frames(bundle, tmp_path / "lamp.exr", tmp_path / "b", "--env-axes", "skylibs")
    back = ("--env-axes", "skylibs", "--rotate-deg", "-90")
    undone = turntable_frames(bundle, tmp_path / "lamp.exr", tmp_path / "c", *back)
    assert np.abs(skylibs[0] - plain[0]).max() > 50
    assert np.abs(undone[0] - plain[0]).max() <= 30
    assert np.abs(undone[0] - plain[0]).mean() < 0.1 * np.abs(skylibs[0] - plain[0]).mean()


def test_a_turntable_clamps_the_sun_and_repairs_the_map(bundle, tmp_path, capsys):
    radiance = np.ones((8, 16, 3), np.float32)
    radiance[2, 8] = 1000.0
    radiance[5, 3] = np.nan
    write_environment(tmp_path / "sun.exr", radiance)
    start = ["turntable", str(bundle), "--env", str(tmp_path / "sun.exr"), "-o", str(tmp_path / "no")]
    assert app.run([*start, "--frames", "2"]) == 2
    assert "environment.unusable_values" in capsys.readouterr().err
    bright = turntable_frames(bundle, tmp_path / "sun.exr", tmp_path / "a", "--mend-env")
    dim = turntable_frames(bundle, tmp_path / "sun.exr", tmp_path / "b", "--mend-env", "--sun-clamp", "1")
    assert "sun clamp" in capsys.readouterr().err
    assert dim[0].mean() < bright[0].mean()
    assert app.run([*start, "--env-axes", "unreal"]) == 2

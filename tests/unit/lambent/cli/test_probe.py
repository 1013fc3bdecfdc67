"""probe, and the options that say how a map is to be understood."""

import json

import numpy as np
import OpenEXR
import pytest
from lambent.cli import app
from lambent_relight import load_environment, write_environment
from lambent_relight.environment.axes import from_axes
from lambent_relight.environment.maps import environment_from_array
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere


@pytest.fixture
def sky(tmp_path):
    """Return a map that is bright around +y."""
    radiance = np.full((64, 128, 3), 0.1, np.float32)
    radiance[30:33, 31:33] = (40.0, 20.0, 10.0)
    write_environment(tmp_path / "sky.exr", radiance, half=False)
    return tmp_path / "sky.exr"


def test_a_probe_writes_balls_map_and_figures(sky, tmp_path, capsys):
    out = tmp_path / "out"
    assert app.run(["probe", str(sky), "-o", str(out), "--size", "32", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    report = json.loads((out / "probe.json").read_text())
    assert printed["dominant_lights"] == report["dominant_lights"]
    (light,) = report["dominant_lights"]
    assert light["azimuth_deg"] == pytest.approx(90.0, abs=2.0)
    assert report["brightest"] == 40.0
    assert report["sun_clamp"] is None
    with Image.open(out / "grey_ball.png") as image:
        ball = np.asarray(image).astype(int)
    assert ball.shape == (32, 32, 4)
    assert ball[16, 26, 0] > ball[16, 5, 0], "+y is on the right"
    with Image.open(out / "map.png") as image:
        assert image.size == (64, 32)
    np.testing.assert_allclose(
        load_environment(out / "environment.exr").radiance, load_environment(sky).radiance
    )


def test_a_clamp_is_reported_and_applied(sky, tmp_path, capsys):
    out = tmp_path / "out"
    assert app.run(["probe", str(sky), "-o", str(out), "--size", "8", "--sun-clamp", "4"]) == 0
    assert "6 texels" in capsys.readouterr().err
    report = json.loads((out / "probe.json").read_text())["sun_clamp"]
    assert report["num_texels"] == 6
    assert 0.1 < report["share_lost"] < 0.3
    assert load_environment(out / "environment.exr").radiance.max() == pytest.approx(4.0)


def test_relight_reads_maps_of_other_programs_and_tells_what_it_did(sky, tmp_path):
    bundle = write_analytic_bundle(tmp_path / "ball", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))
    # Turned the other way, which is how a map of skylibs becomes ours.
    theirs = from_axes(load_environment(sky), "skylibs")
    write_environment(tmp_path / "theirs" / "sky.exr", theirs.radiance, half=False)
    pixels = []
    for path, axes in ((sky, "blender"), (tmp_path / "theirs/sky.exr", "mitsuba")):
        out = tmp_path / axes
        words = ["--turntable", "1", "--size", "12", "--spp", "8", "--sun-clamp", "20", "--env-axes", axes]
        assert app.run(["relight", str(bundle), "--env", str(path), "-o", str(out), *words]) == 0
        with OpenEXR.File(str(out / "sky/turntable_000.exr"), separate_channels=True) as file:
            pixels.append(file.parts[0].channels["R"].pixels.copy())
        (record,) = json.loads((out / "pictures.json").read_text())["pictures"]
        assert "sun clamp: 6 texels" in record["environment_notes"][0]
    np.testing.assert_array_equal(pixels[0], pixels[1])
    assert pixels[0].max() > 0.0


def test_unusable_values_are_refused_and_replaced_on_request(tmp_path, capsys):
    image = np.ones((4, 8, 3), np.float32)
    image[1, 2, 0] = np.nan
    channels = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGB")}
    OpenEXR.File({}, channels).write(str(tmp_path / "bad.exr"))
    words = ["probe", str(tmp_path / "bad.exr"), "-o", str(tmp_path / "out"), "--size", "8"]
    assert app.run(words) == 2
    assert "environment.unusable_values" in capsys.readouterr().err
    assert app.run([*words, "--mend-env"]) == 0
    assert "replaced 1 NaN" in capsys.readouterr().err
    repaired = load_environment(tmp_path / "out/environment.exr")
    expected = environment_from_array(image, mend=True)
    np.testing.assert_array_equal(repaired.radiance, expected.radiance)


@pytest.mark.parametrize("words", [("--env-axes", "maya"), ("--sun-clamp", "-3"), ("--sun-clamp", "nan")])
def test_senseless_options_exit_with_two(sky, tmp_path, capsys, words):
    assert app.run(["probe", str(sky), "-o", str(tmp_path / "out"), *words]) == 2
    assert "cli.bad_choice" in capsys.readouterr().err

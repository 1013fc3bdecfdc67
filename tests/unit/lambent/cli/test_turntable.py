"""turntable: films and folders of one turn, decoded again, and what is refused."""

import gc
import json

import numpy as np
import pytest
from lambent.cli import app
from lambent.cli.turntable import shots_of_turn
from lambent_relight import Renderer, load_bundle, load_environment, write_environment
from lambent_relight.batch.manifest import Light
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Box, Surface
from support.films import decoded

# imageio-ffmpeg leaves its pipes to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")
RED = Surface(albedo=(0.7, 0.1, 0.1), perceptual_roughness=0.8)
BLUE = Surface(albedo=(0.1, 0.1, 0.7), perceptual_roughness=0.8)


@pytest.fixture(autouse=True, scope="module")
def collected():
    """Collect garbage before the next file's tests, whose warnings are errors."""
    yield
    gc.collect()


@pytest.fixture
def bundle(tmp_path):
    """Return a bundle of two boxes, red at +x and blue at -x."""
    boxes = [Box((0.3, -0.4, -0.4), (1.0, 0.4, 0.4), RED), Box((-1.0, -0.4, -0.4), (-0.3, 0.4, 0.4), BLUE)]
    return write_analytic_bundle(tmp_path / "boxes", AnalyticScene(boxes))


@pytest.fixture
def sky(tmp_path):
    """Return a map that is bright around +x."""
    radiance = np.full((8, 16, 3), 0.3, np.float32)
    radiance[2:6, 6:10] = 3.0
    write_environment(tmp_path / "sky.exr", radiance, half=False)
    return tmp_path / "sky.exr"


def turntable(bundle, sky, out, *words):
    return app.run(["turntable", str(bundle), "--env", str(sky), "-o", str(out), "--spp", "8", *words])


@pytest.mark.parametrize("suffix", ["mp4", "webm"])
def test_a_film_has_the_pictures_of_the_folder(bundle, sky, tmp_path, suffix):
    film = tmp_path / "out" / f"spin.{suffix}"
    words = ("--frames", "4", "--size", "31", "--fps", "8", "--tone-mapping", "neutral")
    assert turntable(bundle, sky, film, *words, "--crf", "2") == 0
    assert [path.name for path in film.parent.iterdir()] == [film.name]
    found = decoded(film)
    assert (len(found.frames), found.size, found.fps) == (4, (32, 32), pytest.approx(8.0))
    assert turntable(bundle, sky, tmp_path / "frames", *words, "--format", "none") == 0
    pictures = sorted((tmp_path / "frames" / "frames").iterdir())
    assert [path.name for path in pictures] == ["0000.png", "0001.png", "0002.png", "0003.png"]
    assert not list((tmp_path / "frames").glob("turntable.*"))
    for frame, path in zip(found.frames, pictures, strict=True):
        with Image.open(path) as image:
            expected = np.asarray(image.convert("RGB")).astype(int)
        # Brightness has full resolution; colour is shared by four pixels.
        difference = np.abs(frame[:31, :31].mean(-1) - expected.mean(-1))
        assert difference.mean() < 2.0
        assert np.abs(frame[:31, :31] - expected).mean() < 6.0
    assert np.abs(found.frames[0] - found.frames[1]).mean() > 4.0


def test_probes_stand_in_the_corner_of_a_film_and_of_single_pictures(bundle, sky, tmp_path):
    words = ("--frames", "2", "--size", "64", "--fps", "8", "--turn", "light", "--background", "white")
    assert turntable(bundle, sky, tmp_path / "plain", *words, "--format", "none") == 0
    assert turntable(bundle, sky, tmp_path / "balls", *words, "--format", "none", "--probes") == 0
    assert turntable(bundle, sky, tmp_path / "spin.mp4", *words, "--crf", "2", "--probes") == 0
    frames = decoded(tmp_path / "spin.mp4").frames
    for number in range(2):
        shown = {}
        for name in ("plain", "balls"):
            with Image.open(tmp_path / name / "frames" / f"{number:04d}.png") as image:
                shown[name] = np.asarray(image).astype(int)
        changed = np.argwhere(np.abs(shown["balls"] - shown["plain"]).max(axis=-1) > 0)
        assert changed.min(axis=0)[0] >= 64 - 1 - 9
        assert changed.max(axis=0)[1] < 1 + 9 + 1 + 9
        assert np.abs(frames[number].mean(-1) - shown["balls"].mean(-1)).mean() < 2.0
    balls = [frame[54:63, 1:20] for frame in frames]
    assert np.abs(balls[0] - balls[1]).mean() > 4.0, "the balls show that the light turned"


def test_a_folder_can_hold_a_film_too_and_goes_on_where_it_was(bundle, sky, tmp_path, capsys):
    words = ("--frames", "3", "--size", "16", "--format", "mp4", "--json")
    assert turntable(bundle, sky, tmp_path / "out", *words) == 0
    capsys.readouterr()
    (tmp_path / "out/frames/0001.png").unlink()
    assert turntable(bundle, sky, tmp_path / "out", *words) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[0]["made"] == 1
    assert lines[-1] == {"film": str(tmp_path / "out/turntable.mp4"), "frames": 3, "fps": 24}
    assert len(decoded(tmp_path / "out/turntable.mp4").frames) == 3


def test_seconds_times_pictures_per_second_are_the_number_of_pictures(bundle, sky, tmp_path):
    film = tmp_path / "s.mp4"
    assert (
        turntable(bundle, sky, film, "--seconds", "0.5", "--fps", "10", "--size", "8", "--turn", "light") == 0
    )
    assert len(decoded(film).frames) == 5


def test_an_object_that_turns_shows_what_relighting_shows_of_a_turned_object(bundle, sky):
    renderer = Renderer(load_bundle(bundle))
    light = load_environment(sky)
    shots = shots_of_turn(renderer.bundle, Light(environment_id="sky"), "object", 8, size=24, rotate_deg=15.0)
    settings = {"spp": 64, "background": "environment"}
    first = shots[0].camera
    for index in (0, 1, 5):
        shot = shots[index]
        found = renderer.render(shot.camera, light, rotate_deg=shot.light.rotate_deg, **settings)
        expected = renderer.render(first, light, rotate_deg=15.0, object_rotate_deg=45.0 * index, **settings)
        # The box around the object is centred on the axis that relighting turns about.
        np.testing.assert_allclose(found.albedo, expected.albedo, atol=1e-4)
        behind = expected.coverage[..., 0] == 0.0
        np.testing.assert_allclose(found.rgb[behind], expected.rgb[behind], atol=1e-4)
        inside = expected.coverage[..., 0] > 0.0
        error = np.abs(found.rgb - expected.rgb)[inside].mean()
        assert error < 0.1 * expected.rgb[inside].mean()


def test_each_turn_moves_what_it_is_called_after(bundle):
    opened, light = load_bundle(bundle), Light(environment_id="sky")
    shots = {turn: shots_of_turn(opened, light, turn, 4, size=8) for turn in ("camera", "light", "object")}

    def azimuths(turn):
        eyes = [shot.camera.camera_to_world[:2, 3] for shot in shots[turn]]
        return [round(float(np.degrees(np.arctan2(y, x)))) % 360 for x, y in eyes]

    assert azimuths("camera") == [0, 90, 180, 270]
    assert azimuths("light") == [0, 0, 0, 0]
    assert azimuths("object") == [0, 270, 180, 90]
    assert [shot.light.rotate_deg for shot in shots["camera"]] == [0.0] * 4
    assert [shot.light.rotate_deg for shot in shots["light"]] == [0.0, 90.0, 180.0, 270.0]
    assert [shot.light.rotate_deg for shot in shots["object"]] == [0.0, -90.0, -180.0, -270.0]


@pytest.mark.parametrize(
    ("out", "words", "code"),
    [
        ("spin.avi", (), "film.format"),
        ("spin.mp4", ("--crf", "99"), "film.quality"),
        ("spin.mp4", ("--background", "transparent"), "turntable.no_alpha"),
        ("spin.mp4", ("--frames", "4", "--seconds", "2"), "--seconds"),
        ("spin.mp4", ("--turn", "around"), "cli.bad_choice"),
        ("spin.mp4", ("--quality", "best"), "cli.bad_choice"),
        ("spin.mp4", ("--quality", "baked"), "relight.quality_unsupported"),
        ("spin.mp4", ("--tone-mapping", "filmic"), "cli.bad_choice"),
        ("folder", ("--crf", "20"), "--crf"),
        ("folder", ("--format", "avi"), "cli.bad_choice"),
        ("folder", ("--format", "webm", "--background", "transparent"), "turntable.no_alpha"),
    ],
)
def test_what_cannot_be_done_exits_with_two_and_leaves_nothing(
    bundle, sky, tmp_path, capsys, out, words, code
):
    assert turntable(bundle, sky, tmp_path / out, "--size", "8", *words) == 2
    assert code in capsys.readouterr().err
    assert not (tmp_path / out).exists()
    assert not list(tmp_path.glob(".partial*"))


def test_without_the_package_a_film_names_the_extra(bundle, sky, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    assert turntable(bundle, sky, tmp_path / "spin.mp4") == 2
    assert "lambent[film]" in capsys.readouterr().err

"""The desktop viewer on a bundle: painted pixels, the thread that paints, and the window off-screen."""

from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
from lambent.cli import app
from lambent.desktop import opengl, viewer
from lambent.desktop.channels import channel_names
from lambent.desktop.painter import Painter, SupersededError
from lambent.desktop.photographs import find_photographs
from lambent.desktop.render_loop import RenderLoop
from lambent.desktop.viewer import DesktopOptions, open_model
from lambent.errors import LambentError
from lambent_core.colour import srgb_from_linear
from lambent_relight import Renderer, load_bundle, load_environment, turntable, write_environment
from lambent_relight.images import encode_png
from PIL import Image
from support.baked_bundle import write_baked_bundle

# A busy machine takes long to load VTK.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

CAMERAS = turntable(2, radius=4.0, elevation_deg=35.0, width=48, height=48)
SIZE = (60, 48)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_baked_bundle(tmp_path_factory.mktemp("desktop") / "boxes.relight", cameras=CAMERAS)


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    paths = []
    for seed in (0, 1):
        radiance = np.random.default_rng(seed).uniform(0.2, 1.0, (4, 8, 3)).repeat(8, 0).repeat(8, 1)
        paths.append(tmp_path_factory.mktemp("maps") / f"map{seed}.exr")
        write_environment(paths[-1], radiance, half=False)
    return paths


@pytest.fixture(scope="module")
def renderer(folder):
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx")


@pytest.fixture(scope="module")
def plain(folder):
    """Return a renderer that no viewer has touched."""
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx")


@pytest.fixture
def options(maps):
    return DesktopOptions(environments=tuple(maps), size=SIZE)


@pytest.fixture
def model(renderer, options, monkeypatch):
    # The analytic bundle has no recovered light.
    monkeypatch.setattr("lambent.desktop.lights.Lights.add_recovered", lambda lights: None)
    return open_model(renderer.bundle, options)


@pytest.fixture
def painter(renderer, model):
    return Painter(renderer, model.lights, model.photographs)


@pytest.fixture(scope="module")
def gl():
    """Skip where OpenGL cannot draw."""
    opengl.draw_without_display()
    trial = opengl.Trial()
    try:
        trial.require_success()
    except LambentError as error:
        pytest.skip(str(error))


def relit(plain, state, path, **settings):
    return plain.render(
        state.orbit.camera(state.width, state.height), load_environment(path), quality="baked", **settings
    )


def on_object(picture):
    return picture.coverage[..., 0] == 1.0


@pytest.mark.parametrize("change", [{}, {"rotate_deg": 50.0}, {"object_rotate_deg": 30.0}])
def test_painted_pixels_are_those_of_relight(plain, model, painter, maps, change):
    state = replace(model.state, exposure_ev=0.5, **change)
    expected = relit(plain, state, maps[0], **change).exposed(0.5)
    inside = on_object(expected)
    assert inside.sum() > 300
    found = painter.paint(state).image
    np.testing.assert_array_equal(found[inside], encode_png(expected)[..., :3][inside])


def test_material_sliders_and_direct_light_are_those_of_relight(plain, model, painter, maps):
    state = replace(model.state, albedo_gain=0.5, roughness_scale=0.7, indirect=False)
    expected = relit(plain, state, maps[0], edit=state.edit, indirect=False)
    inside = on_object(expected)
    found = painter.paint(state).image
    np.testing.assert_array_equal(found[inside], encode_png(expected)[..., :3][inside])
    assert np.abs(found[inside].astype(int) - painter.paint(model.state).image[inside]).mean() > 5


def test_the_environment_as_backdrop_is_seen_where_relight_shows_it(plain, model, painter, maps):
    state = replace(model.state, backdrop="environment", rotate_deg=20.0)
    expected = encode_png(relit(plain, state, maps[0], rotate_deg=20.0, background="environment"))
    assert expected.shape[-1] == 3
    difference = np.abs(painter.paint(state).image.astype(int) - expected)
    assert difference.max() <= 1


def test_every_channel_shows_its_numbers(plain, model, painter, maps, renderer):
    picture = relit(plain, model.state, maps[0])
    inside = on_object(picture)
    names = channel_names(renderer.bundle)
    assert names[:3] == ("final", "direct", "indirect")
    assert not [name for name in names if name.startswith("uncertainty")]
    expected = {
        "direct": srgb_from_linear(picture.direct),
        "indirect": srgb_from_linear(picture.indirect),
        "diffuse": srgb_from_linear(picture.diffuse),
        "specular": srgb_from_linear(picture.specular),
        "albedo": srgb_from_linear(picture.albedo),
        "normal": 0.5 * picture.normal + 0.5,
        "visibility": picture.visibility.repeat(3, axis=-1),
        "roughness": picture.perceptual_roughness.repeat(3, axis=-1),
        "metalness": picture.metalness.repeat(3, axis=-1),
    }
    for name, values in expected.items():
        found = painter.paint(replace(model.state, channel=name)).image[inside] / 255.0
        np.testing.assert_allclose(found, values[inside], atol=0.5001 / 255.0, err_msg=name)
    depth = painter.paint(replace(model.state, channel="depth"))
    near = picture.distance[..., 0][inside]
    # White is near: brightness falls as distance grows.
    assert np.corrcoef(near, depth.image[inside][:, 0])[0, 1] == pytest.approx(-1.0, abs=1e-3)
    assert f"{picture.distance[picture.coverage > 0].min():.3g} white" in depth.legend


def test_the_two_sides_are_the_two_pictures(model, painter):
    left = painter.paint(model.state).image
    right = painter.paint(replace(model.state, light=1)).image
    both = painter.paint(replace(model.state, comparison="environment", other_light=1, split=0.25)).image
    np.testing.assert_array_equal(both[:, :14], left[:, :14])
    np.testing.assert_array_equal(both[:, 16:], right[:, 16:])
    assert (both[:, 14:16] == 255).all()
    assert np.abs(left.astype(int) - right).max() > 10


def test_a_photograph_lies_where_its_camera_sees_the_object(renderer, plain, options, maps, tmp_path, model):
    """A photograph made by the renderer itself must match its own relit picture without a seam."""
    light = load_environment(maps[0])
    camera = CAMERAS[1]
    Image.fromarray(encode_png(plain.render(camera, light, quality="baked"))).save(
        tmp_path / f"{camera.name}.png"
    )
    (photograph,) = find_photographs(renderer.bundle, tmp_path)
    painter = Painter(renderer, model.lights, [photograph])
    # Twice as wide as high: the photograph fills the middle half.
    state = replace(model.state, comparison="photograph", width=96, height=48, split=0.0, backdrop="black")
    taken = painter.paint(state).image.astype(int)
    made = painter.paint(replace(state, split=1.0)).image.astype(int)
    assert np.abs(taken - made)[:, 4:-4].max() <= 1
    assert made.max() > 100
    assert (taken[:, 4:20] == 0).all()


def test_what_is_shown_differently_is_not_rendered_again(model, painter, monkeypatch):
    painter.paint(model.state)
    monkeypatch.setattr(painter.renderer, "render", lambda *_, **__: pytest.fail("rendered again"))
    for change in (
        {"exposure_ev": 1.0},
        {"tone_mapping": "agx"},
        {"channel": "albedo"},
        {"backdrop": "white"},
    ):
        painter.paint(replace(model.state, **change))


def test_a_wish_that_is_out_of_date_is_given_up_between_rays(model, painter):
    state = replace(model.state, orbit=model.state.orbit.turned(17.0, 0.0))
    painter.is_superseded = lambda: True
    painter.paint(state, full=False)
    with pytest.raises(SupersededError):
        painter.paint(state)
    painter.is_superseded = lambda: False
    assert painter.paint(state).full


def test_the_loop_paints_a_new_view_roughly_and_ends_with_full_quality(model, painter):
    shown = []
    loop = RenderLoop(painter, rest_s=0.0)
    loop._show = lambda state, painted: (
        shown.append((state, painted)),
        RenderLoop._show(loop, state, painted),
    )
    try:
        last = model.state
        for degrees in range(5):
            last = replace(last, orbit=last.orbit.turned(degrees + 1.0, 3.0))
            loop.ask(last)
        assert loop.wait_until_idle(60.0)
        frame = loop.take()
        assert loop.take() is None
    finally:
        loop.close()
    assert frame.state == last
    assert frame.painted.full
    assert [painted.full for state, painted in shown if state == last] == [False, True]
    rough = next(painted for state, painted in shown if state == last)
    assert not np.array_equal(rough.image, frame.painted.image)
    np.testing.assert_array_equal(frame.painted.image, painter.paint(last).image)


def test_a_known_view_is_painted_in_full_at_once(model, painter):
    painter.paint(model.state)
    shown = []
    loop = RenderLoop(painter, rest_s=0.0)
    loop._show = lambda state, painted: shown.append(painted.full)
    try:
        loop.ask(replace(model.state, rotate_deg=33.0))
        assert loop.wait_until_idle(60.0)
    finally:
        loop.close()
    assert shown == [True]


def test_the_loop_names_a_bad_environment_and_raises_what_is_no_users_fault(
    model, painter, tmp_path, monkeypatch
):
    number = model.lights.add_file(tmp_path / "gone.exr")
    loop = RenderLoop(painter, rest_s=0.0)
    try:
        loop.ask(replace(model.state, light=number))
        assert loop.wait_until_idle(60.0)
        assert "gone.exr" in loop.take().problem

        def broken(*_, **__):
            raise ZeroDivisionError

        monkeypatch.setattr(painter, "paint", broken)
        loop.ask(model.state)
        assert loop.wait_until_idle(60.0)
        with pytest.raises(ZeroDivisionError):
            loop.take()
    finally:
        loop.close()


def test_saving_writes_the_shown_png_and_an_exr_with_passes_and_overwrites_nothing(model, painter, tmp_path):
    session = viewer.Session(model, painter, tmp_path / "out")
    try:
        for _ in range(2):
            model.press_key("s")
            session.changed()
        assert session.loop.wait_until_idle(60.0)
    finally:
        session.close()
    assert [path.name for path in session.saved] == [
        "analytic_001.png",
        "analytic_001.exr",
        "analytic_002.png",
        "analytic_002.exr",
    ]
    with Image.open(session.saved[0]) as image:
        np.testing.assert_array_equal(np.asarray(image), painter.paint(model.state).image)
    channels = OpenEXR.File(str(session.saved[1]), separate_channels=True).parts[0].channels
    assert {"R", "A", "albedo.R", "direct.G", "Z"} <= set(channels)


def test_the_screenshot_through_opengl_equals_relight_on_the_object(gl, folder, plain, maps, tmp_path, model):
    out = tmp_path / "shot.png"
    words = ["view", str(folder), "--desktop", "--env", str(maps[0]), "--screenshot", str(out)]
    words += ["--size", "60", "48", "--rotate-deg", "25", "--exposure-ev", "-0.5"]
    assert app.run(words) == 0
    state = replace(model.state, rotate_deg=25.0)
    expected = relit(plain, state, maps[0], rotate_deg=25.0).exposed(-0.5)
    inside = on_object(expected)
    with Image.open(out) as image:
        assert image.size == SIZE
        found = np.asarray(image.convert("RGB")).astype(int)
    assert np.abs(found - encode_png(expected)[..., :3])[inside].max() <= 1
    # Where the object is not, the backdrop is.
    empty = expected.coverage[..., 0] == 0.0
    assert len(np.unique(found[empty].reshape(-1, 3), axis=0)) == 1


def test_the_window_follows_keys_mouse_and_size(gl, model, painter, tmp_path):
    from lambent.desktop.window import Window

    model.resize(160, 120)
    session = viewer.Session(model, painter, tmp_path)
    window = Window(model, off_screen=True, on_change=session.changed)
    try:
        session.changed()
        picture = _settled(session, window)
        with_panel = np.abs(picture.astype(int) - painter.paint(model.state).image).max(axis=-1)
        assert 0.05 < (with_panel > 20).mean() < 0.9, "text and sliders cover a part"
        keys = window.plotter.iren.interactor
        keys.SetKeySym("k")
        keys.InvokeEvent("KeyPressEvent")
        np.testing.assert_array_equal(_settled(session, window), painter.paint(model.state).image)
        keys.SetKeySym("bracketright")
        keys.InvokeEvent("KeyPressEvent")
        assert model.state.rotate_deg == 5.0
        azimuth = model.state.orbit.azimuth_deg
        keys.SetEventInformation(80, 70, 0, 0)
        keys.InvokeEvent("LeftButtonPressEvent")
        keys.SetEventInformation(90, 70, 0, 0)
        keys.InvokeEvent("MouseMoveEvent")
        keys.InvokeEvent("LeftButtonReleaseEvent")
        assert model.state.orbit.azimuth_deg == pytest.approx(azimuth - 180.0 / 120.0 * 10.0)
        keys.InvokeEvent("MouseWheelForwardEvent")
        assert model.state.orbit.distance < model.state.orbit.first_distance
        keys.SetEventInformation(80, 70, 0, 1)
        keys.InvokeEvent("LeftButtonPressEvent")
        keys.SetEventInformation(84, 70, 0, 1)
        keys.InvokeEvent("MouseMoveEvent")
        keys.InvokeEvent("LeftButtonReleaseEvent")
        assert model.state.rotate_deg == pytest.approx(5.0 + 180.0 / 120.0 * 4.0)
        np.testing.assert_array_equal(_settled(session, window), painter.paint(model.state).image)
        keys.SetKeySym("h")
        keys.InvokeEvent("KeyPressEvent")
        assert np.abs(_settled(session, window).astype(int) - painter.paint(model.state).image).max() > 60
    finally:
        session.close()
        window.close()


def test_a_running_window_ticks_follows_its_size_and_knows_no_keys_but_ours(
    gl, model, painter, tmp_path, monkeypatch
):
    from lambent.desktop.window import Window

    seen = []

    def run(window):
        started(window)  # off-screen the event loop ends at once
        interactor = window.plotter.iren.interactor
        seen.append(interactor.GetInteractorStyle())
        window.plotter.render_window.SetSize(72, 50)
        interactor.InvokeEvent("TimerEvent")
        model.press_key("s")
        window._on_change()

    started = Window.run
    monkeypatch.setattr(Window, "run", run)
    files = viewer.run(model, painter, save_to=tmp_path, off_screen=True)
    assert seen == [None]
    assert (model.state.width, model.state.height) == (72, 50)
    assert [path.name for path in files] == ["analytic_001.png", "analytic_001.exr"]
    with Image.open(files[0]) as image:
        assert image.size == (72, 50)


def _settled(session, window):
    """Return the window's pixels when everything was painted."""
    assert session.loop.wait_until_idle(60.0)
    session.tick(window)
    return window.screenshot()


def test_without_opengl_the_command_says_so_and_ends_with_one(monkeypatch, folder, maps, tmp_path, capsys):
    monkeypatch.setattr(opengl, "_TRIAL", "import sys; sys.exit('libGL is not here')")
    words = ["view", str(folder), "--desktop", "--env", str(maps[0]), "--screenshot", str(tmp_path / "x.png")]
    assert app.run(words) == 1
    message = capsys.readouterr().err
    assert "view.no_opengl" in message
    assert "libGL is not here" in message
    assert "lambent relight" in message
    assert not (tmp_path / "x.png").exists()

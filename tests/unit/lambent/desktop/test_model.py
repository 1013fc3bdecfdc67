"""The desktop viewer without its window: cameras, input and what it changes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from lambent.desktop.lights import Lights
from lambent.desktop.model import BINDINGS, ViewerModel, help_columns
from lambent.desktop.orbit import Orbit
from lambent.desktop.photographs import Photograph
from lambent.desktop.state import ViewerState
from lambent.errors import UsageProblemError
from lambent_relight import turntable, write_environment

CHANNELS = ("final", "direct", "albedo", "depth")
ORBIT = Orbit(
    target=(0.1, 0.2, 0.3),
    azimuth_deg=0.0,
    elevation_deg=20.0,
    distance=4.0,
    field_of_view_deg=40.0,
    first_distance=4.0,
)
STATE = ViewerState(orbit=ORBIT, width=200, height=100)


@pytest.fixture
def maps(tmp_path):
    paths = [tmp_path / f"{name}.exr" for name in ("a", "b", "c")]
    for number, path in enumerate(paths):
        write_environment(path, np.full((4, 8, 3), number + 1.0, np.float32))
    return paths


@pytest.fixture
def model(maps):
    bundle = SimpleNamespace(manifest=SimpleNamespace(train_lights=["sky"]))
    lights = Lights(bundle)
    for path in maps[:2]:
        lights.add_file(path)
    lights.add_recovered()
    camera = turntable(1, radius=4.0, width=20, height=10)[0]
    photographs = [Photograph(name=name, path=maps[0], camera=camera, light="sky") for name in ("one", "two")]
    return ViewerModel(STATE, lights, photographs, CHANNELS)


def test_the_orbit_is_a_turntable_that_can_be_steered():
    (expected,) = turntable(
        1, radius=4.0, elevation_deg=20.0, target=ORBIT.target, width=64, height=64, field_of_view_deg=40.0
    )
    assert ORBIT.camera(64, 64).key() == expected.key()
    further = ORBIT.turned(90.0, 0.0).camera(64, 64)
    offset = further.camera_to_world[:3, 3] - ORBIT.target
    np.testing.assert_allclose(offset[:2], (0.0, 4.0 * np.cos(np.radians(20.0))), atol=1e-9)


def test_the_shorter_side_has_the_field_of_view():
    wide, tall = ORBIT.camera(200, 100), ORBIT.camera(100, 200)
    assert wide.focal_x == tall.focal_x == ORBIT.camera(100, 100).focal_x


def test_cameras_stay_below_the_pole_and_at_a_distance():
    assert ORBIT.turned(0.0, 500.0).elevation_deg == 89.0
    assert ORBIT.nearer(1e9).distance == pytest.approx(0.8)
    assert ORBIT.nearer(1e-9).distance == pytest.approx(20.0)


def test_a_moved_picture_follows_the_mouse():
    moved = ORBIT.moved(10.0, -5.0, 200, 100).camera(200, 100)
    point = np.append(ORBIT.target, 1.0)
    x, y, z, _ = np.linalg.inv(moved.camera_to_world) @ point
    pixel = (moved.centre_x - moved.focal_x * x / z, moved.centre_y + moved.focal_y * y / z)
    np.testing.assert_allclose(pixel, (110.0, 45.0), atol=1e-6)


@pytest.mark.parametrize(
    ("key", "field", "expected"),
    [
        ("bracketright", "rotate_deg", 5.0),
        ("bracketleft", "rotate_deg", -5.0),
        ("braceright", "object_rotate_deg", 5.0),
        ("braceleft", "object_rotate_deg", -5.0),
        ("period", "exposure_ev", 0.25),
        ("comma", "exposure_ev", -0.25),
        ("t", "tone_mapping", "neutral"),
        ("c", "channel", "direct"),
        ("C", "channel", "depth"),
        ("e", "light", 1),
        ("E", "light", 2),
        ("i", "indirect", False),
        ("b", "backdrop", "white"),
        ("g", "albedo_gain", 0.9),
        ("G", "albedo_gain", 1.1),
        ("r", "roughness_scale", 0.9),
        ("R", "roughness_scale", 1.1),
    ],
)
def test_a_key_changes_one_thing(model, key, field, expected):
    assert model.press_key(key)
    found = getattr(model.state, field)
    assert found == (pytest.approx(expected) if isinstance(expected, float) else expected)
    assert replace(model.state, **{field: getattr(STATE, field)}) == STATE


@pytest.mark.parametrize(
    ("key", "azimuth", "elevation"),
    [("Left", -5.0, 20.0), ("Right", 5.0, 20.0), ("Up", 0.0, 25.0), ("Down", 0.0, 15.0)],
)
def test_arrows_move_the_camera(model, key, azimuth, elevation):
    model.press_key(key)
    assert (model.state.orbit.azimuth_deg, model.state.orbit.elevation_deg) == (azimuth, elevation)


def test_every_key_is_known_once_written_in_the_help_and_breaks_nothing(model):
    symbols = [symbol for binding in BINDINGS for symbol in binding.symbols]
    assert len(set(symbols)) == len(symbols)
    text = "\n".join(help_columns())
    for binding in BINDINGS:
        assert f"{binding.written}  {binding.does}" in text
        for symbol in binding.symbols:
            assert model.press_key(symbol)
            model.status()
    assert not model.press_key("F12")


def test_angles_and_numbers_stay_within_limits(model):
    for _ in range(100):
        for key in ("bracketright", "period", "g", "r", "apostrophe"):
            model.press_key(key)
    state = model.state
    assert -180.0 <= state.rotate_deg < 180.0
    assert state.rotate_deg == pytest.approx(500.0 - 360.0)
    assert (state.exposure_ev, state.albedo_gain, state.roughness_scale, state.split) == (8.0, 0.1, 0.0, 1.0)


def test_dragging_turns_the_camera_with_shift_the_light_and_with_control_the_object(model):
    def dragged(**keys):
        model.state = STATE
        model.press_mouse(50, 50, button="left", **keys)
        assert model.move_mouse(60, 50)
        model.release_mouse()
        assert not model.move_mouse(90, 90)
        return model.state

    # The shorter side, 100 pixels, is half a turn.
    assert dragged().orbit.azimuth_deg == pytest.approx(-18.0)
    assert dragged(shift=True) == replace(STATE, rotate_deg=pytest.approx(18.0))
    assert dragged(control=True) == replace(STATE, object_rotate_deg=pytest.approx(18.0))
    model.press_mouse(0, 0, button="right")
    model.move_mouse(5, 5)
    assert model.state.orbit.target != ORBIT.target


def test_the_border_of_a_comparison_can_be_dragged_and_nothing_else_then_moves(model):
    model.press_key("a")
    model.press_mouse(103, 50, button="left")
    model.move_mouse(150, 20)
    assert model.state.split == pytest.approx(0.75)
    assert model.state.orbit == ORBIT
    model.release_mouse()
    # Away from the border the camera turns.
    model.press_mouse(20, 50, button="left")
    model.move_mouse(30, 50)
    assert model.state.orbit != ORBIT


def test_environments_are_compared_and_taken_in_turn(model):
    model.press_key("a")
    assert (model.state.comparison, model.state.light, model.state.other_light) == ("environment", 0, 1)
    assert "left a.exr, right b.exr" in model.status()
    model.press_key("n")
    assert "right sky (recovered)" in model.status()
    model.press_key("a")
    assert model.state.comparison == ""


def test_a_photograph_is_shown_as_it_was_taken_until_the_camera_moves(model):
    for key in ("braceright", "bracketright", "c", "p"):
        model.press_key(key)
    state = model.state
    assert (state.comparison, state.light, state.rotate_deg, state.object_rotate_deg, state.channel) == (
        "photograph", 2, 0.0, 0.0, "final",
    )  # fmt: skip
    assert "photograph one" in model.status()
    model.press_key("Next")
    assert "photograph two" in model.status()
    model.press_key("bracketright")
    assert model.state.comparison == "photograph", "the light may be turned"
    for key in ("Left", "braceright", "e", "p"):
        model.state = replace(state)
        model.press_key(key)
        assert model.state.comparison == "", key


def test_without_photographs_or_a_second_light_a_message_says_so(model):
    model.photographs = []
    model.press_key("p")
    assert "--photographs" in model.message
    alone = Lights(model.lights.bundle)
    alone.add_recovered()
    model.lights = alone
    model.press_key("a")
    assert "one environment" in model.message
    assert model.state == STATE


def test_an_environment_is_opened_from_a_dialog_and_a_bad_one_changes_nothing(model, maps, tmp_path):
    model.choose_file = lambda: maps[2]
    model.press_key("o")
    assert model.lights.name(model.state.light) == "c.exr"
    (tmp_path / "bad.exr").write_bytes(b"nothing")
    before, count = model.state, len(model.lights)
    model.choose_file = lambda: tmp_path / "bad.exr"
    model.press_key("o")
    assert "environment." in model.message
    assert (model.state, len(model.lights)) == (before, count)
    model.choose_file = lambda: None
    model.press_key("o")
    assert model.state == before

    def no_dialog():
        raise UsageProblemError("view.no_dialog", "none", "start with --env MAP")

    model.choose_file = no_dialog
    model.press_key("o")
    assert "view.no_dialog" in model.message


def test_maps_that_were_read_long_ago_are_read_again_and_are_the_same(maps, tmp_path):
    lights = Lights(SimpleNamespace(manifest=SimpleNamespace(train_lights=[])))
    for number in range(6):
        path = tmp_path / f"{number}.exr"
        write_environment(path, np.full((4, 8, 3), number + 1.0, np.float32))
        lights.add_file(path)
        assert lights.environment(number) is lights.environment(number)
    assert lights.environment(0).radiance[0, 0, 0] == 1.0
    assert lights.environment(5).radiance[0, 0, 0] == 6.0


def test_sliders_set_what_they_are_called(model):
    for name, field, value in [
        ("light", "rotate_deg", 30.0),
        ("object", "object_rotate_deg", -40.0),
        ("exposure", "exposure_ev", 2.0),
        ("albedo", "albedo_gain", 0.5),
        ("roughness", "roughness_scale", 1.5),
    ]:
        model.set_slider(name, value)
        assert getattr(model.state, field) == pytest.approx(value)


def test_home_goes_back_but_keeps_the_windows_size(model):
    model.resize(300, 250)
    for key in ("Left", "t", "c", "bracketright"):
        model.press_key(key)
    model.press_key("Home")
    assert model.state == replace(STATE, width=300, height=250)

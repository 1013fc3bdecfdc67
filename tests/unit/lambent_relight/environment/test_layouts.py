"""Layouts of environment maps: a known radiance in each, its orientation and energy, and what is refused."""

import json

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_solid_angles
from lambent_core.errors import EnvironmentFileError
from lambent_relight.environment import layouts
from lambent_relight.environment.input import EnvironmentInput, open_environment
from lambent_relight.environment.layouts import LAYOUTS, layout_of_size, to_latlong
from lambent_relight.environment.maps import environment_from_array, load_environment, write_environment
from lambent_relight.environment.probes import chrome_ball
from support import environment_layouts as made

INDEX = json.loads((made.FOLDER / "index.json").read_text(encoding="utf-8"))
DIRECTIONS, RADIANCE = np.array(INDEX["directions"]), np.array(INDEX["radiance"])
READ = [case for case in INDEX["cases"] if "read_as" in case]
REFUSED = [case for case in INDEX["cases"] if "code" in case]


def worst_error(environment, *, coarse=False):
    """Return the greatest error, but for the poles of coarse maps and what is behind a probe."""
    use = np.abs(DIRECTIONS[:, 2]) < 0.8 if coarse else np.ones(len(DIRECTIONS), bool)
    use &= DIRECTIONS[:, 0] > {"angular": -0.98, "mirror-ball": -0.7}.get(environment.read_as, -1.1)
    return np.abs(environment.lookup(DIRECTIONS) - RADIANCE)[use].max()


@pytest.mark.parametrize("case", READ, ids=lambda case: case["file"])
def test_the_known_radiance_arrives_from_its_directions_whatever_the_layout(case):
    read = load_environment(made.FOLDER / case["file"], layout=case.get("given", "auto"))
    assert read.read_as == case["read_as"]
    if case.get("skip_first"):
        # Its first pixels are those that look like the head of a coded line.
        read.radiance[[0, 5], 0] = read.radiance[[0, 5], 1]
    assert worst_error(read, coarse=case.get("coarse", False)) < (0.06 if case.get("coarse") else 0.03)


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case["file"])
def test_what_cannot_be_understood_is_refused_by_name(case):
    with pytest.raises(EnvironmentFileError) as caught:
        load_environment(made.FOLDER / case["file"], layout=case.get("given", "auto"))
    assert caught.value.code == case["code"]
    assert case["file"] in caught.value.message
    assert caught.value.advice


def test_the_stored_files_are_those_that_the_generator_writes(tmp_path):
    cases = made.write_all(tmp_path)
    assert cases == INDEX["cases"]
    for case in cases:
        if case["file"].endswith(".hdr"):
            assert (tmp_path / case["file"]).read_bytes() == (made.FOLDER / case["file"]).read_bytes()


@pytest.mark.parametrize("layout", ["cross-horizontal", "cross-vertical", "strip-vertical", "cube"])
@pytest.mark.parametrize("face", range(6))
@pytest.mark.parametrize("turn", ["flipped", "rotated"])
def test_a_face_turned_the_wrong_way_is_noticed(monkeypatch, layout, face, turn):
    name = "_OPENEXR" if layout == "cube" else "_OPENGL"
    table = list(getattr(layouts, name))
    ahead, right, down = table[face]
    table[face] = (ahead, -right, down) if turn == "flipped" else (ahead, -right, -down)
    monkeypatch.setattr(layouts, name, tuple(table))
    case = next(case for case in READ if case["read_as"] == layout)
    assert worst_error(load_environment(made.FOLDER / case["file"])) > 0.1


@pytest.mark.parametrize("layout", ["cross-horizontal", "cross-vertical", "strip-horizontal", "cube"])
def test_one_lit_pixel_of_a_cube_keeps_its_energy(layout):
    side, rng = 16, np.random.default_rng(1)
    columns, rows = {"cross-horizontal": (4, 3), "cross-vertical": (3, 4), "strip-horizontal": (6, 1)}.get(
        layout, (1, 6)
    )
    for column, row, _ in layouts._CELLS[layout]:
        x, y = rng.integers(1, side - 1, 2)
        image = np.zeros((rows * side, columns * side, 3), np.float32)
        image[row * side + y, column * side + x] = 1.0
        found = to_latlong(image, layout)
        energy = (found[..., 0] * pixel_solid_angles(*found.shape[:2])[:, None]).sum()
        # OpenEXR's pixels lie on a grid of side - 1 steps.
        step = 2.0 / (side - 1) if layout == "cube" else 2.0 / side
        s, t = ((place - (side - 1) / 2) * step for place in (x, y))
        assert energy == pytest.approx(step**2 / (1.0 + s * s + t * t) ** 1.5, rel=0.1)


def test_a_constant_cube_has_no_seams():
    for layout, (columns, rows) in layouts._GRIDS.items():
        found = to_latlong(np.ones((rows * 8, columns * 8, 3), np.float32), layout)
        np.testing.assert_allclose(found, 1.0, rtol=1e-6)
        assert found.shape[1] == 2 * found.shape[0]


def test_the_chrome_ball_that_a_probe_writes_is_read_back_as_the_light():
    light = environment_from_array(made.latlong(64, 128))
    ball = chrome_ball(light, 96)
    read = environment_from_array(to_latlong(ball.rgb * (ball.opacity > 0.99), "mirror-ball"))
    # What is behind the ball is a thin rim.
    use = DIRECTIONS[:, 0] > -0.9
    assert np.abs(read.lookup(DIRECTIONS) - RADIANCE)[use].max() < 0.03


def test_the_size_says_the_layout():
    sizes = {
        (512, 1024): "latlong",
        (1, 1): "latlong",
        (1, 2): "latlong",
        (500, 1010): "latlong",
        (300, 400): "cross-horizontal",
        (400, 300): "cross-vertical",
        (64, 384): "strip-horizontal",
        (384, 64): "strip-vertical",
        (200, 200): "angular",
        (200, 300): "",
        (100, 250): "",
        (301, 401): "",
    }
    assert {size: layout_of_size(*size) for size in sizes} == sizes


def test_an_option_decides_and_is_checked(tmp_path):
    square = made.FOLDER / "lit_square.hdr"
    assert load_environment(square, layout="latlong").read_as == "latlong"
    assert load_environment(square, layout="angular").read_as == "angular"
    with pytest.raises(EnvironmentFileError, match=r"environment\.unknown_layout.*'dome'"):
        load_environment(square, layout="dome")
    assert load_environment(made.FOLDER / "cube.exr", layout="strip-vertical").read_as == "strip-vertical"


def test_a_conversion_is_noted_and_axes_turn_its_result():
    path = made.FOLDER / "angular.hdr"
    opened = open_environment(path, EnvironmentInput(axes="skylibs"))
    assert opened.notes("probe") == [f"probe: read as {LAYOUTS['angular']}, converted to 96 x 48 pixels"]
    np.testing.assert_allclose(
        opened.environment.lookup(np.array([[0.0, 1.0, 0.0]])),
        load_environment(path).lookup(np.array([[1.0, 0.0, 0.0]])),
        rtol=1e-3,
    )
    assert open_environment(made.FOLDER / "latlong.hdr").notes("map") == []


def test_unusable_values_are_found_in_the_file_and_not_after_they_spread(tmp_path):
    image = made.angular(48).astype(np.float32)
    image[24, 20] = np.nan
    image[0, 0] = np.nan
    write_environment(tmp_path / "probe.exr", image, half=False)
    with pytest.raises(EnvironmentFileError, match=r"3 NaN, 0 infinite.*row 24, column 20"):
        load_environment(tmp_path / "probe.exr")
    mended = load_environment(tmp_path / "probe.exr", mend=True)
    assert np.isfinite(mended.radiance).all()
    assert mended.cleaning.num_nan == 3


def test_a_cube_too_large_to_convert_is_refused(tmp_path):
    write_environment(tmp_path / "cube.exr", np.ones((8, 48, 3)))
    with pytest.raises(EnvironmentFileError, match=r"environment\.too_large.*48 x 8.*strip"):
        load_environment(tmp_path / "cube.exr", max_pixels=300)


def test_directions_between_faces_are_continuous():
    read = load_environment(made.FOLDER / "cross_horizontal.hdr")
    edge = normalise(np.array([[1.0, 1.0 + e, 0.3] for e in np.linspace(-0.05, 0.05, 41)]))
    assert np.abs(np.diff(read.lookup(edge), axis=0)).max() < 0.01

"""Pictures of two viewers beside the truth: cameras, maps, and figures, without a browser."""

import json

import numpy as np
import pytest
from lambent_core.directions import pixel_directions
from lambent_relight import environment_from_array, load_environment
from lambent_relight.cameras import Camera, look_at
from PIL import Image

from benchmarks.browser_pictures import orbit_of, rgbe_bytes
from benchmarks.mirror_ball import ball_glb, reflected
from benchmarks.side_by_side import (
    Truth,
    lights_of,
    overlap,
    read_truth,
    scores,
    strip,
    table,
    turned,
    write_maps,
)


def camera(position, target, *, focal=300.0) -> Camera:
    return Camera.centred("test", 200, 200, focal, look_at(position, target))


def test_an_orbit_leads_back_to_the_camera():
    for position, target in [((3.0, -1.0, 2.0), (0.1, 0.2, 0.3)), ((-2.0, 2.5, -0.7), (0.0, 0.0, 0.1))]:
        given = camera(position, target)
        orbit = orbit_of(given)
        theta, phi = orbit["theta"], orbit["phi"]
        # As three.js places a camera on a sphere, y up.
        back = np.array([np.sin(phi) * np.sin(theta), np.cos(phi), np.sin(phi) * np.cos(theta)])
        x, y, z = np.array([orbit["x"], orbit["y"], orbit["z"]]) + orbit["radius"] * back
        assert np.allclose((x, -z, y), position, atol=1e-6)
        ahead = (np.array(target) - position) / np.linalg.norm(np.array(target) - position)
        assert np.allclose((-back[0], back[2], -back[1]), ahead, atol=1e-6)
        assert orbit["fov_deg"] == pytest.approx(np.degrees(2.0 * np.arctan(100.0 / 300.0)))


@pytest.mark.parametrize("fault", ["rolled", "shifted", "turned away"])
def test_a_camera_that_no_orbit_has_is_refused(fault):
    given = camera((3.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    pose, centre = np.array(given.camera_to_world), given.centre_x
    if fault == "rolled":
        right, up = pose[:3, 0].copy(), pose[:3, 1].copy()
        pose[:3, 0], pose[:3, 1] = 0.8 * right + 0.6 * up, 0.8 * up - 0.6 * right
    elif fault == "turned away":
        pose = look_at((3.0, 0.0, 1.0), (6.0, 0.0, 2.0))
    else:
        centre += 4.0
    other = Camera(
        name="test",
        width=200,
        height=200,
        focal_x=300.0,
        focal_y=300.0,
        centre_x=centre,
        centre_y=100.0,
        camera_to_world=pose,
    )
    with pytest.raises(ValueError, match="test: the camera"):
        orbit_of(other)


def test_a_written_map_is_read_back_and_turned_as_light_is(tmp_path):
    towards = np.array([np.cos(0.7), np.sin(0.7), 0.3]) / np.sqrt(1.09)
    radiance = np.exp(8.0 * (pixel_directions(32, 64) @ towards))[..., None] * np.array([1.0, 0.5, 0.01])
    radiance[0] = 0.0
    (tmp_path / "lamp.hdr").write_bytes(rgbe_bytes(radiance))
    write_maps(tmp_path, ["lamp", "lamp_045"], tmp_path / "out")
    found = load_environment(tmp_path / "out" / "lamp.hdr")
    assert np.all(np.abs(found.radiance - radiance) <= radiance.max(axis=-1, keepdims=True) / 128.0)
    moved = load_environment(tmp_path / "out" / "lamp_045.hdr")
    probe = pixel_directions(32, 64)[5:-5].reshape(-1, 3)
    wanted = found.rotated(45.0).lookup(probe)
    assert np.allclose(moved.lookup(probe), wanted, rtol=1e-3, atol=1e-3)
    assert np.array_equal(turned(radiance, 360.0), radiance)


def square(value: float, *, known: bool = True) -> Truth:
    coverage = np.zeros((8, 8))
    coverage[2:6, 2:6] = 1.0
    seen = np.full((8, 8), True)
    seen[2, 2] = known
    return Truth(encoded=np.full((8, 8, 3), value) * coverage[..., None], coverage=coverage, known=seen)


def drawn(value: float, truth: Truth) -> np.ndarray:
    return np.dstack([np.full((8, 8, 3), value), truth.coverage])


def test_figures_are_of_the_object_and_of_all_and_after_factors():
    truth = square(0.5)
    found = scores(drawn(0.6, truth), truth)
    assert found["object"] == pytest.approx(20.0)
    assert found["picture"] == pytest.approx(20.0 + 10.0 * np.log10(4.0))
    assert found["scaled"] > 60.0
    assert found["overlap"] == 1.0


def test_what_is_clipped_in_truth_is_not_compared():
    truth = square(0.5, known=False)
    picture = drawn(0.5, truth)
    picture[2, 2, :3] = 1.0
    assert scores(picture, truth)["object"] == scores(picture, truth)["picture"] == 100.0


def test_silhouettes_that_are_apart_overlap_less():
    truth = square(0.5)
    picture = drawn(0.5, truth)
    picture[..., 3] = np.roll(truth.coverage, 1, axis=1)
    assert overlap(picture, truth) == pytest.approx(12.0 / 20.0)


def test_truth_of_a_png_leaves_clipped_pixels_out(tmp_path):
    pixels = np.zeros((4, 4, 4), np.uint8)
    pixels[1:3, 1:3] = (128, 64, 32, 255)
    pixels[1, 1] = (255, 64, 32, 255)
    Image.fromarray(pixels).save(tmp_path / "rgba_sun.png")
    (tmp_path / "metadata.json").write_text(json.dumps({}))
    assert lights_of(tmp_path) == ["sun"]
    truth = read_truth(tmp_path, "sun")
    assert truth.inside.sum() == 3
    # Below the curve's shoulder a colour loses what its darkest channel reflects at a glance.
    assert np.all(truth.encoded[2, 2] < np.array([128, 64, 32]) / 255.0)
    assert truth.encoded[2, 2, 0] > 0.47
    assert np.all(truth.encoded[0, 0] == 0.0)


def test_the_table_has_a_mean_of_every_light_and_of_all():
    records = [
        {
            "light": light,
            "view": "test_000",
            "a": {"object": value, "picture": 2 * value, "scaled": 3 * value},
        }
        for light, value in (("sun", 10.0), ("sun", 12.0), ("sky", 20.0))
    ]
    lines = table(records, ["a"]).splitlines()
    assert lines[2] == "| sun | 11.00 / 22.00 / 33.00 |"
    assert lines[3] == "| sky | 20.00 / 40.00 / 60.00 |"
    assert lines[4] == "| mean | 14.00 / 28.00 / 42.00 |"


def test_a_strip_has_a_row_for_every_light_and_a_limit_of_bytes(tmp_path):
    cell = np.zeros((32, 32, 3), np.uint8)
    cell[12:20, 4:28] = np.random.default_rng(0).integers(1, 255, (8, 24, 3))
    for light in ("sun", "sky", "lamp"):
        for side in ("truth", "ours"):
            Image.fromarray(cell).save(tmp_path / f"{light}_test_000_{side}.png")
    asked = (tmp_path, ["sun", "sky", "lamp"], "test_000", ["ours"], tmp_path / "strip.jpg")
    strip(*asked, most_bytes=120_000)
    assert (tmp_path / "strip.jpg").stat().st_size <= 120_000
    with Image.open(tmp_path / "strip.jpg") as image:
        assert image.size == (512, 768)
        # It is cut to what is shown: 28 of 32 pixels across.
        across = np.asarray(image)[:256, :256].max(axis=(0, 2)) > 32
        assert across.mean() == pytest.approx(24.0 / 28.0, abs=0.03)
    with pytest.raises(SystemExit, match="stays above 10 bytes"):
        strip(*asked, most_bytes=10)


def test_a_mirror_ball_shows_what_is_behind_the_camera_in_its_middle():
    position = np.array([2.0, -3.0, 1.5])
    towards = position / np.linalg.norm(position)
    radiance = np.repeat(0.7 * (pixel_directions(64, 128) @ towards > 0.95)[..., None], 3, axis=-1)
    light = environment_from_array(radiance.astype(np.float32))
    shown, where = reflected(camera(position, (0.0, 0.0, 0.0), focal=500.0), light)
    assert shown[100, 100, 0] > 0.8
    assert np.all(shown[where & (shown[..., 0] < 0.1)] < 0.1)
    rows, columns = np.nonzero(shown[..., 0] > 0.4)
    assert (rows.mean(), columns.mean()) == pytest.approx((99.5, 99.5), abs=1.5)
    # Directions double at the surface: the disc of 18 degrees is one of about 9 on the ball.
    assert shown[where, 0].mean() < 0.1


def test_the_ball_faces_outwards():
    data = ball_glb(8)
    length = int.from_bytes(data[12:16], "little")
    content, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    views, counts = content["bufferViews"], [each["count"] for each in content["accessors"]]
    points = np.frombuffer(binary, "<f4", 3 * counts[0], views[0]["byteOffset"]).reshape(-1, 3)
    faces = np.frombuffer(binary, "<u4", counts[1], views[1]["byteOffset"]).reshape(-1, 3)
    a, b, c = (points[faces[:, corner]] for corner in range(3))
    outwards = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=-1)
    assert outwards.min() > -1e-6
    assert (outwards > 1e-3).mean() > 0.8
    assert len(data) == int.from_bytes(data[8:12], "little")

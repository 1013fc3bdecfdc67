"""The parts of the tabletop captures that need no renderer: shapes, cameras, the phone."""

import numpy as np
import pytest
from PIL import Image, ImageOps
from tabletop.cameras import Camera, around, phone, rounds, sixteen, turned_about_z
from tabletop.distance import ball, blend, box, carve, drum, rod, rotated, surface
from tabletop.objects import THINGS
from tabletop.phone import READ_NOISE_ELECTRONS, Exposure, develop, encode_srgb, meter, write_photograph


def test_a_balls_surface_is_round_closed_and_faces_outwards():
    found = surface(lambda p: ball(p, (0.1, 0.0, 0.2), 0.5), (-0.6, -0.6, -0.4), (0.7, 0.7, 0.8), 40)
    out = found.positions - np.float32([0.1, 0.0, 0.2])
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 0.5, atol=1e-4)
    np.testing.assert_allclose(found.normals, out / 0.5, atol=1e-3)
    a, b, c = (found.positions[found.faces[:, k]].astype(np.float64) for k in range(3))
    volume = np.einsum("fk,fk->f", a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.5**3, rel=0.01)


@pytest.mark.parametrize(
    ("distance", "point", "expected"),
    [
        (lambda p: box(p, (0, 0, 0), (1, 1, 1)), (2, 2, 0), 2**0.5),
        (lambda p: box(p, (0, 0, 0), (1, 1, 1), 0.25), (0, 0, 3), 2.0),
        (lambda p: drum(p, (0, 0, 1), 0.5, 1.0, 2), (0, 1.5, 1), 1.0),
        (lambda p: rod(p, (0, 0, 0), (0, 0, 1), 0.2), (0, 0, 2), 0.8),
        (lambda p: carve(box(p, (0, 0, 0), (1, 1, 1)), ball(p, (0, 0, 0), 0.5), 1e-6), (0, 0, 0), 0.5),
        (lambda p: blend(ball(p, (0, 0, 0), 1.0), ball(p, (9, 0, 0), 1.0), 0.1), (0, 3, 0), 2.0),
        (lambda p: ball(rotated(p, (0, 0, 0), 2, 90.0), (1, 0, 0), 0.5), (0, 1, 0), -0.5),
    ],
)
def test_distances_are_those_of_their_shapes(distance, point, expected):
    assert distance(np.float32([point]))[0] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("name", THINGS)
def test_an_object_lies_inside_its_box_and_its_paint_is_a_material(name):
    thing = THINGS[name]
    found = surface(thing.distance, thing.low, thing.high, 40)
    assert (found.positions > np.array(thing.low) - 0.01).all()
    assert (found.positions < np.array(thing.high) + 0.01).all()
    assert abs(found.positions[:, 2].min()) < 0.06, "it stands on the ground"
    colour, roughness, metalness = thing.paint(found.positions, found.normals)
    assert colour.shape == found.positions.shape
    assert colour.std(axis=0).max() > 0.02, "it is not of one colour"
    for values in (colour, roughness, metalness):
        assert np.isfinite(values).all()
    assert 0.0 < roughness.min() <= roughness.max() <= 1.0
    assert set(np.unique(metalness >= 0.0)) == {True}
    assert metalness.max() <= 1.0


def test_distortion_is_undone():
    camera = Camera(width=8, height=6, focal=5.0, camera_to_world=np.eye(4), k1=-0.05, k2=0.02)
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 9), np.linspace(-0.5, 0.5, 7))
    square = x**2 + y**2
    scale = 1.0 + camera.k1 * square + camera.k2 * square**2
    back = camera.undistorted(x * scale, y * scale)
    np.testing.assert_allclose(back, (x, y), atol=1e-6)


def test_a_walk_looks_at_the_object_from_all_sides_and_heights():
    middle = np.array([0.1, 0.0, 0.8])
    poses = np.array(around(40, middle, 5.0, seed=3))
    assert np.array_equal(poses, np.array(around(40, middle, 5.0, seed=3)))
    to_camera = poses[:, :3, 3] - middle
    far = np.linalg.norm(to_camera, axis=-1)
    assert 4.2 < far.min() < far.max() < 5.8
    elevation = np.degrees(np.arcsin(to_camera[:, 2] / far))
    assert elevation.min() < 28.0 < 60.0 < elevation.max()
    assert len(set((np.degrees(np.arctan2(to_camera[:, 1], to_camera[:, 0])) // 45).astype(int))) == 8
    facing = np.einsum("ck,ck->c", poses[:, :3, 2], to_camera / far[:, None])
    assert np.degrees(np.arccos(facing)).max() < 10.0
    np.testing.assert_allclose(
        poses[:, :3, :3] @ poses[:, :3, :3].transpose(0, 2, 1),
        np.eye(3)[None] + 0 * poses[:, :3, :3],
        atol=1e-9,
    )


@pytest.mark.parametrize("num_views", [24, 40, 80])
def test_the_sixteen_are_a_round_without_gaps_and_some_from_above(num_views):
    few = sixteen(num_views)
    assert len(few) == len(set(few)) == min(16, sum(count for count, _ in rounds(num_views)[1:]))
    poses = np.array(around(num_views, np.zeros(3), 1.0, seed=5))[few]
    azimuth = np.sort(np.degrees(np.arctan2(poses[:, 1, 3], poses[:, 0, 3])))
    assert np.diff([*azimuth, azimuth[0] + 360.0]).max() < 60.0
    assert sixteen(12) == list(range(12))


def test_the_phone_has_the_field_of_view_of_26_millimetres():
    lying, upright = (phone(1600, np.eye(4), upright=value) for value in (False, True))
    assert (lying.width, lying.height, upright.width, upright.height) == (1600, 1200, 1200, 1600)
    assert lying.focal == upright.focal
    assert 2 * np.degrees(np.arctan(1000.0 / lying.focal)) == pytest.approx(79.5, abs=0.1)


def test_turning_about_z_turns_the_camera_as_the_object_would_turn_back():
    pose = np.eye(4)
    pose[:3, 3] = (1.0, 0.0, 2.0)
    np.testing.assert_allclose(turned_about_z(pose, 90.0)[:3, 3], (0.0, 1.0, 2.0), atol=1e-12)


def test_the_exposure_in_exif_is_proportional_to_what_the_picture_got():
    exposures = [Exposure(factor=factor) for factor in (0.2, 0.9, 1.0, 3.7, 20.0)]
    products = [exposure.seconds * exposure.iso / exposure.factor for exposure in exposures]
    np.testing.assert_allclose(products, products[0], rtol=1e-12)
    assert all(1 / 500 < exposure.seconds < 1 / 4 for exposure in exposures)


def test_the_meter_brings_an_even_picture_to_grey_and_keeps_highlights():
    assert meter(np.full((6, 8, 3), 0.5), 0.2) == pytest.approx(0.4)
    bright = np.full((40, 40, 3), 0.01)
    bright[:4] = 10.0
    assert meter(bright, 0.2) == pytest.approx(0.11)


def test_noise_is_that_of_the_electrons():
    exposure, level = Exposure(factor=10.0), 0.03
    picture = develop(np.full((300, 300, 3), level), exposure, seed=0)
    code = picture / 255.0
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    full = 36_000.0 * 100.0 / exposure.iso
    expected = np.sqrt(0.3 / full + (READ_NOISE_ELECTRONS / full) ** 2)
    assert linear.mean() == pytest.approx(0.3, rel=0.005)
    # Rounding to 8 bits adds a little.
    assert expected < linear.std() < 1.1 * expected


@pytest.mark.parametrize("orientation", [1, 6, 8])
def test_a_photograph_is_upright_after_its_exif_orientation(tmp_path, orientation):
    picture = np.zeros((64, 48, 3), np.uint8)
    picture[:16, :16] = 255
    exposure = Exposure(factor=1.0)
    write_photograph(tmp_path / "a.jpg", picture, exposure, orientation, 3)
    with Image.open(tmp_path / "a.jpg") as image:
        assert image.size == ((48, 64) if orientation == 1 else (64, 48))
        exif = image.getexif()
        assert exif[274] == orientation
        details = exif.get_ifd(0x8769)
        assert (details[41989], details[34855]) == (26, exposure.iso)
        assert float(details[33434]) == pytest.approx(exposure.seconds, abs=1e-6)
        upright = np.asarray(ImageOps.exif_transpose(image))
    assert np.abs(upright.astype(int) - picture).mean() < 2.0
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]


def test_srgb_is_encoded_piecewise():
    np.testing.assert_allclose(
        encode_srgb(np.array([-1.0, 0.002, 0.5, 2.0])), [0.0, 0.02584, 0.735357, 1.0], atol=1e-5
    )

"""The poster of a bundle: the whole object in the middle, exposed, in the light of the studio."""

import numpy as np
import pytest
from lambent_asset.bundle.poster import (
    FILLED,
    POSTER_SIZE,
    THUMBNAIL_SIZE,
    framed,
    poster,
    side_of,
    studio,
    try_poster,
    write_poster,
)
from lambent_proto.v1 import bundle_pb2
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.cameras import Camera, look_at, position_around
from PIL import Image
from support.baked_bundle import write_baked_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory):
    return load_bundle(write_baked_bundle(tmp_path_factory.mktemp("b") / "boxes"))


@pytest.mark.parametrize("elevation_deg", [-30.0, 0.0, 20.0, 80.0])
@pytest.mark.parametrize("shape", [(1.0, 1.0, 1.0), (4.0, 0.2, 0.2), (0.1, 0.1, 3.0)])
def test_every_object_fills_the_picture_without_leaving_it(shape, elevation_deg):
    vertices = np.random.default_rng(1).normal(size=(200, 3)) * shape + np.array([5.0, -2.0, 1.0])
    camera = framed(vertices, 33.0, elevation_deg)
    pose = camera.camera_to_world
    local = (vertices - pose[:3, 3]) @ pose[:3, :3]
    assert (local[:, 2] < 0.0).all()
    shares = local[:, :2] / -local[:, 2:] * camera.focal_x / np.array(POSTER_SIZE) * 2.0
    assert np.abs(shares).max(axis=0).max() == pytest.approx(FILLED, abs=0.03)
    middle = (shares.min(axis=0) + shares.max(axis=0)) / 2.0
    assert np.abs(middle).max() < 0.02


def test_the_view_is_that_of_the_photograph_that_looks_down_by_about_twenty_degrees(bundle, monkeypatch):
    target = np.array([*bundle.manifest.bounds.minimum]) + np.array([*bundle.manifest.bounds.maximum])
    angles = [(10.0, 70.0), (-120.0, 24.0), (60.0, 10.0), (80.0, -20.0)]
    places = [position_around(0.5 * target, 4.0, *each) for each in angles]
    cameras = [Camera.centred("c", 8, 8, 8.0, look_at(place, 0.5 * target)) for place in places]
    monkeypatch.setattr(type(bundle), "cameras", lambda _: cameras)
    assert side_of(bundle) == pytest.approx((-120.0, 24.0), abs=1e-3)


def test_the_light_of_the_studio_turns_with_the_camera():
    at_front, at_side = studio(0.0), studio(90.0)
    direction = np.array([[0.7, -0.5, 0.5]]) / np.linalg.norm([0.7, -0.5, 0.5])
    turned = direction @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert at_front.lookup(direction) == pytest.approx(at_side.lookup(turned), rel=0.05)


def test_a_poster_shows_the_object_in_front_of_the_backdrop(bundle):
    pixels = poster(bundle).astype(float)
    assert pixels.shape == (POSTER_SIZE[1], POSTER_SIZE[0], 3)
    assert np.abs(pixels[:8] - pixels[:8].mean(axis=-1, keepdims=True)).max() < 6.0
    # The block's red stands out from a grey backdrop; it is neither black nor burnt out.
    middle = pixels[300:460, 420:600].reshape(-1, 3)
    red = middle[middle[:, 0] > middle[:, 2] + 40.0]
    assert len(red) > 2000
    assert 60.0 < np.median(red[:, 0]) < 250.0


def test_the_files_are_whole_pictures_of_two_sizes(bundle, tmp_path):
    folder = write_baked_bundle(tmp_path / "boxes")
    write_poster(folder, bundle.manifest)
    for name, size in (("poster.webp", POSTER_SIZE), ("thumbnail.webp", THUMBNAIL_SIZE)):
        with Image.open(folder / name) as image:
            assert (image.format, image.size) == ("WEBP", size)
        assert (folder / name).stat().st_size < 150_000


def test_a_bundle_without_baked_transport_has_none(tmp_path):
    write_poster(tmp_path, bundle_pb2.BundleManifest())
    assert list(tmp_path.iterdir()) == []


def test_a_bundle_does_without_a_poster_that_cannot_be_made(tmp_path, monkeypatch):
    def fail(*_: object) -> None:
        (tmp_path / "poster.webp").write_bytes(b"half")
        raise ValueError("no light")

    monkeypatch.setattr("lambent_asset.bundle.poster.write_poster", fail)
    assert "no light" in try_poster(tmp_path, BundleManifest())
    assert not list(tmp_path.iterdir())

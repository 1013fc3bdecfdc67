"""Cameras around the object of a bundle show all of it, whatever its own cameras show."""

import math

import numpy as np
import pytest
from lambent_relight.baked.mesh import read_mesh
from lambent_relight.bundle.bundle import Bundle, load_bundle
from lambent_relight.cameras import Camera, turntable
from lambent_relight.object_cameras import around_object
from support.baked_bundle import SCENE, write_baked_bundle

VIEWS = 5
WIDE, NARROW = 100.0, 3.0


@pytest.fixture(scope="module", params=[WIDE, NARROW])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[float, Bundle]:
    """Return a field of view and a bundle with a camera that has it."""
    view = turntable(1, radius=9.0, width=64, height=64, field_of_view_deg=request.param)
    folder = tmp_path_factory.mktemp("boxes") / "boxes.relight"
    return request.param, load_bundle(write_baked_bundle(folder, SCENE, side=8, cameras=view))


def field_of_view_deg(camera: Camera) -> float:
    return math.degrees(2.0 * math.atan(0.5 * camera.width / camera.focal_x))


def share_of_the_picture(bundle: Bundle, cameras: list[Camera]) -> float:
    """Return how far the object reaches from the middle to the edge of the pictures, at most."""
    vertices, reach = read_mesh(bundle).vertices, []
    for camera in cameras:
        local = (vertices - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
        reach.append(np.abs(camera.focal_x * local[:, :2] / local[:, 2:]).max() / (0.5 * camera.width))
    return float(max(reach))


def test_the_own_field_of_view_is_widened_until_the_object_fits(seen: tuple[float, Bundle]):
    own_deg, bundle = seen
    cameras = around_object(bundle, VIEWS, size=32)
    if own_deg == WIDE:
        assert field_of_view_deg(cameras[0]) == pytest.approx(WIDE)
    else:
        assert share_of_the_picture(bundle, cameras) == pytest.approx(1.0 / 1.05)


def test_a_field_of_view_that_is_asked_for_is_kept(seen: tuple[float, Bundle]):
    (camera,) = around_object(seen[1], 1, size=32, field_of_view_deg=5.0)
    assert field_of_view_deg(camera) == pytest.approx(5.0)

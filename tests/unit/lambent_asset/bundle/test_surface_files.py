"""Figures about an asset."""

from dataclasses import fields

import numpy as np
import pytest
from lambent_asset.bundle.surface_files import pixel_size, silhouette_iou
from lambent_core.scene import Camera
from lambent_relight.baked.raster import rasterise
from lambent_relight.cameras import turntable
from support.atlas_box import SIZES, atlas_box

BOX = atlas_box()


def test_a_texel_covers_the_surface_divided_by_their_number():
    a, b, c = SIZES
    area = 2.0 * (a * b + b * c + c * a)
    assert BOX.texel_size**2 * len(BOX.texel_index) == pytest.approx(area, rel=1e-5)


def test_silhouettes_overlap_by_one_where_they_are_the_same_and_less_where_the_mesh_is_wrong():
    (camera,) = turntable(1, radius=6.0, width=48, height=48)
    exact = rasterise(BOX.vertices, BOX.faces, camera.resized(480, 480)).covered
    opacity = exact.reshape(48, 10, 48, 10).mean(axis=(1, 3)).astype(np.float32)[..., None]
    assert silhouette_iou(BOX, camera, opacity) > 0.98
    assert silhouette_iou(BOX, camera, np.roll(opacity, 6, axis=1)) < 0.8
    assert silhouette_iou(BOX, camera, np.zeros_like(opacity)) == 0.0


def test_the_size_of_a_pixel_is_that_at_the_middle_of_the_object():
    (camera,) = turntable(1, radius=6.0, elevation_deg=0.0, width=100, height=100, field_of_view_deg=90.0)
    values = {field.name: getattr(camera, field.name) for field in fields(Camera)}
    assert pixel_size((Camera(**values),), ((-1.0,) * 3, (1.0,) * 3)) == pytest.approx(6.0 / 50.0)
    assert pixel_size((), ((-1.0,) * 3, (1.0,) * 3)) == 0.0

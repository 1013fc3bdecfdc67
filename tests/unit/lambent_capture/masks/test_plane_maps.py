"""Maps between pictures and the support agree with the camera, lens distortion included."""

import numpy as np
from lambent_capture.masks.lattice import SCENE, Frame, Lattice, main_parts
from lambent_capture.masks.plane_maps import NOWHERE, OrthoGrid, seen_pixels, seen_texels, straight_rays
from lambent_capture.masks.support_plane import plane_at
from support.ball_on_table import table_cameras

GRID = OrthoGrid(
    plane=plane_at(np.array([0.1, 0.0, 0.6]), np.array([0.0, 0.0, 1.0]), 0.0), half=1.2, cells=150
)
(CAMERA,) = table_cameras(1)


def centres() -> np.ndarray:
    along = (np.arange(150) + 0.5) * GRID.texel - GRID.half
    u, v = np.meshgrid(along, along)
    return GRID.plane.world(np.stack([u, v, 0 * u], axis=-1).reshape(-1, 3))


def test_texels_are_seen_where_the_camera_projects_them():
    column, row, depth = CAMERA.project(centres())
    shown = (depth > 0) & (column > 0) & (column < CAMERA.width) & (row > 0) & (row < CAMERA.height)
    found = seen_pixels(CAMERA, GRID).reshape(-1, 2)
    assert shown.sum() > 5000
    assert np.abs(found[shown] - np.stack([column, row], axis=-1)[shown] + 0.5).max() < 0.05
    away = (column < -1) | (column > CAMERA.width + 1) | (row < -1) | (row > CAMERA.height + 1)
    assert (found[away] == NOWHERE).all()


def test_pixels_see_the_texels_that_are_projected_on_them():
    texels = seen_texels(CAMERA, GRID)
    hit = texels[..., 0] > NOWHERE
    local = (texels[hit].astype(float) + 0.5) * GRID.texel - GRID.half
    column, row, _ = CAMERA.project(GRID.plane.world(np.column_stack([local, np.zeros(len(local))])))
    rows, columns = np.nonzero(hit)
    assert hit.sum() > 5000
    assert np.abs(column - columns - 0.5).max() < 0.05
    assert np.abs(row - rows - 0.5).max() < 0.05


def test_rays_without_distortion_are_those_of_the_pinhole():
    (camera,) = table_cameras(1, distortion=())
    points = camera.position + 2.0 * straight_rays(camera)[40, 70]
    column, row, depth = camera.project(points[None].astype(float))
    assert np.allclose([column[0], row[0], depth[0]], [70.5, 40.5, 2.0], atol=1e-3)


def test_cells_are_seen_by_the_pixels_that_the_camera_projects_them_on():
    frame = Frame(origin=np.array([0.1, -0.2, 0.0]), axes=GRID.plane.axes)
    lattice = Lattice.between(frame, np.array([-1.0, -1.2, 0.0]), np.array([1.0, 1.2, 1.8]), 30)
    everything = np.ones(lattice.size, dtype=bool)
    shown, index, _ = CAMERA.pixels(frame.world(lattice.local(everything)))
    found = lattice.pixels(CAMERA)
    assert (found[~shown] == -1).mean() > 0.999
    assert (found[shown] == index[shown]).mean() > 0.995


def test_parts_beside_the_middle_are_left_out_and_parts_near_it_stay():
    lattice = Lattice.between(SCENE, -np.ones(3), np.ones(3), 20)
    solid = np.zeros(lattice.shape, dtype=bool)
    solid[8:12, 8:12, :6] = True
    solid[13:15, 8:12, :6] = True
    solid[0:4, 0:4, :10] = True
    kept = main_parts(solid.ravel(), lattice, np.zeros(3), 2.0).reshape(lattice.shape)
    assert kept[8:12, 8:12, :6].all()
    assert kept[13:15, 8:12, :6].all()
    assert not kept[0:4, 0:4].any()

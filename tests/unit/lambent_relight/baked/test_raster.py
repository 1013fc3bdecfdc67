"""Triangles in pictures and atlases, against rays cast one by one."""

import numpy as np
import pytest
from lambent_relight.baked.raster import (
    block_means,
    interpolate,
    nearest_texel,
    rasterise,
    rasterise_uv,
)
from lambent_relight.cameras import Camera, look_at, turntable
from scipy import ndimage

RNG = np.random.default_rng(3)
TRIANGLES = RNG.normal(size=(40, 3, 3)).reshape(-1, 3)
FACES = np.arange(120).reshape(-1, 3)
CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
CUBE_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def camera(position, width=48, height=32) -> Camera:
    return Camera(
        name="test",
        width=width,
        height=height,
        focal_x=40.0,
        focal_y=44.0,
        centre_x=width / 2 + 3.0,
        centre_y=height / 2 - 2.0,
        camera_to_world=look_at(position, (0.1, 0.0, 0.2)),
    )


def cast(view: Camera, vertices, faces):
    """Return distance [pixel, face] (inf where missed) and hit weights, by Moeller and Trumbore."""
    origins, directions = (values.astype(np.float64)[:, None] for values in view.rays())
    a, b, c = (vertices[faces[:, k]][None] for k in range(3))
    p = np.cross(directions, c - a)
    scale = 1.0 / (p * (b - a)).sum(-1)
    u = ((origins - a) * p).sum(-1) * scale
    q = np.cross(origins - a, b - a)
    v = (directions * q).sum(-1) * scale
    t = ((c - a) * q).sum(-1) * scale
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.where(hit, t, np.inf), u, v


@pytest.mark.parametrize("position", [(4.0, 1.0, 2.0), (0.3, 0.2, 0.1)], ids=["outside", "inside"])
def test_every_pixel_shows_what_its_ray_hits_first(position):
    view = camera(position)
    found = rasterise(TRIANGLES, FACES, view, num_threads=1)
    distance, u, v = cast(view, TRIANGLES, FACES)
    nearest = distance.argmin(axis=1)
    rows = np.arange(len(nearest))
    expected = np.where(np.isfinite(distance.min(axis=1)), nearest, -1).reshape(32, 48)
    same = found.face == expected
    assert same.mean() > 0.999
    assert np.array_equal(np.isinf(found.depth), ~found.covered)
    hit = same & found.covered
    assert np.allclose(found.depth[hit], distance.min(axis=1).reshape(32, 48)[hit], rtol=1e-4)
    weights = np.stack([u[rows, nearest], v[rows, nearest]], -1).reshape(32, 48, 2)
    assert np.allclose(found.barycentric[hit], weights[hit], atol=2e-3)


def test_threads_change_nothing():
    view = camera((4.0, 1.0, 2.0), 60, 200)
    one, two = (rasterise(TRIANGLES, FACES, view, num_threads=n) for n in (1, 2))
    assert np.array_equal(one.face, two.face)
    assert np.array_equal(one.depth, two.depth)


def test_a_closed_surface_around_the_camera_has_no_gaps():
    for position in RNG.uniform(-0.9, 0.9, size=(10, 3)):
        assert rasterise(CUBE, CUBE_FACES, camera(position)).covered.all()


def test_interpolated_positions_lie_on_the_rays_of_their_pixels():
    (view,) = turntable(1, radius=4.0, width=64, height=64)
    found = rasterise(CUBE, CUBE_FACES, view)
    positions = interpolate(found, CUBE_FACES, CUBE)
    origins, directions = view.rays()
    along = origins + directions * found.depth.reshape(-1, 1)
    assert np.allclose(positions, along[found.covered.ravel()], atol=1e-5)


def test_a_face_behind_the_camera_is_not_seen():
    triangle = np.array([[5.0, -1.0, -1.0], [5.0, 1.0, -1.0], [5.0, 0.0, 1.0]])
    assert not rasterise(triangle, np.array([[0, 1, 2]]), camera((4.0, 0.0, 0.0))).covered.any()


def test_texel_centres_inside_a_chart_are_covered_and_carry_its_uv():
    uv = np.array([[0.1, 0.2], [0.9, 0.2], [0.9, 0.8], [0.1, 0.8]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    found = rasterise_uv(uv, faces, 20)
    rows, columns = np.nonzero(found.covered)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (4, 15, 2, 17)
    assert found.covered.sum() == 12 * 16
    centres = np.stack([(columns + 0.5) / 20, (rows + 0.5) / 20], -1)
    assert np.allclose(interpolate(found, faces, uv), centres, atol=1e-6)


def test_charts_are_drawn_whichever_way_they_turn():
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    assert rasterise_uv(uv, np.array([[0, 1, 2]]), 8).covered.sum() == 36
    assert rasterise_uv(uv, np.array([[0, 2, 1]]), 8).covered.sum() == 36


def test_gutters_take_the_value_of_a_nearest_texel():
    covered = ndimage.gaussian_filter(RNG.normal(size=(64, 64)), 3.0) > 0.02
    index = np.flatnonzero(covered)
    owner = nearest_texel(index, 64)
    assert np.array_equal(owner.ravel()[index], np.arange(len(index)))
    rows, columns = np.divmod(index[owner], 64)
    here = np.indices((64, 64))
    distance = np.hypot(rows - here[0], columns - here[1])
    exact = ndimage.distance_transform_edt(~covered)
    assert (distance <= exact + 1.0).all()
    assert (distance[exact <= 3.0] == exact[exact <= 3.0]).all()


def test_block_means_average_each_block():
    image = np.arange(24.0).reshape(4, 6)
    assert np.allclose(block_means(image, 2), [[3.5, 5.5, 7.5], [15.5, 17.5, 19.5]])

"""Charts of a mesh and their tangents."""

import numpy as np
import pytest
from lambent_asset.mesh import atlas
from lambent_asset.mesh.atlas import (
    PADDING,
    SIZE_STEP,
    angle_weighted_normals,
    covered_share,
    size_within,
    tangents,
    unwrap,
)
from lambent_asset.mesh.mesh import Mesh
from lambent_core.errors import WorkerError
from lambent_relight.baked.raster import rasterise_uv
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes
from support.atlas_box import atlas_box


@pytest.fixture(scope="module")
def ball():
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 16)] * 3, indexing="ij"))
    vertices, faces, _, _ = marching_cubes(0.8 - np.linalg.norm(grid, axis=0), 0.0, spacing=(2.0 / 15,) * 3)
    return Mesh((vertices - 1.0).astype(np.float32), faces[:, ::-1].astype(np.int32), 2.0 / 15)


@pytest.fixture(scope="module")
def charts(ball):
    return unwrap(ball, 128)


def test_charts_lie_in_the_atlas_and_do_not_overlap(ball, charts):
    assert charts.uv.min() >= 0.0
    assert charts.uv.max() <= 1.0
    a, b, c = (charts.uv[charts.faces[:, k]].astype(np.float64) * 128 for k in range(3))
    p, q = (b - a).T, (c - a).T
    area = 0.5 * np.abs(p[0] * q[1] - p[1] * q[0])
    covered = rasterise_uv(charts.uv, charts.faces, 128).covered.sum()
    assert covered == pytest.approx(area.sum(), rel=0.03)
    assert 0.35 < covered / 128**2 < 1.0


def test_charts_fill_the_atlas_whatever_baked_transport_may_cover(charts):
    share = covered_share(charts.uv, charts.faces)
    # One side is used to its end, but for the padding.
    assert charts.uv.max() > 1.0 - 2.0 * PADDING / 128
    assert share > 0.45
    size = size_within(charts, 128, share=0.3)
    assert share * size**2 <= 0.3 * 128**2 < share * (size + SIZE_STEP) ** 2
    covered = rasterise_uv(charts.uv, charts.faces, size).covered.sum()
    assert covered == pytest.approx(share * size**2, rel=0.05)
    # A share that charts do not reach leaves the size as it is.
    assert size_within(charts, 128, share=1.0) == 128


def test_charts_do_not_touch_at_the_size_of_transport(charts):
    size = size_within(charts, 128, share=0.4)
    found = rasterise_uv(charts.uv, charts.faces, size)
    number = chart_numbers(charts)[found.face]
    for down, across in ((0, 1), (1, 0), (1, 1)):
        a, b = (number[: size - down, : size - across], number[down:, across:])
        both = found.covered[: size - down, : size - across] & found.covered[down:, across:]
        assert (a == b)[both].all()


def chart_numbers(charts) -> np.ndarray:
    """Return the chart of every face: faces that share a vertex, for vertices are split along seams."""
    shared = sparse.coo_array(
        (np.ones(charts.faces.size), (np.repeat(np.arange(len(charts.faces)), 3), charts.faces.ravel()))
    )
    return connected_components(shared @ shared.T)[1]


def test_the_split_mesh_is_the_same_surface(ball, charts):
    assert np.array_equal(ball.vertices[charts.source][charts.faces], ball.vertices[ball.faces])


def test_charts_are_not_stretched(ball, charts):
    edges = [(0, 1), (1, 2), (2, 0)]
    corners, places = ball.vertices[ball.faces], charts.uv[charts.faces]
    ratio = np.concatenate(
        [
            np.linalg.norm(places[:, j] - places[:, i], axis=1)
            / np.linalg.norm(corners[:, j] - corners[:, i], axis=1)
            for i, j in edges
        ]
    )
    assert np.percentile(ratio, 95) < 2.0 * np.percentile(ratio, 5)


def test_normals_of_a_ball_point_outwards(ball):
    outwards = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    assert (angle_weighted_normals(ball.vertices, ball.faces) * outwards).sum(-1).min() > 0.97


def test_tangents_point_along_u_and_bitangents_to_falling_v():
    box = atlas_box()
    found = tangents(box.vertices, box.faces, box.uv, box.normals)
    assert set(found[:, 3]) == {-1.0, 1.0}
    bitangent = found[:, 3:] * np.cross(box.normals, found[:, :3])
    for face in box.faces:
        a, b, c = box.vertices[face].astype(np.float64)
        edges = np.stack([b - a, c - a])
        steps = (box.uv[face[1:]] - box.uv[face[0]]).astype(np.float64)
        along_u, along_v = np.linalg.solve(steps, edges)
        assert np.allclose(found[face[0], :3], along_u / np.linalg.norm(along_u), atol=1e-5)
        assert np.allclose(bitangent[face[0]], -along_v / np.linalg.norm(along_v), atol=1e-5)


def test_tangents_are_unit_and_perpendicular_to_the_normal(ball, charts):
    normals = angle_weighted_normals(ball.vertices, ball.faces)[charts.source]
    found = tangents(ball.vertices[charts.source], charts.faces, charts.uv, normals)
    assert np.allclose(np.linalg.norm(found[:, :3], axis=1), 1.0, atol=1e-5)
    assert np.abs((found[:, :3] * normals).sum(-1)).max() < 1e-5


def test_a_chart_without_area_gets_some_tangent():
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    normals = np.tile([0.0, 0.0, 1.0], (3, 1))
    found = tangents(vertices, np.array([[0, 1, 2]]), np.zeros((3, 2)), normals)
    assert np.allclose(np.linalg.norm(found[:, :3], axis=1), 1.0)
    assert np.allclose(found[:, 2], 0.0)


def test_more_than_one_atlas_is_refused(ball, monkeypatch):
    class Two(atlas.xatlas.Atlas):
        @property
        def atlas_count(self) -> int:
            return 2

    monkeypatch.setattr(atlas.xatlas, "Atlas", Two)
    with pytest.raises(WorkerError, match=r"export\.transport_size") as raised:
        unwrap(ball, 64)
    assert raised.value.code == "export.atlas"

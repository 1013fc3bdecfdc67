"""Closed pieces that are inside out are turned, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from lambent_asset.given_mesh.outwards import turned_outwards
from lambent_relight.tracing.mesh_rays import MeshRays
from support.given_glb import given_mesh


def given(*pieces):
    """Return the trimesh `pieces` as one mesh."""
    whole = trimesh.util.concatenate(pieces)
    return given_mesh(whole.vertices, whole.faces, normals=np.asarray(whole.vertex_normals, np.float32))


def ball(radius=1.0, centre=(0.0, 0.0, 0.0), *, inside_out=False):
    made = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    made.apply_translation(centre)
    if inside_out:
        made.invert()
    return made


def facing(mesh, centre=(0.0, 0.0, 0.0)):
    """Return the share of triangles that face away from `centre`."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(((np.cross(b - a, c - a) * (a - np.float32(centre))).sum(axis=1) > 0.0).mean())


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (7.0, -3.0, 2.0)])
def test_a_ball_that_is_inside_out_is_turned_with_its_normals_and_stops_rays(centre):
    wrong = given(ball(centre=centre, inside_out=True))
    mesh, count = turned_outwards(wrong)
    assert (facing(wrong, centre), facing(mesh, centre), count) == (0.0, 1.0, 1)
    assert ((mesh.normals * (mesh.vertices - np.float32(centre))).sum(axis=1) > 0.9).all()
    start = np.float32([centre]) + np.float32([[3.0, 0.01, 0.02]])
    towards = np.float32([[-1.0, 0.0, 0.0]])
    met = MeshRays(mesh.vertices, mesh.faces)(start, towards)
    assert met.blocked.all()
    assert met.distance[0] == pytest.approx(2.0, abs=0.05)


def test_normals_that_pointed_outwards_already_stay():
    wrong = given(ball(inside_out=True))
    right = replace(wrong, normals=-wrong.normals)
    mesh, count = turned_outwards(right)
    assert count == 1
    np.testing.assert_array_equal(mesh.normals, right.normals)


def test_only_the_piece_that_is_inside_out_is_turned():
    mesh, count = turned_outwards(given(ball(), ball(0.5, (3.0, 0.0, 0.0), inside_out=True)))
    faces = len(ball().faces)
    assert count == 1
    np.testing.assert_array_equal(mesh.faces[:faces], ball().faces)
    assert facing(replace(mesh, faces=mesh.faces[faces:]), (3.0, 0.0, 0.0)) == 1.0


def test_the_wall_of_a_hollow_faces_the_hollow():
    hollow = given(ball(), ball(0.8, inside_out=True))
    mesh, count = turned_outwards(hollow)
    assert count == 0
    assert mesh is hollow
    # Beside it, within the box but not within the ball, the same piece is not a hollow.
    beside = given(ball(), ball(0.1, (0.8, 0.8, 0.8), inside_out=True))
    assert turned_outwards(beside)[1] == 1


def test_what_is_open_or_right_stays_as_it_is():
    cap = ball(inside_out=True)
    cap.update_faces(cap.triangles_center[:, 2] < 0.7)
    for mesh in (given(cap), given(ball())):
        same, count = turned_outwards(mesh)
        assert count == 0
        assert same is mesh


def test_seams_do_not_open_a_mesh():
    split = ball(inside_out=True)
    loose = trimesh.Trimesh(
        split.triangles.reshape(-1, 3), np.arange(3 * len(split.faces)).reshape(-1, 3), process=False
    )
    mesh, count = turned_outwards(given(loose))
    assert (count, facing(mesh)) == (1, 1.0)
    assert ((mesh.normals * mesh.vertices).sum(axis=1) > 0.9).all()

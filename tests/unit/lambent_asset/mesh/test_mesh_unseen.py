"""The part of a box that no photograph shows: which it is, how it is closed, and its colours."""

import numpy as np
import pytest
from lambent_asset.mesh.mesh import Mesh
from lambent_asset.mesh.mesh_unseen import closed_smoothly, plain_where_unseen, unseen_vertices
from lambent_core.scene import View
from support.square_views import mesh_of, square_camera

SIDE = 64
CELL = 2.0 / 39


def box(bumps: float, hollow: float = 0.0) -> Mesh:
    """Return a box whose underside, around z = -0.4, has bumps, and whose top may have a hollow."""
    x, y, z = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 40)] * 3, indexing="ij"))
    under = -0.4 + bumps * np.sin(11.0 * x) * np.sin(13.0 * y) - 1.3 * hollow * np.exp(-8.0 * (x * x + y * y))
    top = 0.4 - hollow * np.exp(-8.0 * (x * x + y * y))
    sides = np.minimum(0.7 - np.abs(x), 0.7 - np.abs(y))
    return mesh_of(np.minimum(sides, np.minimum(z - under, top - z)))


def view(place: tuple[float, float, float], alpha: float = 1.0, name: str = "a") -> View:
    image = np.full((SIDE, SIDE, 4), alpha, np.float32)
    return View(name=name, camera=square_camera(place, SIDE, 100.0), images={"day": image})


def ring(height: float = 2.0, alpha: float = 1.0) -> tuple[View, ...]:
    angles = np.arange(8) * np.pi / 4
    return tuple(
        view((4.0 * np.cos(a), 4.0 * np.sin(a), height), alpha, name=f"v{k}") for k, a in enumerate(angles)
    )


@pytest.fixture(scope="module")
def bumpy() -> Mesh:
    return box(0.06)


def test_cameras_above_see_all_but_the_underside(bumpy):
    unseen = unseen_vertices(bumpy, ring())
    x, y, z = bumpy.vertices.T
    inner = (np.abs(x) < 0.55) & (np.abs(y) < 0.55)
    assert unseen[inner & (z < 0.0)].all()
    assert not unseen[inner & (z > 0.0)].any()
    assert not unseen[(z > -0.2)].any()


def test_cameras_all_around_see_all(bumpy):
    assert not unseen_vertices(bumpy, ring() + ring(-2.0)).any()


def test_what_photographs_show_as_empty_was_not_seen(bumpy):
    assert unseen_vertices(bumpy, ring(alpha=0.0)).all()
    assert not unseen_vertices(bumpy, ()).any()


def test_a_surface_just_behind_another_that_is_seen_was_not_seen():
    """A plate thinner than the tolerance: its underside faces away."""
    x, y, z = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 40)] * 3, indexing="ij"))
    plate = mesh_of(np.minimum(np.minimum(0.7 - np.abs(x), 0.7 - np.abs(y)), 0.6 * CELL - np.abs(z - 0.01)))
    unseen = unseen_vertices(plate, ring())
    inner = (np.abs(plate.vertices[:, 0]) < 0.5) & (np.abs(plate.vertices[:, 1]) < 0.5)
    under = plate.vertices[:, 2] < 0.01
    assert unseen[inner & under].all()
    assert not unseen[inner & ~under].any()


def test_the_unseen_is_evened_out_and_the_seen_stays_where_it_is(bumpy):
    unseen = unseen_vertices(bumpy, ring())
    found, still = closed_smoothly(bumpy, unseen)
    assert np.array_equal(found.faces, bumpy.faces)
    assert np.array_equal(still, unseen)
    assert np.array_equal(found.vertices[~unseen], bumpy.vertices[~unseen])
    inner = unseen & (np.abs(bumpy.vertices[:, :2]) < 0.5).all(axis=1)
    assert found.vertices[inner, 2].std() < 0.15 * bumpy.vertices[inner, 2].std()
    assert found.vertices[inner, 2].mean() == pytest.approx(-0.4, abs=0.08)


def test_the_unseen_stays_behind_a_seen_hollow():
    """The hollow of the top reaches below the rim of the underside, which follows it at a distance."""
    bowl = box(0.0, hollow=0.9)
    above = bowl.vertices[:, 2] > -0.35
    radius = np.linalg.norm(bowl.vertices[:, :2], axis=1)
    depth_of_top = 0.4 - 0.9 * np.exp(-8.0 * radius**2)
    unseen = ~above & (bowl.vertices[:, 2] < depth_of_top - 0.5 * CELL) & (radius < 0.6)
    found, still = closed_smoothly(bowl, unseen)
    assert still.sum() == unseen.sum() > 200
    moved = found.vertices[unseen]
    top = 0.4 - 0.9 * np.exp(-8.0 * (moved[:, :2] ** 2).sum(-1))
    assert (moved[:, 2] < top).all()
    assert np.abs(moved - bowl.vertices[unseen]).max() > CELL


def test_a_piece_that_was_not_seen_at_all_is_left_out(bumpy):
    count = len(bumpy.vertices)
    vertices = np.concatenate([bumpy.vertices, bumpy.vertices * 0.1 - np.float32([0.0, 0.0, 2.0])])
    both = Mesh(vertices, np.concatenate([bumpy.faces, bumpy.faces + count]), CELL)
    unseen = np.arange(2 * count) >= count
    found, still = closed_smoothly(both, unseen)
    assert len(found.faces) == len(bumpy.faces)
    assert not still.any()
    nothing = np.ones(2 * count, bool)
    assert closed_smoothly(both, nothing)[0] is both


def test_unseen_texels_take_means_of_seen_ones_near_by():
    random = np.random.default_rng(0)
    positions = random.random((600, 3)) * [1.0, 1.0, 0.0]
    unseen = np.abs(positions[:, 0] - 0.5) < 0.2
    colours = np.where(positions[:, :1] < 0.5, 0.2, 0.8).astype(np.float32)
    colours[unseen] = 9.0
    found = plain_where_unseen(colours, positions, unseen)
    assert np.array_equal(found[~unseen], colours[~unseen])
    assert found.max() <= 0.8 + 1e-6
    left = unseen & (positions[:, 0] < 0.36)
    right = unseen & (positions[:, 0] > 0.64)
    assert found[left].mean() < 0.3
    assert found[right].mean() > 0.7
    assert plain_where_unseen(colours, positions, np.ones(600, bool)) is colours

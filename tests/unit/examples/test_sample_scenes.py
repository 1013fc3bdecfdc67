"""The parts of the rendered scenes that need no renderer: meshes, profiles, lights, numbers of materials."""

import numpy as np
import pytest
from sample_environments import MEAN_RADIANCE, directions
from sample_scenes import breakfast
from sample_scenes.catalogue import SCENES
from sample_scenes.lights import LIGHTS, light_image
from sample_scenes.shapes import Triangles, lathe, ring, rotation, rounded, solid, wound
from scipy import ndimage
from tabletop.distance import ball

ARC = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 121)
GLOBE = 0.5 * np.stack([np.cos(ARC), np.sin(ARC)], axis=-1)
BALL = 4.0 / 3.0 * np.pi * 0.5**3
MADE = {
    "lathe": (lathe(GLOBE), BALL),
    "wound": (wound(GLOBE), BALL),
    "ring": (ring(0.5, 0.1), 2.0 * np.pi**2 * 0.5 * 0.1**2),
    "solid": (solid(lambda p: ball(p, (0, 0, 0), 0.5), (-0.6,) * 3, (0.6,) * 3, 48), BALL),
}


def volume(mesh: Triangles) -> float:
    """Return the volume that the faces enclose, whichever way round they run."""
    a, b, c = (mesh.positions[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    return abs(float(np.einsum("fk,fk->f", a, np.cross(b, c)).sum() / 6.0))


def open_edges(mesh: Triangles) -> int:
    """Return how many edges do not lie between exactly two faces, vertices at one place being one."""
    _, merged = np.unique(np.round(mesh.positions, 6), axis=0, return_inverse=True)
    faces = merged.ravel()[mesh.faces]
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=-1)
    _, count = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0, return_counts=True)
    return int((count % 2 != 0).sum())


@pytest.mark.parametrize("name", MADE)
def test_a_mesh_is_closed_and_holds_the_volume_of_its_shape(name: str):
    mesh, expected = MADE[name]
    assert open_edges(mesh) == 0
    assert volume(mesh) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", ["lathe", "wound", "solid"])
def test_the_normals_of_a_ball_point_outwards(name: str):
    mesh, _ = MADE[name]
    inner = np.abs(mesh.positions[:, 2]) < 0.49
    np.testing.assert_allclose(mesh.normals[inner], 2.0 * mesh.positions[inner], atol=2e-3)


def test_a_placed_mesh_is_turned_and_then_moved():
    mesh = ring(0.5, 0.1)
    moved = mesh.placed((0.0, 0.0, 2.0), rotation(0, 90.0))
    np.testing.assert_allclose(moved.positions[:, 2], mesh.positions[:, 1] + 2.0, atol=1e-12)
    np.testing.assert_allclose(moved.normals[:, 1], -mesh.normals[:, 2], atol=1e-12)


def test_a_rounded_profile_passes_through_its_knots_and_keeps_a_doubled_one_as_a_corner():
    knots = [(0.1, 0.0), (0.5, 0.0), (0.5, 0.0), (0.5, 0.6), (0.2, 0.8)]
    curve = rounded(knots, steps=8)
    for knot in knots:
        assert np.linalg.norm(curve - knot, axis=-1).min() < 1e-9
    along = curve[curve[:, 1] < 1e-9]
    assert np.ptp(along[:, 1]) < 1e-9, "the straight piece before the corner stays straight"


def test_the_cloth_is_closed_and_thin():
    cloth = breakfast._napkin()
    assert open_edges(cloth) == 0
    assert np.linalg.norm(cloth.positions, axis=-1).max() < 1.3
    np.testing.assert_allclose(np.linalg.norm(cloth.normals, axis=-1), 1.0, atol=1e-6)


@pytest.mark.parametrize("name", LIGHTS)
def test_lights_have_the_mean_radiance_of_all(name: str):
    image = light_image(name, height=32)
    weight = np.sqrt(1.0 - directions(32, 64)[:, 0, 2] ** 2)
    assert (image.mean(axis=(1, 2)) * weight).sum() / weight.sum() == pytest.approx(MEAN_RADIANCE, rel=1e-4)


@pytest.mark.slow
def test_three_small_lamps_carry_most_of_the_light_of_the_lamps_scene():
    scene = SCENES["lamps"]
    image = scene.light(scene.train_light)
    solid_angle = np.sqrt(1.0 - directions(*image.shape[:2])[:, :1, 2] ** 2)
    solid_angle = solid_angle / solid_angle.sum() * 4.0 * np.pi / image.shape[1]
    power = image.mean(axis=-1) * solid_angle
    lamps = image.mean(axis=-1) > 50.0
    assert ndimage.label(lamps)[1] == 3
    assert power[lamps].sum() > 0.75 * power.sum()
    covered = np.broadcast_to(solid_angle, lamps.shape)[lamps].sum()
    assert covered < 2 * 3 * np.pi * np.radians(0.9) ** 2, "half of it are pixels at the lamps' edges"


def test_uniform_materials_are_numbered_and_textured_ones_are_not():
    numbered = SCENES["still_life"].uniform_surfaces
    assert list(numbered) == [1, 2, 3, 4]
    assert [numbered[k].perceptual_roughness for k in numbered] == [0.28, 0.85, 0.65, 0.20]


@pytest.mark.parametrize("name", SCENES)
def test_uniform_materials_of_a_scene_can_be_told_apart(name: str):
    numbered = SCENES[name].uniform_surfaces.values()
    looks = {(*surface.base_colour, surface.perceptual_roughness, surface.metallic) for surface in numbered}
    assert len(looks) == len(numbered) >= 2

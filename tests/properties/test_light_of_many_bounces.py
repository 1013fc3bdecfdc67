"""Refined pictures with a number of reflections: sums of powers, and brute force."""

import numpy as np
import pytest
from lambent_relight.brdf import DIELECTRIC_F0, materials_from_roughness
from lambent_relight.bundle.graphs import PointMaterials, SecondaryHits
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import outgoing_radiance
from lambent_relight.refined.surroundings import CacheSurroundings
from support.statistics import assert_mean

ALBEDO, OPACITY = 0.6, 0.7
FAR = 1e4


class Wall:
    """Every ray ends at a wall that faces it, `OPACITY` of it: a closed room with a milky wall."""

    name = "wall"

    def secondary(self, origin, direction):
        ones = np.ones((len(origin), 1), np.float32)
        # Each wall is so much further away than the one before that it lies along the ray's own direction.
        return SecondaryHits(OPACITY * ones, FAR * (1.0 + np.linalg.norm(origin, axis=1, keepdims=True)))

    def material(self, position):
        ones = np.ones((len(position), 1), np.float32)
        towards = -position / np.linalg.norm(position, axis=1, keepdims=True)
        return PointMaterials(ALBEDO * ones * np.ones(3, np.float32), ones, 0 * ones, towards)


def reflectance() -> float:
    """Return what a dielectric of roughness 1 reflects of even light, seen straight on, by quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    cosine = 0.5 * (nodes + 1.0)
    # The half vector of the normal and a direction lies at half its angle.
    half = np.sqrt(0.5 * (1.0 + cosine))
    fresnel = DIELECTRIC_F0 + (1.0 - DIELECTRIC_F0) * (1.0 - half) ** 5
    shadowing = cosine / (0.5 * cosine + 0.5)
    specular = fresnel * shadowing / (np.pi * 4.0)
    return float(np.sum(0.5 * weights * 2.0 * np.pi * (ALBEDO / np.pi * cosine + specular)))


@pytest.mark.parametrize("bounces", [1, 2, 3, 5])
def test_light_in_a_milky_room_is_a_sum_of_powers(bounces):
    count = 4000
    up = np.tile(np.array([[0.0, 0.0, 1.0]], np.float32), (count, 1))
    ones = np.ones((count, 1), np.float32)
    materials = materials_from_roughness(ALBEDO * np.ones((count, 3), np.float32), ones, 0 * ones)
    sky = environment_from_array(np.ones((4, 8, 3)))
    scene = Scene(
        CacheSurroundings(Wall(), 0.0, MaterialEdit()), Light(sky, LightSampler(sky)), most_bounces=bounces
    )
    found = outgoing_radiance(SurfacePoints(0 * up, up, up, materials), scene, num_samples=4, seed=3)
    each = reflectance()
    expected = each * (1.0 - OPACITY) * sum((OPACITY * each) ** k for k in range(bounces))
    assert_mean(found.direct + found.indirect, np.full(3, expected), expected_error=2e-5)
    assert (found.indirect.mean() == 0.0) == (bounces == 1)

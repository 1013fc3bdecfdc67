"""Diffusely reflected indirect light that is known beforehand lowers the noise and moves no mean."""

import numpy as np
import pytest
from lambent_relight.brdf import materials_from_roughness
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.bundle.graphs import OnnxCaches
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import Environment, environment_from_array
from lambent_relight.refined.known_light import KnownLight, Spread
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import outgoing_radiance
from lambent_relight.refined.surroundings import CacheSurroundings
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Plane, Surface
from support.brute_force import reflected_samples
from support.onnx_expressions import NumpyOps
from support.statistics import assert_mean

WALLS = (Surface(albedo=(0.9, 0.3, 0.2)), Surface(albedo=(0.2, 0.8, 0.3), perceptual_roughness=0.6))
CORNER = AnalyticScene((Plane((0, 0, 0), (0, 0, 1), WALLS[0]), Plane((0, 0, 0), (1, 0, 0), WALLS[1])))


def sky() -> Environment:
    """Return a map with a bright window in a dim, coloured sky."""
    image = np.random.default_rng(0).uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    image[1, 5] += np.array([8.0, 7.0, 5.0], np.float32)
    return environment_from_array(image)


@pytest.fixture(scope="module")
def caches(tmp_path_factory):
    folder = write_analytic_bundle(tmp_path_factory.mktemp("corner") / "a.relight", CORNER)
    return OnnxCaches(load_bundle(folder), num_threads=1)


def between_the_walls(count: int) -> SurfacePoints:
    """Return the same point `count` times."""
    where = np.tile([[0.5, 0.0, 0.0]], (count, 1))
    omega_o = np.array([[2.0, 1.0, 1.5]]) - where
    omega_o /= np.linalg.norm(omega_o, axis=-1, keepdims=True)
    albedo, roughness, metalness, normal = (
        np.asarray(a, np.float32) for a in CORNER.surface_at(NumpyOps, where)
    )
    materials = materials_from_roughness(albedo, roughness, metalness)
    return SurfacePoints(where.astype(np.float32), normal, omega_o.astype(np.float32), materials)


def lit(caches, known, *, count=2000, seed=2, num_samples=16, indirect=True):
    """Return the radiance of the point, if the renderer knows of `known`."""
    around = CacheSurroundings(caches, CORNER.origin_offset, MaterialEdit())
    scene = Scene(around, Light(sky(), LightSampler(sky())), indirect=indirect)
    return outgoing_radiance(between_the_walls(count), scene, num_samples=num_samples, seed=seed, known=known)


def diffuse_bounce(caches, count, monkeypatch):
    """Return the indirect light [3] that the diffuse lobe of the point reflects, as rays find it."""
    everywhere = KnownLight(np.zeros((count, 3), np.float32), np.ones(count, bool))
    parts = []
    for share in (0.0, 1.0):
        with monkeypatch.context() as patch:
            patch.setattr(
                Spread, "best_shares", lambda self, mean, share=share: np.full((2, len(mean)), share)
            )
            parts.append(lit(caches, everywhere, num_samples=128).indirect)
    return (parts[1] - parts[0]).mean(axis=0)


def test_known_diffuse_light_lowers_the_noise_and_no_mean(caches, monkeypatch):
    count = 2000
    radiance = np.tile(diffuse_bounce(caches, count, monkeypatch), (count, 1))
    known = lit(caches, KnownLight(radiance, np.ones(count, bool)))
    total = (known.direct + known.indirect).astype(np.float64)
    points = between_the_walls(128 * count)
    expected = reflected_samples(
        CORNER,
        points.position.astype(np.float64),
        points.omega_o.astype(np.float64),
        sky().lookup,
        rng=np.random.default_rng(7),
        bounces=1,
    )
    expected = expected.reshape(count, 128, 3).mean(axis=1)
    assert_mean(total - expected, np.zeros(3))
    spread = (total - total.mean(axis=0)) ** 2 * count / (count - 1)
    assert_mean(spread - known.standard_error.astype(np.float64) ** 2, np.zeros(3))
    looked_for = lit(caches, None)
    assert (known.standard_error**2).mean() < 0.99 * (looked_for.standard_error**2).mean()


def test_light_that_is_known_changes_nothing_but_the_indirect_light_where_it_is(caches):
    count = 300
    looked_for = lit(caches, None, count=count)
    there = np.arange(count) % 3 > 0
    radiance = np.float32(1.0) * np.tile(there[:, None], (1, 3))
    found = lit(caches, KnownLight(radiance, there), count=count)
    for name in ("direct", "specular", "visibility"):
        np.testing.assert_array_equal(getattr(found, name), getattr(looked_for, name))
    elsewhere = ~there
    np.testing.assert_array_equal(found.indirect[elsewhere], looked_for.indirect[elsewhere])
    np.testing.assert_array_equal(found.standard_error[elsewhere], looked_for.standard_error[elsewhere])
    assert (found.standard_error[~elsewhere] != looked_for.standard_error[~elsewhere]).mean() > 0.9
    direct = lit(caches, KnownLight(radiance, there), count=count, indirect=False)
    assert (direct.indirect == 0.0).all()

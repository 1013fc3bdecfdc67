"""The compiled loop over rays through a mesh, against the same in whole arrays."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_relight import Renderer, environment_from_array, load_bundle
from lambent_relight.baked.traced_surface import MeshSurroundings
from lambent_relight.brdf import materials_from_roughness
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.level_lookup import map_at, place_on_map
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.refined.known_light import KnownLight
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import outgoing_radiance
from support.baked_bundle import write_baked_bundle


class AskedAsArrays(MeshSurroundings):
    """The same mesh, without saying that it is one."""

    @property
    def mesh(self) -> None:
        return None


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    folder = write_baked_bundle(tmp_path_factory.mktemp("traced") / "boxes.relight", side=12)
    return Renderer(load_bundle(folder), num_threads=1, reader="onnx").baked()


def sky(rotate_deg=0.0):
    image = np.random.default_rng(3).uniform(0.2, 1.0, (9, 14, 3))
    image[2, 4] += 20.0
    return replace(environment_from_array(image), rotate_deg=rotate_deg)


def beside_the_block(count=60) -> SurfacePoints:
    """Return points on the slab, next to the block, seen from above."""
    rng = np.random.default_rng(0)
    position = np.stack([rng.uniform(0.41, 0.9, count), rng.uniform(-0.3, 0.3, count)], axis=1)
    position = np.concatenate([position, np.full((count, 1), -0.4)], axis=1).astype(np.float32)
    normal = np.tile(np.float32([0.0, 0.0, 1.0]), (count, 1))
    omega_o = np.tile(np.float32([0.6, 0.0, 0.8]), (count, 1))
    ones = np.ones((count, 1), np.float32)
    return SurfacePoints(
        position, normal, omega_o, materials_from_roughness(np.full((count, 3), 0.6), 0.5 * ones, 0.0 * ones)
    )


@pytest.mark.parametrize("indirect", [True, False])
@pytest.mark.parametrize("most_bounces", [0, 1, 3])
def test_the_loop_finds_what_arrays_of_rays_find(baked, indirect, most_bounces):
    environment, points = sky(70.0), beside_the_block()
    light = Light(environment, LightSampler(environment))
    hits = baked.hits(environment, MaterialEdit())
    found = []
    for kind in (MeshSurroundings, AskedAsArrays):
        around = kind(baked.traced, MaterialEdit(), hits.at_texels)
        scene = Scene(around, light, most_bounces=most_bounces, indirect=indirect)
        way = {"num_samples": 256, "seed": 4}
        known = KnownLight(np.zeros((60, 3), np.float32), np.arange(60) % 2 > 0)
        found.append(outgoing_radiance(points, scene, known=known, **way))
    assert 0.1 < found[0].visibility.mean() < 0.95
    for name in ("direct", "visibility"):
        np.testing.assert_allclose(getattr(found[0], name), getattr(found[1], name), rtol=2e-4, atol=2e-5)
    if most_bounces != 3:
        # Longer paths draw other random numbers.
        for name in ("indirect", "specular", "standard_error"):
            np.testing.assert_allclose(getattr(found[0], name), getattr(found[1], name), rtol=1e-3, atol=1e-4)
    assert (found[0].indirect.max() > 0.0) == (indirect and most_bounces != 1)


def test_the_loop_looks_up_the_sky_as_environments_do():
    environment = sky(200.0)
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(300, 3))
    directions = np.concatenate([directions, [[1e-3, 0.0, 1.0], [0.0, 1e-3, -1.0], [-1.0, 1e-9, 0.0]]])
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    turn = np.float32(environment.rotate_deg / 360.0)
    found = [map_at(environment.radiance, *place_on_map(turn, *direction)) for direction in directions]
    np.testing.assert_allclose(found, environment.lookup(directions), rtol=1e-3, atol=1e-3)

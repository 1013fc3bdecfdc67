"""The sky through shadow bits: its mean is exact for any bits, and right bits take noise out."""

import numpy as np
import pytest
from lambent_relight import environment_from_array
from lambent_relight.baked.mesh import AtlasMesh
from lambent_relight.baked.scene import baked_scene
from lambent_relight.baked.traced_surface import MeshSurroundings, TracedSurface
from lambent_relight.baked.transport import shadow_directions
from lambent_relight.brdf import materials_from_roughness
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.refined.known_light import KnownLight, Spread
from lambent_relight.refined.known_sky import KnownSky, SkyCells
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import outgoing_radiance
from support.baked_bundle import SCENE, baked_transport
from support.statistics import assert_mean

COUNT = 1500
ALBEDO = 0.6


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    transport, mesh = baked_transport(SCENE, 8, tmp_path_factory.mktemp("sky") / "rays")
    return TracedSurface(baked_scene(AtlasMesh(**mesh), transport))


def sky(rotate_deg=0.0):
    image = np.random.default_rng(3).uniform(0.2, 1.0, (12, 20, 3))
    image[2, 4] += 20.0
    return environment_from_array(image).rotated(rotate_deg)


def beside_the_block(tilt=0.0) -> SurfacePoints:
    """Return the same point of the slab, next to the block, with a normal tilted by this many radians."""
    position = np.tile(np.float32([0.5, 0.1, -0.4]), (COUNT, 1))
    normal = np.tile(np.float32([np.sin(tilt), 0.0, np.cos(tilt)]), (COUNT, 1))
    omega_o = np.tile(np.float32([0.6, 0.0, 0.8]), (COUNT, 1))
    ones = np.ones((COUNT, 1), np.float32)
    materials = materials_from_roughness(ALBEDO * np.ones((COUNT, 3)), 0.7 * ones, 0.0 * ones)
    return SurfacePoints(position, normal, omega_o, materials)


def true_bits(traced, points) -> np.ndarray:
    """Return which shadow directions are free at each of the points, as bits."""
    directions = shadow_directions().astype(np.float32)
    origin = np.tile(points.position[:1] + 1e-3 * points.normal[:1], (len(directions), 1))
    free = traced.rays(origin, directions).face < 0
    return np.tile(np.packbits(free, bitorder="little"), (COUNT, 1))


def lit(traced, environment, points, known, *, seed=0):
    light = Light(environment, LightSampler(environment))
    scene = Scene(MeshSurroundings(traced, MaterialEdit()), light, indirect=False)
    return outgoing_radiance(points, scene, num_samples=16, seed=seed, known=known)


def known_sky(environment, bits, points) -> KnownLight:
    """Return the light of the sky through `bits`, and of nothing else."""
    cells = SkyCells.of(environment, shadow_directions())
    reflected = np.full((COUNT, 3), ALBEDO / np.pi, np.float32)
    nothing = KnownLight.nothing(COUNT)
    return KnownLight(nothing.radiance, nothing.known, KnownSky.of(cells, bits, points.normal, reflected))


@pytest.mark.parametrize(("rotate_deg", "tilt"), [(0.0, 0.0), (70.0, 0.5)])
def test_bits_of_mere_chance_move_no_mean(traced, monkeypatch, rotate_deg, tilt):
    environment, points = sky(rotate_deg), beside_the_block(tilt)
    bits = np.tile(np.random.default_rng(1).integers(0, 256, 32, np.uint8), (COUNT, 1))
    known = known_sky(environment, bits, points)
    plain = lit(traced, environment, points, None)
    monkeypatch.setattr(Spread, "best_shares", lambda self, mean: np.ones((2, len(mean))))
    mixed = lit(traced, environment, points, known, seed=1)
    assert known.sky.radiance.mean() > 0.2 * plain.direct.mean()
    assert_mean(mixed.direct.astype(np.float64) - plain.direct, np.zeros(3))
    # The stated error is that of the mixture.
    spread = (mixed.direct.astype(np.float64) - mixed.direct.mean(axis=0)) ** 2 * COUNT / (COUNT - 1)
    assert_mean(spread - mixed.standard_error.astype(np.float64) ** 2, np.zeros(3))


def test_right_bits_take_out_most_of_the_noise_and_wrong_ones_make_none(traced):
    environment, points = sky(), beside_the_block()
    plain = (lit(traced, environment, points, None).standard_error ** 2).mean()
    right = known_sky(environment, true_bits(traced, points), points)
    assert (lit(traced, environment, points, right).standard_error ** 2).mean() < 0.6 * plain
    chance = np.random.default_rng(2).integers(0, 256, (COUNT, 32), np.uint8)
    wrong = known_sky(environment, chance, points)
    assert (lit(traced, environment, points, wrong).standard_error ** 2).mean() < 1.02 * plain


def test_cells_that_reach_below_the_surface_do_not_count():
    environment, points = sky(), beside_the_block()
    everything = np.full((COUNT, 32), 255, np.uint8)
    seen = np.unpackbits(known_sky(environment, everything, points).sky.seen[0], bitorder="little")
    height = shadow_directions()[:, 2]
    assert not seen[height < 0.1].any()
    assert seen[height > 0.35].all()


def test_moments_of_cells_are_the_light_of_the_whole_sky():
    environment = sky(40.0)
    cells = SkyCells.of(environment, shadow_directions())
    directions = np.random.default_rng(0).normal(size=(400_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    light = environment.lookup(directions).astype(np.float64)
    samples = 4.0 * np.pi * directions[:, :, None] * light[:, None, :]
    deviation = samples.std(axis=0) / np.sqrt(len(samples))
    assert (np.abs(cells.moment.sum(axis=0) - samples.mean(axis=0)) < 4.5 * deviation).all()
    # Every direction belongs to the stored one that is nearest, but for the width of a pixel.
    some = directions[:2000]
    u = 0.5 - np.arctan2(some[:, 1], some[:, 0]) / (2.0 * np.pi) + 40.0 / 360.0
    v = np.arccos(some[:, 2]) / np.pi
    rows, columns = cells.cell.shape
    cell = cells.cell[(v * rows).astype(int), ((u % 1.0) * columns).astype(int) % columns]
    own = np.einsum("ni,ni->n", some, cells.directions[cell])
    best = (some @ cells.directions.T).max(axis=1)
    assert (np.arccos(np.clip(own, -1, 1)) - np.arccos(np.clip(best, -1, 1))).max() < 0.05


def test_no_corner_of_a_cell_is_below_a_surface_that_the_cell_is_said_to_be_above():
    """`least_cosine` is the sine of the largest angle between a stored direction and its pixels' corners."""
    cells = SkyCells.of(sky(40.0), shadow_directions())
    rows, columns = cells.cell.shape
    inside = 1e-6
    for down in (inside, 1.0 - inside):
        for right in (inside, 1.0 - inside):
            row, column = np.mgrid[:rows, :columns]
            polar = np.pi * (row + down) / rows
            azimuth = 2.0 * np.pi * (0.5 - (column + right) / columns + 40.0 / 360.0)
            corner = np.stack(
                [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1
            )
            own = (corner * cells.directions[cells.cell]).sum(axis=-1)
            assert np.arccos(np.clip(own, -1.0, 1.0)).max() <= np.arcsin(cells.least_cosine) + 1e-5

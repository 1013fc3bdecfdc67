"""Light transport baked over surfaces whose transport is known."""

import numpy as np
import pytest
from lambent_asset.transport.transport import TransportConfig, bake_transport
from lambent_asset.transport.transport_bounce import Reflectors
from lambent_asset.transport.transport_rays import BakedSurface, RayConfig, cast, direction_sets
from lambent_core.errors import WorkerError
from lambent_relight.baked.transport import coarse_blocks
from lambent_relight.environment import harmonics
from support.quad_surface import Quad, box_of_quads, surface_of, trace_quads

FLOOR = Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0))
WALL = Quad((-1, 1, 0), (2, 0, 0), (0, 0, 2))
OPEN_SKY = np.sqrt(4.0 * np.pi)


def baked(quads, side, tmp_path, *, given=None, **settings):
    surface, reflectors = given or surface_of(quads, side)[:2]
    transport, figures = bake_transport(
        surface,
        reflectors,
        trace_quads(quads),
        origin_offset=1e-3,
        config=TransportConfig(**settings),
        store=tmp_path / "rays",
    )
    return surface, transport, figures


def test_a_lone_plane_gets_the_irradiance_of_the_open_sky_without_any_noise(tmp_path):
    surface, transport, figures = baked([FLOOR], 6, tmp_path)
    expected = harmonics.basis(surface.normals, 7) * harmonics.cosine_factors(7)
    np.testing.assert_allclose(transport.direct.T, expected, atol=1e-5)
    np.testing.assert_allclose(transport.visibility[0], OPEN_SKY, rtol=1e-6)
    np.testing.assert_allclose(transport.visibility[1:], 0.0, atol=1e-6)
    assert transport.shadow_bits is not None
    assert (transport.shadow_bits == 255).all()
    assert np.abs(transport.indirect).max() == 0.0
    assert figures["transport_rays_per_texel"] == pytest.approx(64, abs=4)


def test_a_wall_takes_the_light_that_its_form_factor_says(tmp_path):
    surface, transport, _ = baked([FLOOR, WALL], 12, tmp_path)
    floor = surface.normals[:, 2] > 0.5
    x, y = surface.positions[floor, 0], surface.positions[floor, 1]
    # The wall as seen from a point of the floor: cosine at both ends over squared distance, summed.
    a, b = (np.arange(200) + 0.5) / 100 - 1.0, (np.arange(200) + 0.5) / 100
    u, v = np.meshgrid(a, b)
    dx, dy, dz = u.ravel()[None] - x[:, None], 1.0 - y[:, None], v.ravel()[None]
    squared = dx**2 + dy**2 + dz**2
    blocked = (dz * dy / squared**2).sum(axis=1) * 1e-4
    found = transport.direct[0, floor] * OPEN_SKY
    # One texel's error is that of about 128 stratified directions.
    assert np.abs(found - (np.pi - blocked)).mean() < 0.03
    assert (found - (np.pi - blocked)).mean() == pytest.approx(0.0, abs=0.012)


def test_the_bits_of_a_direction_say_where_its_light_is_hidden_lowest_bit_first(tmp_path):
    surface, transport, _ = baked([FLOOR, WALL], 12, tmp_path)
    floor = surface.normals[:, 2] > 0.5
    x, y = surface.positions[floor, :2].T[..., None]
    # Without jitter all sets are the directions that readers know.
    dx, dy, dz = direction_sets(RayConfig(jitter=0.0))[0].T
    way = (1.0 - y) / np.where(dy > 0.0, dy, np.nan)
    hidden = (dz > 0.0) & (np.abs(x + way * dx) < 1.0) & (way * dz < 2.0)
    j = np.arange(len(dx))
    free = (transport.shadow_bits[floor][:, j // 8] >> (j % 8)) & 1 == 1
    # What rays ask is moved inside a direction's own share of the sphere: rims may differ.
    assert free[hidden].mean() < 0.15
    assert free[~hidden].mean() > 0.95


@pytest.mark.parametrize("ragged", [False, True])
def test_white_surfaces_in_uniform_light_send_as_much_as_they_get(tmp_path, ragged):
    white = {"albedo": (1.0, 1.0, 1.0)}
    quads = [
        Quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), **white),
        Quad((-1, 1, 0), (2, 0, 0), (0, 0, 2), **white),
    ]
    surface, reflectors, _ = surface_of(quads, 12)
    if ragged:
        # Charts with a jagged edge: some blocks begin in their lower row, and come late among the texels.
        row, column = np.divmod(surface.texel_index, surface.size)
        kept = (row % 2 == 1) | (column % 8 < 4)
        parts = (surface.texel_index[kept], surface.positions[kept], surface.normals[kept])
        surface = BakedSurface(surface.size, *parts)
        values = (reflectors.albedo, reflectors.perceptual_roughness, reflectors.metalness)
        reflectors = Reflectors(*(value[kept] for value in values))
        first = coarse_blocks(surface.size, surface.texel_index)[0]
        assert (np.diff(first) < 0).any()
    _, transport, _ = baked(quads, 12, tmp_path, given=(surface, reflectors), num_bounces=12)
    direct = transport.direct[0] * OPEN_SKY
    total = direct[:, None] + transport.indirect[0].T[transport.coarse_of_texel] * OPEN_SKY
    # The specular lobe of a rough dielectric (F0 0.04) adds a little; energy may not get lost.
    assert total.mean() == pytest.approx(np.pi, rel=0.03)
    assert np.abs(total / np.pi - 1.0).max() < (0.2 if ragged else 0.12)


def test_a_closed_box_is_dark(tmp_path):
    _, transport, figures = baked(box_of_quads(), 6, tmp_path)
    assert np.abs(transport.direct[0]).max() < 0.04
    assert figures["transport_blocked_share"] == pytest.approx(1.0, abs=0.02)
    assert figures["transport_rays_per_texel"] == pytest.approx(64, abs=3)
    assert np.abs(transport.indirect).max() < 0.02


def test_a_coloured_wall_colours_the_floor_beside_it(tmp_path):
    red = Quad((-1, 1, 0), (2, 0, 0), (0, 0, 2), albedo=(0.8, 0.1, 0.1))
    surface, transport, _ = baked([FLOOR, red], 12, tmp_path)
    bounced = transport.indirect[0].T[transport.coarse_of_texel]
    floor = surface.normals[:, 2] > 0.5
    near = floor & (surface.positions[:, 1] > 0.7)
    far = floor & (surface.positions[:, 1] < -0.7)
    assert (bounced[near, 0] > 3.0 * bounced[near, 1]).all()
    assert bounced[near, 0].mean() > 3.0 * bounced[far, 0].mean()


def test_metal_walls_send_light_on_although_they_have_no_diffuse_part(tmp_path):
    metal = Quad((-1, 1, 0), (2, 0, 0), (0, 0, 2), albedo=(1.0, 0.8, 0.3), metalness=1.0)
    surface, transport, _ = baked([FLOOR, metal], 12, tmp_path)
    near = (surface.normals[:, 2] > 0.5) & (surface.positions[:, 1] > 0.7)
    bounced = transport.indirect[0].T[transport.coarse_of_texel][near].mean(axis=0)
    assert bounced[0] > 0.15
    assert bounced[2] / bounced[0] == pytest.approx(0.3, abs=0.08)


def test_a_lite_transport_is_a_part_of_the_full_one(tmp_path):
    _, full, _ = baked([FLOOR, WALL], 8, tmp_path / "full")
    _, lite, _ = baked([FLOOR, WALL], 8, tmp_path / "lite", tier="lite")
    np.testing.assert_allclose(lite.direct, full.direct[:25], atol=1e-6)
    np.testing.assert_allclose(lite.visibility, full.visibility[:9], atol=1e-6)
    assert lite.shadow_bits is None


def test_an_interrupted_bake_goes_on_where_it_was(tmp_path):
    surface, _, _ = surface_of([FLOOR, WALL], 8)
    trace, asked = trace_quads([FLOOR, WALL]), []

    def counted(origin, direction):
        asked.append(len(origin))
        return trace(origin, direction)

    def stop_halfway(share):
        if share >= 0.5:
            raise InterruptedError

    arguments, settings = (
        (surface, counted),
        {"origin_offset": 1e-3, "config": RayConfig(texels_per_chunk=16)},
    )
    whole = cast(*arguments, **settings, store=tmp_path / "whole")
    needed = sum(asked)
    asked.clear()
    with pytest.raises(InterruptedError):
        cast(*arguments, **settings, store=tmp_path / "parts", advance=stop_halfway)
    assert 0 < sum(asked) < 0.7 * needed
    resumed = cast(*arguments, **settings, store=tmp_path / "parts")
    assert sum(asked) == needed == resumed.num_rays
    shared = cast(*arguments, **settings, store=tmp_path / "threads", num_threads=3)
    assert shared.num_rays == needed
    for found in (resumed, shared):
        np.testing.assert_array_equal(found.opacity, whole.opacity)
        np.testing.assert_array_equal(found.distance, whole.distance)


def test_direction_sets_fill_the_sphere_evenly_and_differ():
    sets = direction_sets(RayConfig())
    assert sets.shape == (16, 256, 3)
    np.testing.assert_allclose(np.linalg.norm(sets, axis=-1), 1.0, atol=1e-6)
    moments = harmonics.basis(sets.reshape(-1, 3), 7).mean(axis=0)
    np.testing.assert_allclose(moments[1:], 0.0, atol=0.01)
    assert np.abs(sets[0] - sets[1]).max() > 0.05


def test_an_unknown_tier_is_refused():
    with pytest.raises(WorkerError, match=r"export\.transport"):
        TransportConfig(tier="huge")

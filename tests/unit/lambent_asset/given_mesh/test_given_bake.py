"""Rays against triangles agree with rays against the exact shapes, and so does what is baked from them."""

import numpy as np
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.surface_occlusion import bake_occlusion
from lambent_asset.transport.transport import TransportConfig, bake_transport, write_transport
from lambent_asset.transport.transport_rays import MESH_RAYS, BakedSurface, TriangleRays
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.baked.transport import transport_files
from support.analytic_scene import AnalyticScene, Box, NumpyOps, Surface
from support.baked_bundle import SLAB, baked_transport, quads_of
from support.quad_surface import surface_of

# The block floats: where closed shapes touch, rays between them have no one right answer.
BLOCK = Box((-0.4, -0.4, 0.0), (0.4, 0.4, 0.8), Surface(albedo=(0.8, 0.3, 0.2), perceptual_roughness=0.6))
SCENE = AnalyticScene((SLAB, BLOCK))


def atlas(side):
    """Return the boxes of `SCENE` as triangles on an atlas, and their materials."""
    surface, reflectors, mesh = surface_of([q for box in SCENE.shapes for q in quads_of(box)], side)
    made = AtlasSurface(
        vertices=mesh["vertices"].astype(np.float32),
        faces=mesh["faces"].astype(np.int32),
        uv=mesh["uv"].astype(np.float32),
        normals=np.zeros_like(mesh["vertices"], np.float32),
        size=surface.size,
        texel_index=surface.texel_index,
        positions=surface.positions,
        texel_normals=surface.normals,
        cell=0.05,
    )
    return made, reflectors


def test_rays_meet_what_the_exact_shapes_have_there():
    surface, _ = atlas(4)
    rng = np.random.default_rng(2)
    chosen = rng.integers(0, len(surface.positions), 4000)
    direction = rng.normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    normal = surface.texel_normals[chosen]
    direction *= np.sign((direction * normal).sum(axis=1, keepdims=True))
    origin = (surface.positions[chosen] + SCENE.origin_offset * normal).astype(np.float32)
    rays = TriangleRays(surface.vertices, surface.faces)
    opacity, distance = rays(origin, direction.astype(np.float32))
    expected, hits = SCENE.first_hit(NumpyOps, origin, direction.astype(np.float32), SCENE.near)
    same = opacity[:, 0] == hits[:, 0]
    assert same.mean() > 0.998, "rays along edges may differ"
    both = same & hits[:, 0].astype(bool)
    assert 0.05 < both.mean() < 0.6
    np.testing.assert_allclose(distance[both], expected[both], atol=1e-3)
    assert not distance[opacity == 0.0].any()


def test_occlusion_is_that_of_the_closed_form_below_a_block():
    surface, _ = atlas(16)
    rays = TriangleRays(surface.vertices, surface.faces)
    found = bake_occlusion(
        surface, rays, origin_offset=rays.offset, num_points=len(surface.positions), num_rays=256
    )
    top = np.abs(surface.positions[:, 2] + 0.4) < 1e-3
    below = top & (np.abs(surface.positions[:, :2]).max(axis=1) < 0.2)
    assert below.sum() == 16
    blocked = np.zeros(below.sum())
    # Form factor of an element to a parallel rectangle with a corner above it, for the four quarters;
    # the sides are behind the bottom.
    x, y = surface.positions[below, 0], surface.positions[below, 1]
    for a in (0.4 - x, 0.4 + x):
        for b in (0.4 - y, 0.4 + y):
            p, q = a / 0.4, b / 0.4
            first = p / np.sqrt(1.0 + p * p) * np.arctan(q / np.sqrt(1.0 + p * p))
            blocked += (first + q / np.sqrt(1.0 + q * q) * np.arctan(p / np.sqrt(1.0 + q * q))) / (
                2.0 * np.pi
            )
    assert blocked.min() > 0.4
    np.testing.assert_allclose(found[below], 1.0 - blocked, atol=0.02)


def test_transport_is_that_of_the_exact_shapes(tmp_path):
    side = 8
    surface, reflectors = atlas(side)
    exact, _ = baked_transport(SCENE, side, tmp_path / "exact.rays")
    manifest = BundleManifest()
    rays = TriangleRays(surface.vertices, surface.faces)
    transport, figures = bake_transport(
        BakedSurface(surface.size, surface.texel_index, surface.positions, surface.texel_normals),
        reflectors,
        rays,
        origin_offset=rays.offset,
        config=TransportConfig(rays=MESH_RAYS),
        store=tmp_path / "rays",
    )
    write_transport(transport, manifest, tmp_path)
    expected = BundleManifest()
    files = transport_files(exact, expected)
    for planes, wanted in zip(manifest.transport.planes, expected.transport.planes, strict=True):
        values = [
            np.frombuffer(data, np.int8).reshape(stated.channels * max(stated.bands, 1) ** 2, -1)
            if stated.bands
            else np.frombuffer(data, np.int8).reshape(len(stated.scales), -1)
            for data, stated in (
                ((tmp_path / planes.path).read_bytes(), planes),
                (files[wanted.path], wanted),
            )
        ]
        found, right = (
            np.array(stated.offsets)[:, None] + np.array(stated.scales)[:, None] * value
            for stated, value in zip((planes, wanted), values, strict=True)
        )
        error = np.sqrt(np.mean((found - right) ** 2)) / np.sqrt(np.mean(right**2))
        assert error < 0.03, planes.name
    assert figures["transport_blocked_share"] > 0.01

"""Textures of a baked surface."""

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from lambent_asset.mesh.atlas import tangents
from lambent_asset.textures.textures import (
    bake_materials,
    base_colour_png,
    normal_png,
    occlusion_roughness_metalness_png,
    tangent_normals,
)
from lambent_relight.baked.raster import interpolate, rasterise_uv
from PIL import Image
from support.atlas_box import atlas_box, coloured
from support.sphere_model import sphere_model


@pytest.fixture(scope="module")
def box():
    return atlas_box()


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)))


def test_textures_carry_the_materials_at_the_places_of_texels(box):
    model = sphere_model()
    occlusion = np.linspace(0.0, 1.0, len(box.texel_index), dtype=np.float32)
    textures = bake_materials(model, box, occlusion)
    with torch.no_grad():
        expected = model.materials(torch.from_numpy(box.positions))

    def covered(plane: np.ndarray) -> np.ndarray:
        return plane.reshape(box.size**2, -1)[box.texel_index]

    assert np.allclose(covered(textures.albedo), expected.albedo, atol=1e-6)
    assert np.allclose(covered(textures.perceptual_roughness) ** 2, expected.alpha, atol=1e-6)
    assert np.allclose(covered(textures.metalness), expected.metalness, atol=1e-6)
    assert np.allclose(covered(textures.occlusion)[:, 0], occlusion)


def test_gutters_are_filled_with_colours_of_their_neighbours(box):
    textures = coloured(box)
    assert textures.albedo.reshape(-1, 3).max(axis=1).min() > 0.0
    assert len(np.unique(textures.albedo.reshape(-1, 3), axis=0)) == 6


def test_files_have_the_encodings_of_gltf(box):
    textures = coloured(box)
    colours = np.unique(pixels(base_colour_png(textures)).reshape(-1, 3), axis=0).tolist()
    assert [188, 124, 0] in colours
    assert np.unique(pixels(occlusion_roughness_metalness_png(textures)).reshape(-1, 3), axis=0).tolist() == [
        [191, 102, 255]
    ]
    assert pixels(normal_png(textures)).reshape(-1, 3).tolist().count([128, 128, 255]) == box.size**2


def test_a_viewer_decodes_the_normals_that_were_baked(box):
    bent = box.texel_normals + 0.4 * np.sin(7.0 * box.positions)
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    surface = replace(box, texel_normals=bent.astype(np.float32))
    local = tangent_normals(surface)
    assert (local[:, 2] > 0.0).all()
    frame = tangents(surface.vertices, surface.faces, surface.uv, surface.normals)
    found = rasterise_uv(surface.uv, surface.faces, surface.size)
    normal = interpolate(found, surface.faces, surface.normals)
    tangent = interpolate(found, surface.faces, frame)
    bitangent = tangent[:, 3:] * np.cross(normal, tangent[:, :3])
    decoded = local[:, :1] * tangent[:, :3] + local[:, 1:2] * bitangent + local[:, 2:] * normal
    decoded /= np.linalg.norm(decoded, axis=1, keepdims=True)
    assert (decoded * bent).sum(-1).min() > 1.0 - 1e-5


def test_a_bump_towards_the_top_of_the_texture_is_green(box):
    frame = tangents(box.vertices, box.faces, box.uv, box.normals)
    found = rasterise_uv(box.uv, box.faces, box.size)
    corner = box.faces[found.face[found.covered], 0]
    up = frame[corner, 3:] * np.cross(box.normals[corner], frame[corner, :3])
    tilted = replace(box, texel_normals=(0.8 * box.texel_normals + 0.6 * up).astype(np.float32))
    assert np.allclose(tangent_normals(tilted), [0.0, 0.6, 0.8], atol=1e-5)


def test_normals_that_face_inwards_stay_on_the_outer_side(box):
    assert (tangent_normals(replace(box, texel_normals=-box.texel_normals))[:, 2] > 0.0).all()

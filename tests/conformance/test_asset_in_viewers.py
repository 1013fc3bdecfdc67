"""Mesh files in other programs: the Khronos validator, and three.js in a browser."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flashcache.config import ExportConfig
from lambent_asset.bundle.glb import write_glb
from lambent_asset.textures.surface import build_surface
from lambent_asset.textures.textures import bake_materials
from lambent_core.colour import linear_from_srgb
from lambent_relight.asset.draco import DRACO, glb_with_draco
from lambent_relight.asset.glb import glb_with_textures
from lambent_relight.asset.textured_mesh import textured_mesh_from_glb
from lambent_relight.baked.raster import interpolate, nearest_texel, rasterise, rasterise_uv
from lambent_relight.cameras import turntable
from scipy import ndimage
from support.atlas_box import SIZES, atlas_box, coloured
from support.chromium import program
from support.sphere_model import sphere_model
from support.texture_lookup import sample_plane
from support.three_page import WEB, ThreePage, three_page

pytestmark = [pytest.mark.browser, pytest.mark.slow]
# So near that texels are larger than pixels: smaller versions of textures are each program's own.
CAMERAS = turntable(3, radius=6.0, elevation_deg=25.0, width=192, height=160, start_deg=20.0)


def bent(surface):
    """Return the box with normals that vary over its faces, so that the normal map has an effect."""
    normals = surface.texel_normals + 0.5 * np.sin(4.0 * surface.positions[:, [1, 2, 0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(surface, texel_normals=normals.astype(np.float32))


SURFACE = bent(atlas_box(128))
PLACES = (SURFACE.positions / SIZES + 0.5).astype(np.float32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("assets")
    # Positions as colours: the colour that a viewer shows is the position of its lookup.
    textures = coloured(SURFACE, linear_from_srgb(PLACES))
    box = write_glb(SURFACE, textures, unit="unknown")
    (folder / "box.glb").write_bytes(box)
    (folder / "box_draco.glb").write_bytes(glb_with_draco(box))
    model = sphere_model()
    surface = build_surface(model, ExportConfig(mesh_resolution=24, max_faces=600, transport_size=64))
    textures = bake_materials(model, surface, np.ones(len(surface.texel_index), np.float32))
    ball = write_glb(surface, textures, unit="unknown")
    (folder / "ball.glb").write_bytes(ball)
    packed = glb_with_textures(ball, textured_mesh_from_glb(ball), webp=True)
    (folder / "ball_webp.glb").write_bytes(packed)
    (folder / "ball_draco.glb").write_bytes(glb_with_draco(packed))
    return folder


@pytest.fixture(scope="module")
def page(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ThreePage]:
    if program() is None or not (WEB / "node_modules" / "three").is_dir():
        pytest.skip("needs Chromium and the web tool chain")
    with three_page(folder, tmp_path_factory.mktemp("profile")) as page:
        assert page.load("box.glb") == len(SURFACE.faces)
        yield page


def inside(camera) -> np.ndarray:
    """Return the pixels away from edges, where both programs must see the same face."""
    face = rasterise(SURFACE.vertices, SURFACE.faces, camera).face // 2
    same = ndimage.maximum_filter(face, 13) == ndimage.minimum_filter(face, 13)
    return same & (face >= 0)


def expected(camera, values: np.ndarray) -> np.ndarray:
    """Return `values` [texel, n] as the camera sees them, [pixel, n]: positions are interpolated."""
    found = rasterise(SURFACE.vertices, SURFACE.faces, camera)
    plane = values[nearest_texel(SURFACE.texel_index, SURFACE.size)]
    uv = interpolate(found, SURFACE.faces, SURFACE.uv)
    picture = np.zeros((camera.height, camera.width, values.shape[1]), np.float32)
    picture[found.covered] = sample_plane(plane, uv)
    return picture[inside(camera)]


def validated(path: Path) -> dict:
    """Return the report of the Khronos validator about a file."""
    if shutil.which("node") is None or not (WEB / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("needs node and the web tool chain")
    command = ["node", "scripts/validate_gltf.mjs", str(path)]
    done = subprocess.run(command, cwd=WEB, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(done.stdout)
    assert report["info"]["hasTextures"]
    return report


@pytest.mark.parametrize("name", ["box.glb", "ball.glb", "ball_webp.glb"])
def test_the_khronos_validator_finds_nothing(folder: Path, name: str):
    report = validated(folder / name)
    assert report["issues"]["messages"] == []
    assert report["info"]["totalVertexCount"] > 0


@pytest.mark.parametrize("name", ["box_draco.glb", "ball_draco.glb"])
def test_the_khronos_validator_only_says_that_it_does_not_know_draco(folder: Path, name: str):
    report = validated(folder / name)
    found = {message["code"]: message["message"] for message in report["issues"]["messages"]}
    # The packed mesh is a buffer view that only the extension refers to.
    assert set(found) == {"UNSUPPORTED_EXTENSION", "UNUSED_OBJECT"}
    assert DRACO in found["UNSUPPORTED_EXTENSION"]
    assert report["issues"]["numErrors"] == report["issues"]["numWarnings"] == 0


def test_three_js_shows_a_packed_mesh_as_it_shows_the_plain_one(page: ThreePage):
    camera = CAMERAS[0]
    plain = {kind: page.draw(kind, camera) for kind in ("colour", "normal")}
    try:
        assert page.load("box_draco.glb") == len(SURFACE.faces)
        packed = {kind: page.draw(kind, camera) for kind in ("colour", "normal")}
    finally:
        page.load("box.glb")
    for kind, picture in plain.items():
        difference = np.abs(packed[kind].astype(int) - picture)[inside(camera)]
        assert difference.max() <= 3, kind
        assert difference.mean() < 0.5, kind


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
def test_three_js_shows_every_place_where_it_is(page: ThreePage, camera):
    picture = page.draw("colour", camera)
    covered = rasterise(SURFACE.vertices, SURFACE.faces, camera).covered
    assert ((picture[..., 3] > 0) != covered).mean() < 0.01
    found = picture[inside(camera)][:, :3] / 255.0
    error = np.abs(found - expected(camera, PLACES))
    assert error.max() < 0.015


def test_three_js_reads_roughness_from_green_and_metalness_from_blue(page: ThreePage):
    found = page.draw("packed", CAMERAS[0])[inside(CAMERAS[0])][:, :3]
    assert np.abs(found.astype(int) - [191, 102, 255]).max() <= 1


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
def test_three_js_decodes_the_normals_that_were_baked(page: ThreePage, camera):
    found = page.draw("normal", camera)[inside(camera)][:, :3] / 255.0 * 2.0 - 1.0
    wanted = expected(camera, SURFACE.texel_normals) @ camera.camera_to_world[:3, :3]
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    # Normals that face away are turned round by programs that draw both sides.
    cosine = (found * wanted).sum(-1) / np.linalg.norm(found, axis=1)
    assert np.percentile(cosine, 1) > np.cos(np.radians(2.0))


def test_a_lit_picture_is_neither_black_nor_white(page: ThreePage):
    picture = page.draw("lit", CAMERAS[0])
    assert 20 < picture[inside(CAMERAS[0])][:, :3].mean() < 235


def test_charts_of_the_box_cover_as_many_texels_as_are_listed():
    covered = rasterise_uv(SURFACE.uv, SURFACE.faces, SURFACE.size).covered
    assert np.array_equal(np.flatnonzero(covered), SURFACE.texel_index)

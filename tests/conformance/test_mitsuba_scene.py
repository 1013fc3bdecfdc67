"""The Mitsuba scene of an asset, rendered by Mitsuba: axes, cameras, textures and normals are in place."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions, pixel_solid_angles
from lambent_relight import Camera, Renderer, environment_from_array, load_bundle, look_at
from lambent_relight.asset.write import write_formats
from lambent_relight.baked.raster import interpolate, nearest_texel, rasterise
from scipy import ndimage
from support.asset_bundle import painted, write_asset_bundle
from support.atlas_box import SIZES, atlas_box, coloured
from support.texture_lookup import sample_plane

pytestmark = pytest.mark.slow

# It sees the sides -x, whose chart is mirrored, +y and +z.
CAMERA = Camera(
    name="off $centre & tilted",
    width=44,
    height=36,
    focal_x=60.0,
    focal_y=60.0,
    centre_x=25.0,
    centre_y=14.0,
    camera_to_world=look_at((-4.0, 3.5, 4.2), (0.0, 0.0, 0.3)),
)


def bent_box():
    """Return the box with normals that vary over its faces; charts of every other face are mirrored."""
    surface = atlas_box(128)
    normals = surface.texel_normals + 0.25 * np.sin(4.0 * surface.positions[:, [1, 2, 0]])
    return replace(surface, texel_normals=normalise(normals).astype(np.float32))


def lamp(degrees=0.0):
    """Return a map with one soft lamp that all three visible sides of the box see."""
    turn = np.radians(degrees)
    towards = normalise(np.array([-0.65, 0.5, 0.6]))
    towards = np.array(
        [
            np.cos(turn) * towards[0] - np.sin(turn) * towards[1],
            np.sin(turn) * towards[0] + np.cos(turn) * towards[1],
            towards[2],
        ]
    )
    lobe = np.exp(40.0 * (pixel_directions(64, 128) @ towards - 1.0))
    return environment_from_array(lobe[..., None] * np.array([9.0, 6.0, 4.0]))


def rendered(mi, scene, spp, sensor=0):
    loaded = mi.load_file(str(scene), spp=spp)
    return np.array(mi.render(loaded, sensor=sensor, seed=0))


def visible(surface, values):
    """Return values per texel as `CAMERA` sees them, [height, width, n], and the pixels away from edges."""
    found = rasterise(surface.vertices, surface.faces, CAMERA)
    picture = np.zeros((CAMERA.height, CAMERA.width, values.shape[1]))
    uv = interpolate(found, surface.faces, surface.uv)
    picture[found.covered] = sample_plane(values[nearest_texel(surface.texel_index, surface.size)], uv)
    side = found.face // 2
    same = ndimage.maximum_filter(side, 3) == ndimage.minimum_filter(side, 3)
    return picture, same & (side >= 0)


@pytest.fixture(scope="module")
def mi():
    mitsuba = pytest.importorskip("mitsuba", reason="the comparison needs Mitsuba (extra `dev`)")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def test_a_matt_box_in_mitsuba_has_the_radiance_of_its_texels(mi, tmp_path):
    surface, light = bent_box(), lamp()
    albedo = np.clip(surface.positions / SIZES + 0.5, 0.05, 0.95).astype(np.float32)
    # The map is stored turned away, and the light turned back: the scene's transform has to turn it.
    stored = replace(lamp(-70.0), rotate_deg=70.0)
    folder = write_asset_bundle(tmp_path / "box", surface, coloured(surface, albedo), cameras=[CAMERA])
    write_formats(load_bundle(folder), tmp_path / "out", ["mitsuba"], environment=stored)
    scene = tmp_path / "out" / "mitsuba" / "scene.xml"
    # Lambert's law has a closed form, which `principled` has not.
    matt = scene.read_text().replace('bsdf type="principled"', 'bsdf type="diffuse"')
    for name in ("roughness", "metallic"):
        start = matt.index(f'<texture type="bitmap" name="{name}">')
        end = matt.index("</texture>", start) + len("</texture>")
        matt = matt[:start] + matt[end:]
    matt = matt.replace('name="base_color"', 'name="reflectance"').replace(
        '<float name="specular" value="0.5"/>', ""
    )
    scene.write_text(matt)
    picture = rendered(mi, scene, 256)

    flux = light.radiance * pixel_solid_angles(64, 128)[:, None, None]
    cosine = np.maximum(surface.texel_normals @ pixel_directions(64, 128).reshape(-1, 3).T, 0.0)
    expected, inside = visible(surface, albedo / np.pi * (cosine @ flux.reshape(-1, 3)))
    assert inside.sum() > 300
    error = picture[inside][:, :3] - expected[inside]
    scale = expected[inside].mean(axis=0)
    assert np.abs(error.mean(axis=0) / scale).max() < 0.01
    assert np.sqrt((error**2).mean(axis=0) / scale**2).max() < 0.05
    assert np.abs(picture[..., 3] - (expected[..., 0] > 0.0)).mean() < 0.02


def test_the_scene_as_written_is_as_bright_as_our_own_picture(mi, tmp_path):
    surface = atlas_box(64)
    towards_lamp = lamp().radiance + np.float32(0.2)
    folder = write_asset_bundle(
        tmp_path / "box", surface, painted(surface), cameras=[CAMERA], radiance=towards_lamp
    )
    bundle = load_bundle(folder)
    write_formats(bundle, tmp_path / "out", ["mitsuba"])
    picture = rendered(mi, tmp_path / "out" / "mitsuba" / "scene.xml", 64)
    light = bundle.trained_environment("sky")
    ours = Renderer(bundle, num_threads=1, reader="onnx").render(CAMERA, light, spp=64, antialias=1)
    _, inside = visible(surface, surface.positions)
    # `principled` reflects up to a tenth more or less than our model.
    np.testing.assert_allclose(picture[inside][:, :3].mean(axis=0), ours.rgb[inside].mean(axis=0), rtol=0.1)
    assert np.abs(picture[..., 3] - ours.opacity[..., 0]).mean() < 0.05

"""A ball written as GLB, lit by the same map in Mitsuba and here: orientation and brightness agree.

Mitsuba's `principled` has Smith's exact shadowing and Disney's diffuse lobe, so it reflects up to a tenth
more or less than our model. Pictures are therefore compared per pixel after division by those under even
light, and the diffuse part, which both know exactly, without it. A mirrored map misses by far more.
"""

import numpy as np
import pytest
from lambent_core.directions import dot, normalise, pixel_directions
from lambent_relight import load_bundle, turntable
from lambent_relight.baked.split_sum import split_sum
from lambent_relight.brdf import base_reflectance, materials_from_roughness
from lambent_relight.environment.axes import from_axes
from lambent_relight.environment.harmonics import basis, cosine_factors, project
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.environment.prefilter import prefilter
from lambent_relight.renderer import Renderer
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere, Surface

pytestmark = pytest.mark.slow
SIZE = 24
CAMERA = turntable(1, radius=4.0, elevation_deg=20.0, width=SIZE, height=SIZE, start_deg=100.0)[0]
SURFACES = {
    "matt": Surface(albedo=(0.7, 0.5, 0.3), perceptual_roughness=1.0, metalness=0.0),
    "metal": Surface(albedo=(0.9, 0.7, 0.4), perceptual_roughness=0.5, metalness=1.0),
}
# Error of the mean of a channel, and of pixels, relative. Prefiltered levels take the lobe for round, which
# it is only where one looks straight at the surface; metal shows that.
BOUNDS = {
    ("matt", "refined"): (0.015, 0.04),
    ("matt", "baked"): (0.015, 0.04),
    ("metal", "refined"): (0.015, 0.04),
    ("metal", "baked"): (0.1, 0.12),
}


def lopsided_light():
    """Return light without any symmetry: a warm window, a blue sky above, a green corner below."""
    d = pixel_directions(256, 512)
    lamps = [((0.9, 0.5, 0.3), 8.0, (3.0, 2.0, 1.0)), ((-0.2, 0.3, 0.9), 2.0, (0.3, 0.5, 1.2))]
    lamps += [((0.3, -0.8, -0.4), 6.0, (0.2, 0.9, 0.3))]
    image = np.full((256, 512, 3), 0.15)
    for direction, sharpness, colour in lamps:
        lobe = np.exp(sharpness * (d @ normalise(np.array(direction)) - 1.0))
        image = image + lobe[..., None] * np.array(colour)
    return environment_from_array(image)


def to_y_up(points):
    """Return world points in glTF's axes: (x, z, -y)."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def write_ball(path, surface):
    """Write a GLB of the unit ball, y up by the rotation of its root node like every asset of ours."""
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(
            baseColorFactor=[*surface.albedo, 1.0],
            metallicFactor=surface.metalness,
            roughnessFactor=surface.perceptual_roughness,
        )
    )
    scene = trimesh.Scene()
    y_up = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
    scene.add_geometry(ball, transform=y_up)
    path.write_bytes(scene.export(file_type="glb"))


def mitsuba_picture(tmp_path, glb, environment, *, lambert=False):
    """Return the linear picture that Mitsuba makes of the GLB in the light of a map, [SIZE, SIZE, 3]."""
    mi = pytest.importorskip("mitsuba", reason="the comparison needs Mitsuba (extra `dev`)")
    trimesh = pytest.importorskip("trimesh")
    mi.set_variant("scalar_rgb")
    scene = trimesh.load_scene(glb)
    mesh = scene.to_mesh()
    (geometry,) = scene.geometry.values()
    material = geometry.visual.material
    base = np.asarray(material.baseColorFactor, np.float64)
    base = base / 255.0 if base.max() > 1.0 else base
    mesh.export(tmp_path / "ball.ply", vertex_normal=True)
    pose = CAMERA.camera_to_world
    origin, forward, up = (to_y_up(v).tolist() for v in (pose[:3, 3], -pose[:3, 2], pose[:3, 1]))
    colour = {"type": "rgb", "value": base[:3].tolist()}
    principled = {
        "type": "principled",
        "base_color": colour,
        "roughness": float(material.roughnessFactor),
        "metallic": float(material.metallicFactor),
        "specular": 0.5,
    }
    bitmap = mi.Bitmap(np.ascontiguousarray(environment.radiance, np.float32))
    look = mi.ScalarTransform4f().look_at(origin, (np.array(origin) + forward).tolist(), up)
    loaded = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
            "light": {"type": "envmap", "bitmap": bitmap},
            "ball": {
                "type": "ply",
                "filename": str(tmp_path / "ball.ply"),
                "bsdf": {"type": "diffuse", "reflectance": colour} if lambert else principled,
            },
            "camera": {
                "type": "perspective",
                "fov": float(np.degrees(2.0 * np.arctan(0.5 * CAMERA.width / CAMERA.focal_x))),
                "to_world": look,
                "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
                "sampler": {"type": "multijitter", "sample_count": 196},
            },
        }
    )
    return np.array(mi.render(loaded, seed=0))[..., :3]


def whole_pixels():
    """Return which pixels lie inside the ball, away from its edge, [SIZE, SIZE]."""
    origin, direction = CAMERA.rays()
    b = dot(origin, direction)[:, 0]
    return (b * b - dot(origin, origin)[:, 0] + 1.0 > 0.08).reshape(SIZE, SIZE)


def in_mitsuba(light):
    """Return our map in Mitsuba's layout: turned the other way, which is how skylibs' becomes ours."""
    return from_axes(light, "skylibs")


def baked_picture(surface, environment):
    """Return the diffuse and the specular part of the same ball, from harmonics, levels and the split sum."""
    origin, direction = CAMERA.rays()
    b = dot(origin, direction)[:, 0]
    discriminant = b * b - dot(origin, origin)[:, 0] + 1.0
    distance = -b - np.sqrt(np.maximum(discriminant, 0.0))
    normal = normalise(origin + distance[:, None] * direction)
    materials = materials_from_roughness(
        np.broadcast_to(np.float32(surface.albedo), normal.shape),
        np.full((len(normal), 1), surface.perceptual_roughness),
        np.full((len(normal), 1), surface.metalness),
    )
    irradiance = basis(normal, 7) @ (project(environment, 7) * cosine_factors(7)[:, None])
    diffuse = (1.0 - surface.metalness) * materials.albedo * irradiance / np.pi
    mirror = 2.0 * dot(normal, -direction) * normal + direction
    rough = np.full(len(normal), surface.perceptual_roughness)
    scale, bias = split_sum(dot(normal, -direction)[:, 0], rough)
    specular = base_reflectance(materials.albedo, materials.metalness) * scale[:, None] + bias[:, None]
    specular = specular * prefilter(environment).lookup(mirror, rough)
    return diffuse.reshape(SIZE, SIZE, 3), specular.reshape(SIZE, SIZE, 3)


def relative_error(found, expected):
    """Return the root mean square difference over the mean."""
    return float(np.sqrt(np.mean((found - expected) ** 2)) / expected.mean())


@pytest.mark.parametrize("kind", SURFACES)
def test_mitsuba_sees_the_same_ball_in_the_same_light(tmp_path, kind):
    surface, inside = SURFACES[kind], whole_pixels()
    write_ball(tmp_path / "ball.glb", surface)
    folder = write_analytic_bundle(tmp_path / "ball", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0, surface)]))
    renderer = Renderer(load_bundle(folder), num_threads=1, reader="onnx")

    def pictures(light):
        theirs = mitsuba_picture(tmp_path, tmp_path / "ball.glb", in_mitsuba(light))
        refined = renderer.render(CAMERA, light, spp=384, antialias=1).rgb
        return {"mitsuba": theirs, "refined": refined, "baked": sum(baked_picture(surface, light))}

    lit, even = pictures(lopsided_light()), pictures(environment_from_array(np.ones((64, 128, 3))))
    reference = lit["mitsuba"][inside] / even["mitsuba"][inside]
    for name in ("refined", "baked"):
        mean_bound, pixel_bound = BOUNDS[kind, name]
        np.testing.assert_allclose(even[name][inside].mean() / even["mitsuba"][inside].mean(), 1.0, atol=0.1)
        ours = lit[name][inside] / even[name][inside]
        ratio = ours.mean(axis=0) / reference.mean(axis=0)
        np.testing.assert_allclose(ratio, 1.0, atol=mean_bound, err_msg=name)
        assert relative_error(ours, reference) < pixel_bound, name
    for wrong in (lit["refined"][:, ::-1], lit["refined"][::-1]):
        assert relative_error(wrong[inside], lit["mitsuba"][inside]) > 0.12


def test_mitsuba_and_harmonics_agree_on_the_brightness_of_a_diffuse_ball(tmp_path):
    surface, light, inside = SURFACES["matt"], lopsided_light(), whole_pixels()
    write_ball(tmp_path / "ball.glb", surface)
    theirs = mitsuba_picture(tmp_path, tmp_path / "ball.glb", in_mitsuba(light), lambert=True)
    ours, _ = baked_picture(surface, light)
    np.testing.assert_allclose(ours[inside].mean(axis=0) / theirs[inside].mean(axis=0), 1.0, atol=0.01)
    assert relative_error(ours[inside], theirs[inside]) < 0.02
    unconverted = mitsuba_picture(tmp_path, tmp_path / "ball.glb", light, lambert=True)
    assert relative_error(ours[inside], unconverted[inside]) > 0.2

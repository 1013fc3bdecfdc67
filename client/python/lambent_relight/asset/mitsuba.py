"""A bundle's asset as a scene of Mitsuba 3: mesh, `principled` material, environment and cameras.

The scene keeps the world's axes (z up). Mitsuba's cameras look along +z with x to the left, ours along -z
with x to the right. Its environment maps are y up; `ENVIRONMENT_TO_WORLD` turns them, and their rows lie
elsewhere (`_in_mitsubas_rows`). Source: Mitsuba 3 documentation (envmap, perspective, principled, normalmap).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from lambent_core.pictures import safe_name
from numpy.typing import NDArray

from lambent_relight.asset.textured_mesh import TexturedMesh, pixels_of, png_of
from lambent_relight.baked.raster import nearest_texel, rasterise_uv
from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import Environment, write_environment

ENVIRONMENT_TO_WORLD = ((0, 0, 1, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1))
"""World directions of Mitsuba's: its +y is our +z, and its -z, the left edge of a map, our -x."""
_LEAST_ROWS = 512
"""Rows of an exported map at least."""
_SCENE = """\
<!-- mitsuba scene.xml; other light and quality: mitsuba -D environment=sky.exr -D spp=1024 scene.xml
     The map is laid out as in Lambent and Blender: +x in the centre, +z up. Sensors are its cameras. -->
<scene version="3.0.0">
  <default name="environment" value="environment.exr"/>
  <default name="spp" value="128"/>
  <integrator type="path">
    <boolean name="hide_emitters" value="true"/>
  </integrator>
  <emitter type="envmap">
    <string name="filename" value="$environment"/>
    <transform name="to_world"><matrix value="{environment_to_world}"/></transform>
  </emitter>
  <bsdf type="twosided" id="surface">
    <bsdf type="normalmap">
      <texture type="bitmap" name="normalmap">
        <string name="filename" value="normal.png"/>
        <boolean name="raw" value="true"/>
        <string name="wrap_mode" value="clamp"/>
      </texture>
      <bsdf type="principled">
        <texture type="bitmap" name="base_color">
          <string name="filename" value="base_colour.png"/>
          <string name="wrap_mode" value="clamp"/>
        </texture>
        <texture type="bitmap" name="roughness">
          <string name="filename" value="roughness.png"/>
          <boolean name="raw" value="true"/>
          <string name="wrap_mode" value="clamp"/>
        </texture>
        <texture type="bitmap" name="metallic">
          <string name="filename" value="metalness.png"/>
          <boolean name="raw" value="true"/>
          <string name="wrap_mode" value="clamp"/>
        </texture>
        <float name="specular" value="0.5"/>
      </bsdf>
    </bsdf>
  </bsdf>
  <shape type="ply" id="asset">
    <string name="filename" value="asset.ply"/>
    <ref id="surface"/>
  </shape>
{sensors}
</scene>
"""
_SENSOR = """\
  <sensor type="perspective" id="{name}">
    <string name="fov_axis" value="x"/>
    <float name="fov" value="{fov:.9g}"/>
    <float name="principal_point_offset_x" value="{offset_x:.9g}"/>
    <float name="principal_point_offset_y" value="{offset_y:.9g}"/>
    <float name="near_clip" value="{near:.9g}"/>
    <float name="far_clip" value="{far:.9g}"/>
    <transform name="to_world"><matrix value="{to_world}"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="{width}"/>
      <integer name="height" value="{height}"/>
      <string name="pixel_format" value="rgba"/>
      <rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
  </sensor>"""


def write_mitsuba(
    folder: Path, mesh: TexturedMesh, environment: Environment, cameras: Sequence[Camera]
) -> None:
    """Write scene.xml, asset.ply, textures and environment.exr into `folder`.

    Mitsuba's pixels are square: a camera with two focal lengths keeps its horizontal one. `principled` has
    Smith's exact shadowing and Disney's diffuse lobe, and reflects up to a tenth more or less than we do.
    """
    folder.mkdir(parents=True, exist_ok=True)
    packed = pixels_of(mesh.packed_png) / 255.0
    (folder / "base_colour.png").write_bytes(mesh.base_colour_png)
    (folder / "roughness.png").write_bytes(png_of(packed[..., 1]))
    (folder / "metalness.png").write_bytes(png_of(packed[..., 2]))
    (folder / "normal.png").write_bytes(png_of(_unmirrored_normals(mesh)))
    (folder / "asset.ply").write_bytes(_ply(mesh))
    write_environment(folder / "environment.exr", _in_mitsubas_rows(environment.radiance), half=False)
    reach = float(np.linalg.norm(mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)))
    sensors = "\n".join(_sensor(camera, number, mesh, reach) for number, camera in enumerate(cameras))
    to_world = _turn_about_z(environment.rotate_deg) @ np.array(ENVIRONMENT_TO_WORLD, np.float64)
    text = _SCENE.format(environment_to_world=_numbers(to_world), sensors=sensors)
    (folder / "scene.xml").write_text(text, encoding="utf-8")


def _in_mitsubas_rows(radiance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a map [height, width, 3] with its rows where Mitsuba looks for them.

    Mitsuba's first and last row lie on the poles, ours half a row away from them: in a map of 16 rows light
    would come from up to 6 degrees beside its place. Small maps get more rows, so that what lies between two
    is as we mean it.
    """
    height = len(radiance)
    rows = height * max(1, -(-_LEAST_ROWS // height)) + 1
    place = np.clip(np.linspace(0.0, height, rows) - 0.5, 0.0, height - 1.0)
    above = np.minimum(place.astype(np.int64), max(height - 2, 0))
    below = np.minimum(above + 1, height - 1)
    share = (place - above)[:, None, None]
    return (radiance[above] * (1.0 - share) + radiance[below] * share).astype(np.float32)


def _unmirrored_normals(mesh: TexturedMesh) -> NDArray[np.float64]:
    """Return the normal map as Mitsuba reads it, [size, size, 3] in [0, 1].

    Its second axis is always the normal cross the tangent, whereas glTF's turns with mirrored charts.
    """
    normal = pixels_of(mesh.normal_png) / 255.0
    size = len(normal)
    faces = rasterise_uv(mesh.uv, mesh.faces, size)
    a, b, c = (mesh.uv[mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
    first, second = b - a, c - a
    # v counts downwards, so a chart seen from outside turns clockwise.
    mirrored = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] > 0.0
    if faces.covered.any():
        # Texels between charts repeat the nearest one's, and turn with it.
        nearest = nearest_texel(np.flatnonzero(faces.covered), size)
        turned = mirrored[faces.face[faces.covered]][nearest]
        normal[turned, 1] = 1.0 - normal[turned, 1]
    return normal


def _ply(mesh: TexturedMesh) -> bytes:
    """Return the mesh as a binary PLY file; v counts from the top row, as Mitsuba reads bitmaps."""
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(mesh.vertices)}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "u", "v")),
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    vertices = np.concatenate([mesh.vertices, mesh.normals, mesh.uv], axis=1).astype("<f4")
    faces = np.empty(len(mesh.faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    faces["count"], faces["corners"] = 3, mesh.faces
    return ("\n".join(header) + "\n").encode() + vertices.tobytes() + faces.tobytes()


def _sensor(camera: Camera, number: int, mesh: TexturedMesh, reach: float) -> str:
    away = float(np.linalg.norm(mesh.vertices.mean(axis=0) - camera.camera_to_world[:3, 3]))
    pose = camera.camera_to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])
    return _SENSOR.format(
        # Names may repeat, and a dollar sign would be a parameter.
        name=f"camera_{number}_{safe_name(camera.name)}",
        fov=np.degrees(2.0 * np.arctan(0.5 * camera.width / camera.focal_x)),
        # Mitsuba's offsets move the film, not the principal point.
        offset_x=0.5 - camera.centre_x / camera.width,
        offset_y=0.5 - camera.centre_y / camera.height,
        near=1e-4 * reach,
        far=away + 10.0 * reach,
        to_world=_numbers(pose),
        width=camera.width,
        height=camera.height,
    )


def _turn_about_z(degrees: float) -> NDArray[np.float64]:
    turn, angle = np.eye(4), np.radians(degrees)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return turn


def _numbers(matrix: object) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(matrix, np.float64).ravel())

"""An asset as Wavefront OBJ with a material library and textures.

OBJ has no axes of its own; y is up here, which most programs assume: (x, y, z) = world (x, z, -y). Texture
rows count from the bottom. Source: Wavefront OBJ and MTL specifications, and the keywords Pr, Pm and norm of
the MTL extension for physically based rendering (Exocortex).
"""

from pathlib import Path

import numpy as np

from lambent_relight.asset.textured_mesh import TexturedMesh, pixels_of, png_of

_MATERIAL = """\
# Base colour in sRGB; roughness is perceptual, the square root of the GGX width.
newmtl surface
Ka 0 0 0
Kd 1 1 1
Ks 0.04 0.04 0.04
illum 2
map_Kd base_colour.png
Pr 1
map_Pr roughness.png
Pm 1
map_Pm metalness.png
norm normal.png
"""


def write_obj(folder: Path, mesh: TexturedMesh) -> None:
    """Write asset.obj, asset.mtl and the textures they name into `folder`.

    occlusion.png has no keyword in MTL and is written with them, for programs that can use it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    packed = pixels_of(mesh.packed_png) / 255.0
    for channel, name in enumerate(("occlusion", "roughness", "metalness")):
        (folder / f"{name}.png").write_bytes(png_of(packed[..., channel]))
    (folder / "base_colour.png").write_bytes(mesh.base_colour_png)
    (folder / "normal.png").write_bytes(mesh.normal_png)
    (folder / "asset.mtl").write_text(_MATERIAL, encoding="utf-8")
    y_up = np.array([1.0, 1.0, -1.0], np.float32)
    v_up = mesh.uv * np.array([1.0, -1.0], np.float32) + np.array([0.0, 1.0], np.float32)
    with (folder / "asset.obj").open("w", encoding="utf-8", newline="\n") as file:
        file.write("# y up; lengths in scene units\nmtllib asset.mtl\no asset\n")
        np.savetxt(file, mesh.vertices[:, [0, 2, 1]] * y_up, fmt="v %.9g %.9g %.9g")
        np.savetxt(file, v_up, fmt="vt %.9g %.9g")
        np.savetxt(file, mesh.normals[:, [0, 2, 1]] * y_up, fmt="vn %.6g %.6g %.6g")
        file.write("usemtl surface\ns 1\n")
        corners = np.repeat(mesh.faces.astype(np.int64) + 1, 3, axis=1)
        np.savetxt(file, corners, fmt="f %d/%d/%d %d/%d/%d %d/%d/%d")

"""Open a relightable bundle in Blender: the mesh, its light and its cameras, with the right axes.

    lambent blender -o blender_import.py
    blender --python blender_import.py -- NAME.relight [--env sky.exr] [--rotate-deg 30] [--view 0]

`lambent blender NAME.relight` writes these arguments into the script, for Blender's text editor. Without
--env the environment recovered for the first training light is used. Blender's world is right-handed
with z up, as a bundle's is, and its environment maps have +x in the middle and +y left of it, as ours have: a
map needs no turn. Written for Blender 3.6 and later; the functions above `main` need no Blender.
"""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

OWN_ARGUMENTS: list[str] = []
"""Arguments where none follow `--`."""


def arguments_of(argv: list[str]) -> argparse.Namespace:
    """Return the arguments behind `--`, as Blender passes them on, or those written into the script."""
    own = argv[argv.index("--") + 1 :] if "--" in argv else OWN_ARGUMENTS
    parser = argparse.ArgumentParser(prog="blender --python blender_import.py --")
    parser.add_argument("bundle", type=Path, help="folder NAME.relight")
    parser.add_argument("--env", type=Path, help="equirectangular map, .exr or .hdr")
    parser.add_argument("--rotate-deg", type=float, default=0.0, help="turn the light about +z")
    parser.add_argument("--strength", type=float, default=1.0, help="factor on the light")
    parser.add_argument("--view", type=int, default=0, help="number of the camera to look through")
    return parser.parse_args(own)


def environment_path(bundle: Path) -> Path:
    """Return the environment recovered for the first training light; raises ValueError without."""
    lights = json.loads((bundle / "manifest.json").read_text(encoding="utf-8"))["train_lights"]
    path = bundle / "env" / f"trained_{lights[0]}.exr" if lights else None
    if path is None or not path.is_file():
        raise ValueError(f"{bundle} has no recovered environment; give one with --env")
    return path


def mapping_rotation_z(rotate_deg: float) -> float:
    """Return the z rotation, in radians, of the Mapping node in front of the environment texture.

    The node turns the direction that is looked up, hence the light turns the other way: a light turned by
    +rotate_deg about +z is looked up in directions turned by -rotate_deg.
    """
    return math.radians(-rotate_deg)


def blender_texture_u(direction: tuple[float, float, float]) -> float:
    """Return the column, 0..1 from the left, that Blender's Environment Texture reads for a direction.

    Source: Cycles, direction_to_equirectangular in kernel/camera/projection.h.
    """
    return (0.5 - math.atan2(direction[1], direction[0]) / (2.0 * math.pi)) % 1.0


def lens_of(camera: dict) -> dict[str, float]:
    """Return Blender's lens settings of a pinhole camera of cameras.json.

    `lens` is in millimetres for a sensor 36 wide that fits the picture's width; shifts are shares of it.
    """
    width, height = camera["width"], camera["height"]
    return {
        "lens": 36.0 * camera["focal_x"] / width,
        "shift_x": (0.5 * width - camera["centre_x"]) / width,
        "shift_y": (camera["centre_y"] - 0.5 * height) / width,
        "pixel_aspect_y": camera["focal_x"] / camera["focal_y"],
    }


def rows_of(camera: dict) -> list[list[float]]:
    """Return camera-to-world, row by row. Blender's cameras look along -z with y up, as a bundle's do."""
    values = camera["camera_to_world"]
    return [values[4 * row : 4 * row + 4] for row in range(4)]


def main() -> None:
    """Fill Blender's open scene."""
    import bpy
    from mathutils import Matrix

    options = arguments_of(sys.argv)
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item, do_unlink=True)
    # The importer turns glTF's y up to Blender's z up, which undoes the turn of the file's node.
    bpy.ops.import_scene.gltf(filepath=str(options.bundle / "mesh" / "asset.glb"))

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.view_settings.view_transform = "Standard"
    _light(bpy, scene, options)
    cameras = json.loads((options.bundle / "cameras.json").read_text(encoding="utf-8"))["cameras"]
    for number, camera in enumerate(cameras):
        lens = lens_of(camera)
        data = bpy.data.cameras.new(camera["name"])
        data.sensor_fit, data.sensor_width = "HORIZONTAL", 36.0
        data.lens, data.shift_x, data.shift_y = lens["lens"], lens["shift_x"], lens["shift_y"]
        data.clip_start = 0.01
        item = bpy.data.objects.new(camera["name"], data)
        item.matrix_world = Matrix(rows_of(camera))
        scene.collection.objects.link(item)
        if number == options.view:
            scene.camera = item
            scene.render.resolution_x, scene.render.resolution_y = camera["width"], camera["height"]
            # Blender allows aspects of 1 and more only.
            aspect = lens["pixel_aspect_y"]
            scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = (
                max(1.0, 1.0 / aspect),
                max(1.0, aspect),
            )


def _light(bpy: Any, scene: Any, options: argparse.Namespace) -> None:
    """Light the scene with the environment, rotated as requested."""
    world = bpy.data.worlds.new("environment")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    place = nodes.new("ShaderNodeTexCoord")
    turn = nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value[2] = mapping_rotation_z(options.rotate_deg)
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(str((options.env or environment_path(options.bundle)).resolve()))
    picture.image.colorspace_settings.is_data = False
    picture.interpolation = "Linear"
    background = nodes.new("ShaderNodeBackground")
    background.inputs["Strength"].default_value = options.strength
    output = nodes.new("ShaderNodeOutputWorld")
    links.new(place.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], background.inputs["Color"])
    links.new(background.outputs["Background"], output.inputs["Surface"])


if __name__ == "__main__":
    main()

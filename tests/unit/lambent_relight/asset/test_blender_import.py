"""The Blender script's arithmetic, and its calls against stand-ins for Blender's modules."""

import json
import math
import sys
from types import ModuleType
from unittest.mock import MagicMock

import numpy as np
import pytest
from lambent_core.directions import rotate_about_z, uv_of_directions
from lambent_relight.asset import blender_import
from lambent_relight.cameras import cameras_json, turntable


@pytest.mark.parametrize("rotate_deg", [0.0, 90.0, -35.0])
def test_blender_reads_the_column_that_a_bundles_reader_reads(rotate_deg):
    directions = np.random.default_rng(1).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ours, _ = uv_of_directions(rotate_about_z(directions, -rotate_deg))
    mapped = rotate_about_z(directions, math.degrees(blender_import.mapping_rotation_z(rotate_deg)))
    blenders = [blender_import.blender_texture_u(tuple(direction)) for direction in mapped]
    assert np.allclose(np.exp(2j * np.pi * ours), np.exp(2j * np.pi * np.array(blenders)))


def test_a_lens_is_given_in_millimetres_with_the_shift_of_its_centre():
    camera = {
        "width": 200,
        "height": 100,
        "focal_x": 400.0,
        "focal_y": 200.0,
        "centre_x": 90.0,
        "centre_y": 60.0,
    }
    assert blender_import.lens_of(camera) == pytest.approx(
        {"lens": 72.0, "shift_x": 0.05, "shift_y": 0.05, "pixel_aspect_y": 2.0}
    )


def test_arguments_are_those_behind_two_dashes():
    found = blender_import.arguments_of(
        ["blender", "--python", "x.py", "--", "a.relight", "--rotate-deg", "30"]
    )
    assert (str(found.bundle), found.rotate_deg, found.env) == ("a.relight", 30.0, None)
    with pytest.raises(SystemExit):
        blender_import.arguments_of(["blender"])


def test_arguments_written_into_the_script_count_where_none_follow(monkeypatch):
    monkeypatch.setattr(blender_import, "OWN_ARGUMENTS", ["own.relight", "--view", "3"])
    found = blender_import.arguments_of(["blender", "--python", "x.py"])
    assert (str(found.bundle), found.view) == ("own.relight", 3)
    assert str(blender_import.arguments_of(["blender", "--", "a.relight"]).bundle) == "a.relight"


@pytest.fixture
def bundle(tmp_path):
    (tmp_path / "manifest.json").write_text(json.dumps({"train_lights": ["day"]}))
    (tmp_path / "cameras.json").write_text(cameras_json(turntable(3, radius=2.0)))
    (tmp_path / "env").mkdir()
    (tmp_path / "env" / "trained_day.exr").write_bytes(b"")
    return tmp_path


def test_the_environment_is_that_of_the_first_light(bundle):
    assert blender_import.environment_path(bundle).name == "trained_day.exr"
    (bundle / "env" / "trained_day.exr").unlink()
    with pytest.raises(ValueError, match="--env"):
        blender_import.environment_path(bundle)


def test_the_script_imports_the_mesh_and_sets_light_and_cameras(bundle, monkeypatch):
    bpy, mathutils = MagicMock(), ModuleType("mathutils")
    mathutils.Matrix = list
    monkeypatch.setitem(sys.modules, "bpy", bpy)
    monkeypatch.setitem(sys.modules, "mathutils", mathutils)
    monkeypatch.setattr(sys, "argv", ["blender", "--", str(bundle), "--rotate-deg", "90", "--view", "1"])
    blender_import.main()
    bpy.ops.import_scene.gltf.assert_called_once_with(filepath=str(bundle / "mesh" / "asset.glb"))
    assert bpy.data.images.load.call_args.args[0].endswith("trained_day.exr")
    assert bpy.data.cameras.new.call_count == 3
    scene = bpy.context.scene
    assert scene.render.resolution_x == 512
    assert scene.camera is bpy.data.objects.new.return_value
    assert np.allclose(scene.camera.matrix_world, turntable(3, radius=2.0)[2].camera_to_world)

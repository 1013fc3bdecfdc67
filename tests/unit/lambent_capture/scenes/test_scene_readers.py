"""Both layouts become the same description of a scene."""

import json
import shutil

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene, detect_layout
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.lights import select_lights
from lambent_core.errors import SceneRefusedError, UsageError
from lambent_proto.v1 import scene_pb2
from support.captures import (
    ANGLE,
    REFERENCES,
    SIDE,
    edit_frame,
    photograph,
    read_transforms,
    save,
    write_blender,
    write_tensoir,
    write_transforms,
)

SCENES = REFERENCES / "scenes"


def names(manifest, split):
    return [frame.name for frame in manifest.frames if frame.split == split]


def test_layouts_are_told_apart(tmp_path):
    assert detect_layout(SCENES / "tensoir_synthetic") == "tensoir_synthetic"
    assert detect_layout(SCENES / "nerf_blender") == "nerf_blender"
    assert detect_layout(tmp_path) is None
    assert detect_layout(tmp_path / "nowhere") is None


def test_a_layout_can_be_forced(tmp_path):
    write_blender(write_tensoir(tmp_path))
    assert describe_scene(tmp_path).layout == "tensoir_synthetic"
    assert describe_scene(tmp_path, "nerf_blender").layout == "nerf_blender"


def test_both_layouts_of_one_scene_agree_on_the_cameras():
    one = describe_scene(SCENES / "tensoir_synthetic")
    other = describe_scene(SCENES / "nerf_blender")
    first = next(frame for frame in one.frames if frame.name == "test_000").camera
    second = next(frame for frame in other.frames if frame.name == "test_r_0").camera
    assert (first.width, first.height) == (second.width, second.height) == (128, 128)
    assert first.focal_x == pytest.approx(second.focal_x)
    matrices = [np.array(camera.camera_to_world).reshape(4, 4) for camera in (first, second)]
    # The samples come from different converters, one of which turned the scene half round.
    np.testing.assert_allclose(np.abs(matrices[0]), np.abs(matrices[1]), atol=1e-6)


def test_scene_json_says_which_lights_are_trained_on_and_where_the_object_is():
    manifest = describe_scene(SCENES / "tensoir_synthetic")
    assert list(manifest.lights) == ["venice_sunset_000", "venice_sunset_120"]
    assert list(manifest.relight_lights) == ["studio_small_05"]
    assert list(manifest.bounds.minimum) == [-1.35] * 3
    assert (manifest.primary_rays.near, manifest.primary_rays.far) == (2.0, 6.0)
    assert manifest.contraction_radius == pytest.approx(1.35)
    assert (manifest.secondary_rays.near, manifest.secondary_rays.far) == pytest.approx((0.05, 2.0))


def test_without_scene_json_sunset_is_the_first_light_and_known_test_lights_are_not_trained_on(tmp_path):
    write_tensoir(tmp_path, lights=("courtyard", "sunset", "city"), relight=("night",))
    manifest = describe_scene(tmp_path)
    assert list(manifest.lights) == ["sunset", "courtyard"]
    assert list(manifest.relight_lights) == ["city", "night"]


def test_the_published_scenes_get_the_published_ranges(tmp_path):
    manifest = describe_scene(write_tensoir(tmp_path))
    assert (manifest.primary_rays.near, manifest.primary_rays.far) == pytest.approx((2.0, 6.0))
    assert manifest.contraction_radius == pytest.approx(2.0)
    assert list(manifest.bounds.maximum) == pytest.approx([2.0] * 3)


def test_a_generic_upload_gets_ranges_from_its_cameras(tmp_path):
    manifest = describe_scene(write_blender(tmp_path))
    assert (manifest.primary_rays.near, manifest.primary_rays.far) == pytest.approx((0.4, 16.0))
    assert (manifest.secondary_rays.near, manifest.secondary_rays.far) == pytest.approx((0.05, 2.0))


def test_an_object_beside_the_origin_is_moved_there_and_the_move_is_recorded(tmp_path):
    folder = write_blender(tmp_path)
    for split in ("train", "test"):
        transforms = read_transforms(folder, split)
        for frame in transforms["frames"]:
            frame["transform_matrix"][0][3] += 3.0
        write_transforms(folder, split, transforms)
    assert not inspect_files(folder).report.findings
    manifest = describe_scene(folder)
    assert manifest.contraction_radius == pytest.approx(2.0)
    assert list(manifest.bounds.minimum) == pytest.approx([-2.0, -2.0, -2.0])
    moved = np.array(manifest.world_from_capture).reshape(4, 4)
    np.testing.assert_allclose(moved, [[1, 0, 0, -3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-5)
    kept = describe_scene(write_blender(tmp_path / "kept"))
    assert list(kept.world_from_capture) == []
    for one, other in zip(manifest.frames, kept.frames, strict=True):
        np.testing.assert_allclose(one.camera.camera_to_world, other.camera.camera_to_world, atol=1e-5)


def test_every_eighth_view_is_held_out_when_there_is_no_test_split(tmp_path):
    manifest = describe_scene(write_blender(tmp_path, num_train=17, num_test=0))
    assert names(manifest, scene_pb2.SPLIT_TEST) == ["train_r_7", "train_r_15"]


def test_validation_frames_stand_in_for_a_missing_test_split(tmp_path):
    folder = write_blender(tmp_path, num_train=9)
    (folder / "transforms_test.json").rename(folder / "transforms_val.json")
    assert len(names(describe_scene(folder), scene_pb2.SPLIT_TEST)) == 2


def test_a_lens_in_pixels_of_a_larger_original_is_scaled_to_the_picture(tmp_path):
    folder = write_blender(tmp_path)
    edit_frame(folder, 0, fl_x=48.0, fl_y=60.0, cx=20.0, cy=28.0, w=4 * SIDE, h=4 * SIDE)
    camera = describe_scene(folder).frames[0].camera
    assert (camera.focal_x, camera.focal_y, camera.centre_x, camera.centre_y) == (12.0, 15.0, 5.0, 7.0)


def test_the_field_of_view_becomes_a_focal_length_in_pixels(tmp_path):
    camera = describe_scene(write_blender(tmp_path)).frames[0].camera
    assert camera.focal_x == pytest.approx(0.5 * SIDE / np.tan(0.5 * ANGLE))
    assert (camera.centre_x, camera.centre_y) == (0.5 * SIDE, 0.5 * SIDE)


def test_a_blender_scene_finds_its_truth_beside_the_pictures():
    manifest = describe_scene(SCENES / "nerf_blender")
    frame = next(frame for frame in manifest.frames if frame.split == scene_pb2.SPLIT_TEST)
    assert set(frame.truth) == {"albedo", "normal"}


def test_rounded_rotations_are_cleaned(tmp_path):
    folder = write_blender(tmp_path)
    rounded = np.round(read_transforms(folder)["frames"][0]["transform_matrix"], 4)
    edit_frame(folder, 0, transform_matrix=rounded.tolist())
    pose = np.array(describe_scene(folder).frames[0].camera.camera_to_world).reshape(4, 4)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


def test_one_light_is_trained_on_by_default_and_test_views_keep_the_relighting_lights():
    manifest = select_lights(describe_scene(SCENES / "tensoir_synthetic"))
    assert list(manifest.lights) == ["venice_sunset_000"]
    lights = {frame.name: [image.light for image in frame.images] for frame in manifest.frames}
    assert lights["train_000"] == ["venice_sunset_000"]
    assert lights["test_000"] == ["venice_sunset_000", "studio_small_05"]


def test_lights_are_indexed_in_the_order_they_were_asked_for():
    wanted = ("venice_sunset_120", "venice_sunset_000")
    manifest = select_lights(describe_scene(SCENES / "tensoir_synthetic"), wanted)
    assert tuple(manifest.lights) == wanted


@pytest.mark.parametrize("wanted", [("noon",), ("studio_small_05",), ("venice_sunset_000",) * 2])
def test_a_light_that_is_not_there_or_named_twice_is_a_usage_error(wanted):
    with pytest.raises(UsageError, match="venice_sunset_120"):
        select_lights(describe_scene(SCENES / "tensoir_synthetic"), wanted)


def test_an_unknown_layout_is_a_usage_error_that_lists_the_known_ones(tmp_path):
    with pytest.raises(UsageError, match=r"tensoir_synthetic, .*nerf_blender, nerfstudio, colmap"):
        describe_scene(write_blender(tmp_path), "polaroid")


def test_a_refused_scene_carries_every_problem(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "train_000" / "metadata.json").write_text("{")
    (folder / "train_001" / "rgba_sunset.png").unlink()
    shutil.rmtree(folder / "test_000")
    with pytest.raises(SceneRefusedError) as refused:
        describe_scene(folder)
    codes = [finding.code for finding in refused.value.report.findings]
    assert codes.count("scene.metadata_unreadable") == 1
    assert codes.count("scene.file_missing") == 1
    assert refused.value.exit_code == 4


def test_a_light_that_scene_json_names_but_nobody_photographed_is_reported(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "scene.json").write_text(json.dumps({"train_env": "sunset", "rotations": ["000"]}))
    with pytest.raises(SceneRefusedError, match="sunset_000"):
        describe_scene(folder)


GENERAL = ("sunset", "snow", "courtyard")
ROTATED = ("sunset_000", "sunset_120", "sunset_240")
RELIT = ("bridge", "city", "fireplace", "forest", "night")


def test_all_eleven_lights_of_the_published_scenes_are_sorted_into_training_and_relighting(tmp_path):
    write_tensoir(tmp_path, lights=(*GENERAL, *ROTATED, *RELIT), relight=())
    manifest = describe_scene(tmp_path)
    assert list(manifest.lights) == ["sunset", *ROTATED, "snow", "courtyard"]
    assert list(manifest.relight_lights) == list(RELIT)
    for names_of in (GENERAL, ROTATED):
        chosen = select_lights(manifest, names_of)
        frames = {frame.name: [image.light for image in frame.images] for frame in chosen.frames}
        assert frames["train_000"] == sorted(names_of, key=list(manifest.lights).index)
        assert set(frames["test_000"]) == {*names_of, *RELIT}


def test_rotated_lights_of_any_environment_need_no_scene_json(tmp_path):
    write_tensoir(tmp_path, lights=("studio_small_000", "studio_small_120", "studio_small_240"))
    assert list(describe_scene(tmp_path).lights) == [
        "studio_small_000",
        "studio_small_120",
        "studio_small_240",
    ]


def test_a_light_that_most_views_lack_is_a_stray_picture_and_no_light(tmp_path):
    folder = write_tensoir(tmp_path, lights=("sunset",))
    shutil.copy(folder / "train_001" / "rgba_sunset.png", folder / "train_001" / "rgba_dusk.png")
    shutil.copy(folder / "test_001" / "rgba_city.png", folder / "test_001" / "rgba_dawn.png")
    for view in ("test_002", "test_003"):
        shutil.copytree(folder / "test_000", folder / view)
    manifest = describe_scene(folder)
    assert list(manifest.lights) == ["sunset"]
    assert list(manifest.relight_lights) == ["city"]


def test_radiance_that_the_renderer_left_beside_the_pictures_is_no_stray_picture():
    assert not inspect_files(SCENES / "tensoir_synthetic").report.findings


def test_validation_pictures_beside_a_test_split_are_no_stray_pictures(tmp_path):
    folder = write_blender(tmp_path, num_train=9)
    transforms = read_transforms(folder, "test")
    save(folder / "test" / "v_0.png", photograph(77))
    transforms["frames"] = [{**transforms["frames"][0], "file_path": "./test/v_0"}]
    write_transforms(folder, "val", transforms)
    assert not inspect_files(folder).report.findings


def test_frames_that_end_in_one_name_are_told_apart_or_refused(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.webp", photograph(50))
    edit_frame(folder, 1, file_path="./train/r_0.webp")
    with pytest.raises(SceneRefusedError, match="frame_duplicate"):
        describe_scene(folder)


def test_a_name_that_stands_twice_in_a_json_object_is_refused(tmp_path):
    folder = write_blender(tmp_path)
    path = folder / "transforms_train.json"
    path.write_text(path.read_text().replace('"camera_angle_x"', '"camera_angle_x": 0.5, "camera_angle_x"'))
    with pytest.raises(SceneRefusedError, match="key_duplicate"):
        describe_scene(folder)

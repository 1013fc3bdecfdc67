"""Wherever a capture lies and whatever its units, the scene stands upright around the origin, and says so."""

import numpy as np
import pytest
from lambent_capture.layouts.detect import collect_scene, describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.load import load_scene
from lambent_capture.problems import Problems
from lambent_capture.scenes.extent import set_fitted_box
from lambent_capture.scenes.world import in_world, move, rotation_and_scale, settle, world_matrix
from lambent_proto.v1 import scene_pb2
from scipy.spatial.transform import Rotation
from support.captures import REFERENCES
from support.layouts import (
    BlenderFolder,
    ColmapBinaryFolder,
    ColmapTextFolder,
    GlossyFolder,
    NerfstudioFolder,
    OpenIlluminationFolder,
    TensoirFolder,
)
from support.uneven_object import BALLS

OFFSET, SCALE = np.array([50.0, -20.0, 7.0]), 30.0


def apply(matrix, points):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def positions(manifest):
    return np.array([frame.camera.camera_to_world for frame in manifest.frames]).reshape(-1, 4, 4)[:, :3, 3]


@pytest.fixture(scope="module")
def far_away(tmp_path_factory):
    capture = ColmapTextFolder(tmp_path_factory.mktemp("far") / "scene", offset=OFFSET, scale=SCALE)
    return capture, describe_scene(capture.folder)


def test_a_distant_capture_in_other_units_is_brought_to_the_origin_and_to_size(far_away):
    _, manifest = far_away
    low, high = np.array(manifest.bounds.minimum), np.array(manifest.bounds.maximum)
    assert np.abs(0.5 * (low + high)).max() < 0.01
    assert 0.5 * (high - low).max() == pytest.approx(1.5, rel=1e-6)
    assert manifest.contraction_radius == pytest.approx(1.5, rel=0.01)
    assert manifest.secondary_rays.near == pytest.approx(0.05, rel=0.01)


def test_the_recorded_similarity_takes_the_capture_s_cameras_to_the_manifest_s(far_away):
    capture, manifest = far_away
    matrix = world_matrix(manifest)
    given = np.array([pose[:3, 3] for pose in capture.poses])
    np.testing.assert_allclose(apply(matrix, given), positions(manifest), atol=1e-4)
    rotation, scale = rotation_and_scale(matrix)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
    assert scale == pytest.approx(np.cbrt(np.linalg.det(matrix[:3, :3])))


def test_the_object_lies_in_the_box_after_the_move(far_away):
    _, manifest = far_away
    matrix = world_matrix(manifest)
    _, scale = rotation_and_scale(matrix)
    for centre, radius in BALLS:
        middle = apply(matrix, OFFSET + SCALE * np.array(centre))
        assert (middle - radius * SCALE * scale > np.array(manifest.bounds.minimum)).all()
        assert (middle + radius * SCALE * scale < np.array(manifest.bounds.maximum)).all()


def test_an_ordinary_capture_keeps_its_coordinates():
    manifest = describe_scene(REFERENCES / "layouts" / "blender")
    assert manifest.bounds_from == "silhouettes"
    assert list(manifest.world_from_capture) == []


@pytest.mark.parametrize("layout", [OpenIlluminationFolder, GlossyFolder])
def test_published_data_keeps_its_coordinates_for_the_presets_that_state_distances_in_them(tmp_path, layout):
    capture = layout(tmp_path / "scene", offset=np.array([0.1, 0.0, 0.05]), scale=0.1)
    manifest = describe_scene(capture.folder)
    assert list(manifest.world_from_capture) == []
    assert manifest.bounds_from == "silhouettes"
    assert manifest.contraction_radius == pytest.approx(
        max(map(abs, (*manifest.bounds.minimum, *manifest.bounds.maximum)))
    )


def tilted(folder, rotation):
    capture = ColmapTextFolder(folder)
    turn = np.eye(4)
    turn[:3, :3] = rotation
    capture.poses = [turn @ pose for pose in capture.poses]
    capture.write_cameras()
    return capture


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_model_that_lies_on_its_side_is_stood_up(tmp_path, seed):
    rotation = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    capture = tilted(tmp_path / "scene", rotation)
    report = inspect_files(capture.folder).report
    assert not report.findings
    turned, _ = rotation_and_scale(world_matrix(describe_scene(capture.folder)))
    np.testing.assert_allclose(turned @ rotation @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=1e-6)


def test_a_model_upside_down_is_stood_up(tmp_path):
    capture = tilted(tmp_path / "scene", np.diag([1.0, -1.0, -1.0]))
    turned, _ = rotation_and_scale(world_matrix(describe_scene(capture.folder)))
    np.testing.assert_allclose(turned @ [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], atol=1e-6)


def test_cameras_held_upright_tell_up_as_well(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    portrait = np.array([[0.0, 1.0, 0, 0], [-1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
    # More views from above than from below, as people photograph.
    capture.poses = [pose @ portrait for pose in capture.poses]
    capture.coverage = [np.rot90(coverage) for coverage in capture.coverage]
    for index in range(4):
        capture.poses[index] = capture.poses[-1 - index]
    capture.write_cameras()
    manifest = describe_scene(capture.folder)
    turned, _ = rotation_and_scale(world_matrix(manifest))
    np.testing.assert_allclose(turned @ [0.0, 0.0, 1.0], [0.0, 0.0, 1.0], atol=0.02)


def test_cameras_held_every_which_way_do_not_tell_up(tmp_path):
    capture = ColmapTextFolder(tmp_path / "scene")
    rng = np.random.default_rng(0)
    for index, pose in enumerate(capture.poses):
        roll = np.eye(4)
        roll[:3, :3] = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True).as_matrix()
        capture.poses[index] = pose @ roll
    capture.write_cameras()
    problems = Problems()
    assert collect_scene(capture.folder, None, problems) is not None
    assert [finding.code for finding in problems.findings()] == ["scene.up_unknown"]


def test_a_box_that_the_capture_states_is_centred_but_keeps_its_units():
    manifest = scene_pb2.SceneManifest(bounds_from="capture")
    manifest.bounds.minimum[:], manifest.bounds.maximum[:] = [9.0, -1.0, -1.0], [31.0, 1.0, 1.0]
    manifest.primary_rays.near, manifest.primary_rays.far = 2.0, 6.0
    settle(manifest)
    assert list(manifest.bounds.minimum) == [-11.0, -1.0, -1.0]
    assert (manifest.primary_rays.near, manifest.primary_rays.far) == (2.0, 6.0)
    assert manifest.contraction_radius == 11.0


def test_a_manifest_is_expressed_in_the_world_of_another_look_at_the_capture(far_away):
    capture, manifest = far_away
    again = describe_scene(capture.folder)
    other = np.eye(4)
    other[:3, :3] = 2.0 * Rotation.from_euler("x", 40, degrees=True).as_matrix()
    other[:3, 3] = [1.0, 2.0, 3.0]
    move(again, other)
    assert not np.allclose(positions(again), positions(manifest))
    in_world(again, world_matrix(manifest))
    np.testing.assert_allclose(positions(again), positions(manifest), atol=1e-9)
    np.testing.assert_allclose(world_matrix(again), world_matrix(manifest), atol=1e-9)


def test_truth_is_turned_and_scaled_with_the_scene():
    folder = REFERENCES / "scenes" / "tensoir_synthetic"
    manifest = describe_scene(folder)
    before = load_scene(folder, manifest, max_side=32).test[0].truth
    matrix = np.eye(4)
    rotation = Rotation.from_euler("xyz", [20, -30, 50], degrees=True).as_matrix()
    matrix[:3, :3], matrix[:3, 3] = 3.0 * rotation, [1.0, 2.0, 3.0]
    move(manifest, matrix)
    after = load_scene(folder, manifest, max_side=32).test[0].truth
    np.testing.assert_allclose(after["distance"], 3.0 * before["distance"], rtol=1e-5)
    np.testing.assert_allclose(after["normal"][..., :3], before["normal"][..., :3] @ rotation.T, atol=1e-5)
    np.testing.assert_array_equal(after["albedo"], before["albedo"])


def test_secondary_rays_of_a_fitted_box_are_the_paper_s_for_an_object_of_its_size():
    manifest = scene_pb2.SceneManifest()
    set_fitted_box(manifest, np.array([-1.5, -1.0, -1.0]), np.array([1.5, 1.0, 1.0]))
    assert (manifest.secondary_rays.near, manifest.secondary_rays.far) == pytest.approx((0.05, 2.0))


@pytest.mark.parametrize("layout", [NerfstudioFolder, BlenderFolder, TensoirFolder, ColmapBinaryFolder])
def test_map_coordinates_are_moved_to_the_origin_before_anything_is_measured(tmp_path, layout):
    near = describe_scene(layout(tmp_path / "near").folder)
    utm = np.array([432_100.0, 5_412_345.0, 310.0])
    far = describe_scene(layout(tmp_path / "far", offset=utm).folder)
    assert not [each.message for each in inspect_files(tmp_path / "far").report.findings]
    np.testing.assert_allclose(far.bounds.minimum, -np.array(far.bounds.maximum), atol=1e-6)
    ours, theirs = world_matrix(far), world_matrix(near)
    np.testing.assert_allclose(
        (positions(far) - ours[:3, 3]) @ np.linalg.inv(ours[:3, :3]).T - utm,
        (positions(near) - theirs[:3, 3]) @ np.linalg.inv(theirs[:3, :3]).T,
        atol=1e-2 if layout is TensoirFolder else 1e-6,  # it writes nine digits
    )


def test_a_camera_far_away_from_all_others_is_named(tmp_path):
    capture = NerfstudioFolder(tmp_path)
    pose = capture.poses[3].copy()
    pose[:3, 3] += 3e6
    capture.set_pose(3, pose)
    report = inspect_files(capture.folder).report
    assert [each.code for each in report.findings] == ["scene.camera_not_finite"]
    assert "frame_00003" in report.findings[0].message

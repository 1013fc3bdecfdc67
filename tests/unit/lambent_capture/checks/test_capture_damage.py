"""One thing is damaged in the still life: exactly that finding appears, none on the capture itself."""

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lambent_capture.checks.examine import measure
from lambent_capture.checks.exposure_estimate import even_out_exposure
from lambent_capture.checks.findings import note_findings
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.observe import Observation, observe
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.problems import Problems
from lambent_proto.v1 import scene_pb2
from numpy import ndarray
from PIL import Image

pytestmark = pytest.mark.slow

SAMPLE = Path(__file__).parents[3] / "data" / "still_life"
LIMITS = CaptureLimits()
VIEW = 7


@pytest.fixture(scope="module")
def sample() -> tuple[list[Observation], scene_pb2.SceneManifest]:
    manifest = collect_scene(SAMPLE, None, Problems())
    return observe(SAMPLE, manifest, LIMITS), manifest


def findings(observations: list[Observation], manifest: scene_pb2.SceneManifest) -> list[tuple[str, str]]:
    problems = Problems()
    note_findings(measure(observations, manifest, LIMITS), LIMITS, problems)
    return [(each.code, each.subject) for each in problems.findings()]


def with_view(sample, change: Callable[[Observation], Observation]):
    """Return codes and subjects after one view was changed, and the view's name."""
    observations, manifest = sample
    changed = [change(each) if index == VIEW else each for index, each in enumerate(observations)]
    return findings(changed, manifest), observations[VIEW].frame.name


def moved(seen: Observation, pose: ndarray) -> Observation:
    return replace(seen, camera=replace(seen.camera, camera_to_world=pose))


def turned(seen: Observation, degrees: float) -> Observation:
    """Return the view with its camera turned about its own up axis."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pose = seen.camera.camera_to_world.copy()
    pose[:3, :3] = pose[:3, :3] @ turn
    return moved(seen, pose)


def with_mask(seen: Observation, paint: Callable[[ndarray], None]) -> Observation:
    coverage = seen.coverage.copy()
    paint(coverage)
    return replace(seen, coverage=coverage)


def relit(seen: Observation, ev: float) -> Observation:
    pictures = tuple(replace(each, luminance=each.luminance * np.float32(2.0**ev)) for each in seen.pictures)
    return replace(seen, pictures=pictures)


def extent(coverage: ndarray) -> tuple[ndarray, ndarray]:
    return np.nonzero(coverage > 0.5)


def test_the_sample_capture_has_no_finding(sample):
    assert findings(*sample) == []


@pytest.mark.parametrize("degrees", [4.0, 10.0, 30.0])
def test_a_camera_that_looks_elsewhere_is_a_pose_that_does_not_fit(sample, degrees):
    found, name = with_view(sample, lambda seen: turned(seen, degrees))
    assert found == [("scene.pose_inconsistent", name)]


def test_the_pose_of_another_view_is_found_by_what_the_points_look_like(sample):
    # The plate's silhouette is almost that of its neighbour: only the texture tells.
    pose = sample[0][VIEW + 1].camera.camera_to_world
    found, name = with_view(sample, lambda seen: moved(seen, pose))
    assert found == [("scene.pose_inconsistent", name)]


def leak(coverage: ndarray) -> None:
    coverage[3:18, 3:18] = 1.0


def clinging_leak(coverage: ndarray) -> None:
    rows, columns = extent(coverage)
    coverage[rows.max() - 6 : rows.max() + 12, columns.max() - 24 : columns.max()] = 1.0


def lost_part(coverage: ndarray) -> None:
    coverage[:, : int(np.percentile(extent(coverage)[1], 15))] = 0.0


def hole(coverage: ndarray) -> None:
    row, column = (int(each.mean()) for each in extent(coverage))
    coverage[row - 8 : row + 8, column - 8 : column + 8] = 0.0


def islands(coverage: ndarray) -> None:
    free = np.argwhere(coverage < 0.1)
    for row, column in free[:: len(free) // 8]:
        coverage[row, column] = 1.0


@pytest.mark.parametrize(
    ("paint", "code"),
    [
        (leak, "scene.mask_leak"),
        (clinging_leak, "scene.mask_leak"),
        (lost_part, "scene.mask_incomplete"),
        (hole, "scene.mask_incomplete"),
        (islands, "scene.mask_specks"),
    ],
)
def test_damage_to_a_mask_is_named_by_its_kind(sample, paint, code):
    found, name = with_view(sample, lambda seen: with_mask(seen, paint))
    assert found == [(code, name)]


@pytest.mark.parametrize("ev", [-0.6, 0.6])
def test_a_picture_with_another_exposure_is_named(sample, ev):
    found, _ = with_view(sample, lambda seen: relit(seen, ev))
    assert found == [("scene.exposure_drift", sample[0][VIEW].pictures[0].path)]


def test_an_exposure_that_the_frame_states_is_no_drift(sample):
    observations, manifest = sample
    stated = [relit(each, 0.6) if index == VIEW else each for index, each in enumerate(observations)]
    stated[VIEW] = relit(stated[VIEW], -0.6)
    assert findings(stated, manifest) == []


def test_an_exposure_that_creeps_up_is_one_finding(sample):
    observations, manifest = sample
    steps = np.linspace(0.0, 1.2, len(observations))
    crept = [relit(each, ev) for each, ev in zip(observations, steps, strict=True)]
    assert findings(crept, manifest) == [("scene.exposure_drift", "")]


@pytest.mark.parametrize("layout", ["nerf_blender", "tensoir_synthetic"])
def test_exposures_that_photographs_do_not_state_are_found_from_what_they_show(sample, layout):
    observations, manifest = sample
    own = scene_pb2.SceneManifest()
    own.CopyFrom(manifest)
    own.layout = layout
    changes = 0.5 * np.random.default_rng(0).standard_normal(len(observations))
    figures = measure([relit(s, ev) for s, ev in zip(observations, changes, strict=True)], own, LIMITS)
    even_out_exposure(own, figures, Problems())
    rest = changes + np.log2([frame.exposure for frame in own.frames])
    assert rest.std() == pytest.approx(changes.std() if layout == "tensoir_synthetic" else 0.05, abs=0.03)


def test_exposures_that_are_one_stay_one(sample):
    observations, manifest = sample
    own = scene_pb2.SceneManifest()
    own.CopyFrom(manifest)
    own.layout = "nerf_blender"
    even_out_exposure(own, measure(observations, own, LIMITS), Problems())
    assert {frame.exposure for frame in own.frames} == {1.0}


def test_poses_that_are_all_a_little_wrong_are_one_finding(sample):
    observations, manifest = sample
    angles = 3.0 * np.cos(1.0 + 17.0 * np.arange(len(observations)))
    shaken = [turned(each, angle) for each, angle in zip(observations, angles, strict=True)]
    assert ("scene.pose_inconsistent", "") in findings(shaken, manifest)


def test_cameras_with_the_axes_of_another_program_have_no_common_object(sample):
    observations, manifest = sample
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    flipped = [moved(each, each.camera.camera_to_world @ flip) for each in observations]
    assert findings(flipped, manifest) == [("scene.poses_inconsistent", "")]


def test_views_from_one_half_only_leave_a_gap(sample):
    observations, manifest = sample
    half = [each for each in observations if each.camera.position[0] > 0.0]
    assert findings(half, manifest) == [("scene.views_gap", "")]


def test_few_views_are_said_to_be_few_and_nothing_else_is_made_of_them(sample):
    observations, manifest = sample
    codes = {code for code, _ in findings(observations[::4], manifest)}
    assert codes == {"scene.views_few", "scene.views_gap"}


def test_an_object_that_sticks_out_of_the_stated_box_is_named(sample):
    observations, manifest = sample
    small = copy.deepcopy(manifest)
    del small.bounds.minimum[:], small.bounds.maximum[:]
    small.bounds.minimum.extend([-0.9, -0.9, -0.9])
    small.bounds.maximum.extend([0.9, 0.9, 0.9])
    assert findings(observations, small) == [("scene.object_outside_box", "")]


def seen_again(sample, tmp_path: Path, change: Callable[[ndarray], ndarray]) -> list[tuple[str, str]]:
    """Return the findings after the picture file of one view was changed."""
    observations, manifest = sample
    path = observations[VIEW].pictures[0].path
    (tmp_path / path).parent.mkdir(parents=True)
    Image.fromarray(change(np.array(Image.open(SAMPLE / path)))).save(tmp_path / path)
    only = copy.deepcopy(manifest)
    del only.frames[:]
    only.frames.append(observations[VIEW].frame)
    changed = [*observations]
    (changed[VIEW],) = observe(tmp_path, only, LIMITS)
    return findings(changed, manifest)


def test_a_blurred_picture_is_named(sample, tmp_path):
    def blur(pixels: ndarray) -> ndarray:
        from scipy.ndimage import gaussian_filter

        blurred = gaussian_filter(pixels[..., :3].astype(np.float32), (1.5, 1.5, 0.0))
        return np.concatenate([blurred.astype(np.uint8), pixels[..., 3:]], axis=-1)

    found = seen_again(sample, tmp_path, blur)
    assert found == [("scene.image_blurred", sample[0][VIEW].pictures[0].path)]


def test_a_picture_whose_lights_are_clipped_is_named(sample, tmp_path):
    def clip(pixels: ndarray) -> ndarray:
        brightest = pixels[..., :3].max(axis=-1)
        limit = np.percentile(brightest[pixels[..., 3] > 250], 90)
        pixels[brightest >= limit, :3] = 255
        return pixels

    found = seen_again(sample, tmp_path, clip)
    assert found == [("scene.image_clipped", sample[0][VIEW].pictures[0].path)]


def test_an_object_that_is_cut_off_by_the_frame_is_named(sample):
    observations, manifest = sample
    cropped = [cut(each) if index == VIEW else each for index, each in enumerate(observations)]
    assert findings(cropped, manifest) == [("scene.mask_border", observations[VIEW].frame.name)]


def cut(seen: Observation) -> Observation:
    """Return the view as a picture that ends in the middle of the object."""
    end = int(extent(seen.coverage)[1].mean())
    camera = replace(seen.camera, width=end)
    pictures = tuple(replace(each, luminance=each.luminance[:, :end].copy()) for each in seen.pictures)
    return replace(seen, camera=camera, coverage=seen.coverage[:, :end].copy(), pictures=pictures)

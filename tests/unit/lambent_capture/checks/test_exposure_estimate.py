"""Exposures are changed where the pictures clearly show that they are wrong, and nowhere else."""

import numpy as np
import pytest
from lambent_capture.checks.exposure_estimate import adopt_exposures, believed_share, even_out_exposure
from lambent_capture.problems import Problems
from lambent_proto.v1 import capture_pb2, scene_pb2

VIEWS = 40
NOISE = 0.1 * np.random.default_rng(1).standard_normal(VIEWS)
DRIFT = 0.6 * np.sin(np.arange(VIEWS))


def capture(offsets, stated=None, *, lights=("day",), layout="colmap", mismatch=0.3, has_hull=True):
    """Return manifest and figures of views that are stored brighter than others by `offsets` [EV]."""
    stated = np.ones(len(offsets)) if stated is None else stated
    left = offsets + np.log2(stated)
    left = left - np.median(left)
    manifest = scene_pb2.SceneManifest(lights=lights, layout=layout)
    figures = capture_pb2.CaptureFigures(has_hull=has_hull)
    for index, (factor, offset) in enumerate(zip(stated, left, strict=True)):
        manifest.frames.add(name=f"v{index}", exposure=factor)
        picture = capture_pb2.PictureFigures(light="day", exposure_ev=offset)
        figures.views.add(name=f"v{index}", mismatch_ev=mismatch, pictures=[picture])
    return manifest, figures


def evened(manifest, figures):
    problems = Problems()
    even_out_exposure(manifest, figures, problems)
    return np.log2([frame.exposure for frame in manifest.frames]), [f.code for f in problems.findings()]


def test_offsets_of_silent_photographs_are_undone_relative_to_the_first():
    factors, codes = evened(*capture(DRIFT + NOISE))
    assert codes == ["scene.exposure_estimated"]
    assert factors[0] == 0.0
    rest = DRIFT + factors
    assert rest.std() < 0.15 < DRIFT.std()


def test_offsets_that_may_be_noise_change_nothing():
    factors, codes = evened(*capture(NOISE))
    assert codes == []
    np.testing.assert_array_equal(factors, 0.0)


def test_an_object_that_looks_different_from_everywhere_raises_the_noise():
    assert evened(*capture(DRIFT + NOISE, mismatch=1.5))[1] == []


def test_stated_exposures_that_are_right_stay_as_they_are():
    factors, codes = evened(*capture(DRIFT + NOISE, stated=np.exp2(-DRIFT)))
    assert codes == []
    np.testing.assert_allclose(factors, -DRIFT, atol=1e-6)


def test_stated_exposures_that_the_pictures_contradict_are_dropped():
    factors, codes = evened(*capture(NOISE, stated=np.exp2(DRIFT)))
    assert codes == ["scene.exposure_contradicted"]
    np.testing.assert_array_equal(factors, 0.0)


def test_what_stated_exposures_leave_is_undone_too():
    more = 0.5 * np.cos(2.0 * np.arange(VIEWS))
    factors, codes = evened(*capture(DRIFT + more + NOISE, stated=np.exp2(-DRIFT)))
    assert codes == ["scene.exposure_estimated"]
    assert (DRIFT + more + factors).std() < 0.15


@pytest.mark.parametrize(
    "given", [{"lights": ("day", "night")}, {"layout": "tensoir_synthetic"}, {"has_hull": False}]
)
def test_captures_about_which_offsets_say_nothing_are_left_alone(given):
    factors, codes = evened(*capture(DRIFT, **given))
    assert codes == []
    np.testing.assert_array_equal(factors, 0.0)


def test_the_share_that_is_believed_grows_with_the_offsets():
    shares = [believed_share(scale * DRIFT, 0.2) for scale in (0.0, 0.1, 1.0, 10.0)]
    assert shares[:2] == [0.0, 0.0]
    assert shares[2] == pytest.approx(1.0 - 0.04 / DRIFT.var())
    assert shares[3] > 0.99


def test_an_evaluation_takes_the_exposures_of_the_run_for_the_run_s_own_frames_only():
    trained, _ = capture(DRIFT, stated=np.exp2(DRIFT))
    for index, frame in enumerate(trained.frames):
        frame.camera.camera_to_world.extend(np.eye(4).ravel() + index)
    own, other = scene_pb2.SceneManifest(), scene_pb2.SceneManifest()
    for manifest, moved in ((own, 0.0), (other, 0.5)):
        for frame in trained.frames[:3]:
            copy = manifest.frames.add(name=frame.name, exposure=1.0)
            copy.camera.camera_to_world.extend(np.array(frame.camera.camera_to_world) + moved)
        adopt_exposures(manifest.frames, trained.frames)
    assert [frame.exposure for frame in own.frames] == [frame.exposure for frame in trained.frames[:3]]
    assert [frame.exposure for frame in other.frames] == [1.0] * 3

"""Scores of photographs alone: a capture that is known exactly, and errors of known size."""

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_core.directions import pixel_directions
from lambent_core.exr import write_exr
from lambent_relight import Camera, Renderer, environment_from_array, load_bundle, look_at
from lambent_relight.environment.maps import write_environment
from PIL import Image, ImageOps
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere, Surface
from tabletop.phone import Exposure, write_photograph

from benchmarks.photographs import camera_scores, mask_scores, relight_scores, solved_cameras
from benchmarks.pose_errors import Similarity, pose_errors, similarity
from benchmarks.tabletop_truth import pose, true_cameras, write_known

STEMS = [f"IMG_{k + 1:04d}" for k in range(8)]
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
TO_TRUTH = Similarity(scale=2.5, rotation=TURN, shift=np.array([1.0, -2.0, 0.5]))


def poses_around(count: int, far: float, phase: float) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(count) / count + phase
    high = 0.5 + 0.4 * np.sin(3.0 * angle)
    return np.array(
        [
            look_at([far * np.cos(a), far * np.sin(a), h * far], [0.0, 0.0, 0.0])
            for a, h in zip(angle, high, strict=True)
        ]
    )


FOUND = poses_around(len(STEMS), 3.0, 0.2)
"""Cameras in the world of whoever found them."""


def write_capture(folder: Path, size: tuple[int, int] = (24, 18), orientation: int = 1) -> Path:
    """Write photographs (grey), masks (a box) and cameras: those found, in the truth's world."""
    for sub in ("photographs", "truth/masks"):
        (folder / sub).mkdir(parents=True)
    cameras = {}
    for k, (stem, matrix) in enumerate(zip(STEMS, TO_TRUTH.poses(FOUND), strict=True)):
        picture = np.full((size[1], size[0], 3), 60 + 10 * k, np.uint8)
        picture[:4, :4] = 250
        exposure = Exposure(factor=1.0 + 0.1 * k)
        write_photograph(folder / "photographs" / f"{stem}.jpg", picture, exposure, orientation, k)
        mask = np.zeros((size[1], size[0]), np.uint8)
        mask[4:14, 6:16] = 255
        Image.fromarray(mask).save(folder / "truth" / "masks" / f"{stem}.png")
        cameras[f"{stem}.jpg"] = {
            "width": size[0],
            "height": size[1],
            "focal": 20.0,
            "centre": [size[0] / 2, size[1] / 2],
            "k1": 0.0,
            "k2": 0.0,
            "orientation": orientation,
            "camera_to_world": matrix.tolist(),
            "exposure_factor": exposure.factor,
            "iso": exposure.iso,
            "exposure_s": exposure.seconds,
        }
    (folder / "truth" / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    return folder


def test_a_similarity_is_found_and_undone():
    points = np.random.default_rng(0).normal(size=(9, 3))
    found = similarity(points, TO_TRUTH.scale * points @ TURN.T + TO_TRUTH.shift)
    assert found.scale == pytest.approx(2.5)
    np.testing.assert_allclose(found.rotation, TURN, atol=1e-12)
    np.testing.assert_allclose(found.inverse().poses(found.poses(FOUND)), FOUND, atol=1e-12)


def test_cameras_are_scored_by_what_is_missing_and_what_is_wrong(tmp_path):
    capture = write_capture(tmp_path / "carpet")
    found = dict(zip(STEMS, FOUND.copy(), strict=True))
    del found["IMG_0003"]
    scores = camera_scores(found, capture, "photographs")
    assert (scores["photographs"], scores["registered"], scores["registered_share"]) == (8, 7, 0.875)
    assert scores["rotation_deg_max"] < 1e-4
    assert scores["centre_share_max"] < 1e-9
    cos, sin = np.cos(np.radians(2.0)), np.sin(np.radians(2.0))
    found["IMG_0005"] = found["IMG_0005"].copy()
    found["IMG_0005"][:3, :3] @= np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    scores = camera_scores(found, capture, "photographs")
    assert scores["rotation_deg_max"] == pytest.approx(2.0, abs=1e-6)
    assert scores["rotation_deg_median"] < 1e-4


def test_fewer_than_three_cameras_have_no_errors(tmp_path):
    capture = write_capture(tmp_path / "carpet")
    scores = camera_scores({"IMG_0001": FOUND[0], "other": FOUND[1]}, capture, "photographs")
    assert scores == {"photographs": 8, "registered": 1, "registered_share": 0.125}


def test_masks_are_scored_by_name_and_at_the_size_of_the_truth(tmp_path):
    capture = write_capture(tmp_path / "carpet")
    masks = tmp_path / "masks"
    masks.mkdir()
    mask = np.zeros((18, 24), np.uint8)
    mask[4:14, 8:18] = 255  # two of ten columns aside
    Image.fromarray(mask).save(masks / "IMG_0001.jpg.png")
    true = Image.open(capture / "truth" / "masks" / "IMG_0002.png")
    true.resize((48, 36), Image.Resampling.NEAREST).save(masks / "IMG_0002.png")
    scores = mask_scores(masks, capture)
    assert scores["iou"] == {"IMG_0001": pytest.approx(8 / 12, abs=1e-4), "IMG_0002": 1.0}
    assert (scores["iou_worst_view"], scores["masks"]) == ("IMG_0001", 2)
    with pytest.raises(SystemExit, match="no picture"):
        mask_scores(capture / "photographs" / "none", capture)


@pytest.mark.parametrize("orientation", [1, 6])
def test_the_known_capture_is_read_with_the_true_cameras(tmp_path, orientation):
    size = (24, 18) if orientation == 1 else (18, 24)
    capture = write_capture(tmp_path / "carpet", size, orientation)
    write_known(capture, "photographs", tmp_path / "known")
    found = solved_cameras(tmp_path / "known", capture / "photographs")
    true = [pose(true_cameras(capture)[stem]) for stem in STEMS]
    rotation, centre = pose_errors(np.array([found[stem] for stem in STEMS]), np.array(true))
    assert rotation.max() < 1e-3
    assert centre.max() < 1e-6
    manifest = describe_scene(tmp_path / "known")
    assert [(frame.camera.width, frame.camera.height) for frame in manifest.frames] == [size] * 8
    assert all((tmp_path / "known" / frame.mask).is_file() for frame in manifest.frames)
    picture = next((tmp_path / "known" / "images").glob("IMG_0001.*"))
    with Image.open(picture) as image:
        upright = np.asarray(ImageOps.exif_transpose(image).convert("L"), float)
    assert upright[:4, :4].mean() > 200 > upright[-4:, -4:].mean()


def sky(directions: np.ndarray) -> np.ndarray:
    """Return a light without symmetry, in the truth's world: a soft lamp on each of three sides."""
    sides = np.array([[0.8, 0.0, 0.6], [-0.5, 0.7, 0.5], [0.0, -0.6, -0.8]])
    return 0.05 + 3.0 * np.exp(8.0 * (directions @ sides.T - 1.0))


@pytest.fixture(scope="module")
def relit(tmp_path_factory):
    """Return a capture and a run with the bundle of two balls whose albedo is twice the true one."""
    folder = tmp_path_factory.mktemp("relit")
    capture = write_capture(folder / "carpet")
    colours = [(0.8, 0.3, 0.2), (0.2, 0.5, 0.8)]
    balls = [
        Sphere((x, 0.1, 0.2), 0.45, Surface(albedo=colour))
        for x, colour in zip((-0.5, 0.5), colours, strict=True)
    ]
    cameras = [Camera.centred(stem, 24, 18, 20.0, matrix) for stem, matrix in zip(STEMS, FOUND, strict=True)]
    run = folder / "run"
    bundle = load_bundle(write_analytic_bundle(run / "bundle", AnalyticScene(tuple(balls)), cameras))
    write_manifest(run, dict(zip(STEMS, FOUND, strict=True)))
    truth = capture / "truth"
    (truth / "scene.json").write_text(json.dumps({"test_envs": ["lamps"]}))
    (truth / "envmaps").mkdir()
    write_environment(truth / "envmaps" / "lamps.exr", sky(pixel_directions(64, 128)).astype(np.float32))
    mine = environment_from_array(sky(pixel_directions(64, 128) @ TURN.T))
    renderer = Renderer(bundle)
    for k, matrix in enumerate(poses_around(2, 3.2, 0.9)):
        view = truth / f"test_{k:03d}"
        view.mkdir()
        camera = Camera.centred(view.name, 48, 36, 40.0, matrix)
        picture = renderer.render(camera, mine, spp=128, albedo_ratio=np.full(3, 0.5))
        rgba = np.concatenate([picture.rgb, picture.opacity], axis=-1)
        write_exr(view / "rgba_lamps.exr", {name: rgba[..., i] for i, name in enumerate("RGBA")})
        albedo = np.concatenate([np.clip(picture.albedo, 0, 1), picture.opacity], axis=-1)
        Image.fromarray(np.round(255 * albedo).astype(np.uint8)).save(view / "albedo.png")
        there = TO_TRUTH.poses(matrix[None])[0]
        pose = ",".join(f"{value:.9g}" for value in there.ravel())
        angle = 2.0 * np.arctan(0.5 * 48 / 40.0)
        lens = {"imw": 48, "imh": 36, "cam_angle_x": angle, "cam_transform_mat": pose}
        (view / "metadata.json").write_text(json.dumps(lens))
    return capture, run


def write_manifest(run: Path, cameras: dict[str, np.ndarray]) -> None:
    """Write what a run knows of its frames' cameras."""
    (run / "scene").mkdir(parents=True, exist_ok=True)
    frames = [
        {"name": stem, "camera": {"camera_to_world": matrix.ravel().tolist()}}
        for stem, matrix in cameras.items()
    ]
    (run / "scene" / "manifest.json").write_text(json.dumps({"frames": frames}))


def settings(out: Path) -> argparse.Namespace:
    return argparse.Namespace(out=out, shrink=2, views=4, samples=64, seed=1)


def test_a_perfect_bundle_in_another_world_is_relit_like_the_truth(relit, tmp_path):
    capture, run = relit
    scores = relight_scores(run, capture, settings(tmp_path))
    np.testing.assert_allclose(scores["albedo_ratio"], 0.5, rtol=0.03)
    assert scores["relit_db"] == scores["relit_lamps_db"] > 32.0
    assert len(list(tmp_path.glob("carpet_*_test_*_lamps.png"))) == 2


def test_cameras_that_are_mixed_up_cost_decibels(relit, tmp_path):
    capture, run = relit
    true = relight_scores(run, capture, settings(tmp_path))["relit_db"]
    mixed = tmp_path / "run"
    shutil.copytree(run, mixed)
    # The same bundle, of which two photographs have each other's cameras.
    write_manifest(mixed, dict(zip(STEMS, FOUND[[1, 0, 2, 3, 4, 5, 6, 7]], strict=True)))
    assert relight_scores(mixed, capture, settings(tmp_path))["relit_db"] < true - 3.0
    write_manifest(mixed, dict(zip(STEMS, FOUND[[7, 6, 5, 4, 3, 2, 0, 1]], strict=True)))
    with pytest.raises(SystemExit, match="no pixel in common"):
        relight_scores(mixed, capture, settings(tmp_path))


def test_the_fitted_world_of_estimated_masks_is_the_bundles(relit, tmp_path):
    capture, run = relit
    fitted = tmp_path / "run"
    shutil.copytree(run, fitted)
    true = relight_scores(run, capture, settings(tmp_path))["relit_db"]
    shutil.move(fitted / "scene", fitted / "estimated_masks")
    write_manifest(fitted, dict(zip(STEMS, TO_TRUTH.poses(FOUND), strict=True)))
    assert relight_scores(fitted, capture, settings(tmp_path))["relit_db"] == true

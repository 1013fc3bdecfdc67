"""Samples written by other code load in every layout, and their cameras see what the original ones saw."""

import json
import shutil

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.lights import select_lights
from lambent_capture.loading.load import camera_of, load_scene
from lambent_capture.scenes.world import world_matrix
from lambent_core.scene import Camera
from lambent_proto.v1 import scene_pb2
from PIL import Image
from scipy.ndimage import maximum_filter
from support.captures import REFERENCES

LAYOUTS = REFERENCES / "layouts"
ORIGINAL = json.loads((LAYOUTS / "original_cameras.json").read_text())
SAMPLES = {
    "blender": ("nerf_blender", "cowcrate", 18, 6),
    "nerfstudio": ("nerfstudio", "cowcrate", 18, 6),
    "colmap": ("colmap", "cowcrate", 21, 3),
    "colmap text": ("colmap", "cowcrate", 21, 3),
    "openillumination": ("openillumination", "cowcrate", 18, 6),
    "glossy": ("glossy_synthetic", "goldbowl", 15, 5),
}
FLIPS = [np.diag(signs) for signs in ([1.0, -1.0, -1.0, 1.0], [-1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0])]


@pytest.fixture(params=SAMPLES)
def sample(request, tmp_path):
    if request.param != "colmap text":
        return request.param, LAYOUTS / request.param
    shutil.copytree(LAYOUTS / "colmap", tmp_path / "scene", ignore=shutil.ignore_patterns("sparse"))
    (tmp_path / "scene" / "sparse_text").rename(tmp_path / "scene" / "sparse")
    return request.param, tmp_path / "scene"


def original_name(kind, frame):
    """Return the view of the original scene that a converter made `frame` from."""
    if kind == "glossy":
        return f"test_{int(frame.name):03d}"
    if kind == "blender":
        split, _, number = frame.name.partition("_r_")
        return f"{split}_{3 * int(number):03d}"
    if kind == "openillumination":
        train = [f"{x}{y}{n}" for x in "AB" for y, n in OI_ORDER]
        test = [f"C{y}{n}" for y, n in OI_ORDER[:6]]
        if frame.name in train:
            return f"train_{3 * train.index(frame.name):03d}"
        return f"test_{3 * test.index(frame.name):03d}"
    return frame.name


OI_ORDER = [("A", 1), ("B", 2), ("C", 3), ("A", 4), ("B", 5), ("C", 6), ("A", 7), ("B", 8), ("C", 9)]


def original_camera(scene, name):
    """Return the camera of a view as the renderer's own files describe it."""
    facts = ORIGINAL[scene][name]
    focal = 0.5 * facts["imw"] / np.tan(0.5 * facts["cam_angle_x"])
    return Camera(
        width=facts["imw"],
        height=facts["imh"],
        focal_x=focal,
        focal_y=focal,
        centre_x=0.5 * facts["imw"],
        centre_y=0.5 * facts["imh"],
        camera_to_world=np.array([float(v) for v in facts["cam_transform_mat"].split(",")]).reshape(4, 4),
    )


def project(camera, points, axes=None):
    """Return columns and rows of world points in a picture."""
    pose = camera.camera_to_world @ (np.eye(4) if axes is None else axes)
    seen = (points - pose[:3, 3]) @ pose[:3, :3]
    column = camera.centre_x + camera.focal_x * seen[:, 0] / -seen[:, 2]
    row = camera.centre_y - camera.focal_y * seen[:, 1] / -seen[:, 2]
    return np.stack([column, row], axis=-1)


def moved(points, manifest):
    """Return points of the capture's own coordinates in those of the manifest."""
    matrix = world_matrix(manifest)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def surface_points(kind):
    """Return points on the object, in the original coordinates, from depth that no reader uses."""
    if kind == "glossy":
        depth = (
            np.asarray(Image.open(LAYOUTS / "glossy/GlossySynthetic/goldbowl/0-depth.png")) / 65535.0 * 15.0
        )
        camera, along = original_camera("goldbowl", "test_000"), None
        depth = np.where(depth < 14.5, depth, 0.0)
    else:
        import OpenEXR

        folder = REFERENCES / "scenes" / "tensoir_synthetic" / "test_000"
        with OpenEXR.File(str(folder / "distance.exr")) as file:
            depth = next(iter(file.channels().values())).pixels
        depth = depth.astype(np.float64).reshape(*depth.shape[:2], -1)[..., 0]
        camera, along = original_camera("cowcrate", "test_000"), 1.0
    rows, columns = np.nonzero(depth)
    local = np.stack(
        [
            (columns + 0.5 - camera.centre_x) / camera.focal_x,
            -(rows + 0.5 - camera.centre_y) / camera.focal_y,
            -np.ones(len(rows)),
        ],
        axis=-1,
    )
    if along is not None:  # a distance along the ray, not a depth
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
    points = depth[rows, columns, None] * local
    return points @ camera.camera_to_world[:3, :3].T + camera.position


def share_inside(camera, mask, points, axes=None):
    column, row = np.floor(project(camera, points, axes)).astype(int).T
    inside = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
    hit = np.zeros(len(points), dtype=bool)
    hit[inside] = mask[row[inside], column[inside]]
    return hit.mean()


def test_a_sample_is_recognised_and_sound(sample):
    kind, folder = sample
    report = inspect_files(folder).report
    layout, _, trained, tested = SAMPLES[kind]
    assert [f"{f.code}: {f.message}" for f in report.findings] == []
    assert (report.layout, report.num_train_frames, report.num_test_frames) == (layout, trained, tested)


def test_cameras_agree_with_the_original_ones_to_a_ten_thousandth_of_a_pixel(sample):
    kind, folder = sample
    manifest = describe_scene(folder)
    points = np.random.default_rng(0).uniform(-1.35, 1.35, (200, 3))
    for frame in manifest.frames:
        ours = project(camera_of(frame), moved(points, manifest))
        theirs = project(original_camera(SAMPLES[kind][1], original_name(kind, frame)), points)
        np.testing.assert_allclose(ours, theirs, atol=1e-4, rtol=0.0)


def test_the_surface_falls_into_every_silhouette_and_with_any_axis_flipped_it_does_not(sample):
    kind, folder = sample
    manifest = select_lights(describe_scene(folder))
    scene = load_scene(folder, manifest, max_side=128)
    points = moved(surface_points(kind), manifest)
    light = manifest.lights[0]
    views = [*scene.train, *scene.test]
    # Mask files leave out pixels that are covered by less than half.
    masks = [maximum_filter(view.images[light][..., 3] > 0.0, 3) for view in views]
    shares = [share_inside(view.camera, mask, points) for view, mask in zip(views, masks, strict=True)]
    assert min(shares) > 0.98
    for axes in FLIPS:
        flipped = [share_inside(v.camera, mask, points, axes) for v, mask in zip(views, masks, strict=True)]
        assert min(flipped) < 0.98


def test_the_box_holds_the_surface_and_is_tighter_than_what_the_cameras_alone_suggest(sample):
    kind, folder = sample
    manifest = describe_scene(folder)
    points = moved(surface_points(kind), manifest)
    low, high = np.array(manifest.bounds.minimum), np.array(manifest.bounds.maximum)
    assert manifest.bounds_from == "silhouettes"
    assert (points > low).all()
    assert (points < high).all()
    assert (high - low).max() < 3.5  # 4 without masks
    assert manifest.contraction_radius == pytest.approx(np.abs([low, high]).max())


def test_photographs_have_the_masks_of_the_layout(sample):
    manifest = select_lights(describe_scene(sample[1]))
    scene = load_scene(sample[1], manifest, max_side=64)
    for view in (*scene.train, *scene.test):
        picture = view.images[manifest.lights[0]]
        assert picture.shape == (64, 64, 4)
        assert 0.05 < (picture[..., 3] > 0.5).mean() < 0.7
        assert np.isfinite(picture).all()


def test_openillumination_trains_with_the_stand_and_is_measured_without():
    manifest = describe_scene(LAYOUTS / "openillumination")
    kinds = {frame.split: frame.mask.split("/")[-2] for frame in manifest.frames}
    assert kinds == {scene_pb2.SPLIT_TRAIN: "com_masks", scene_pb2.SPLIT_TEST: "obj_masks"}


def test_openillumination_trains_under_one_light_and_is_relit_to_the_others():
    manifest = describe_scene(LAYOUTS / "openillumination")
    assert list(manifest.lights) == ["013", "011", "009"]
    single = select_lights(manifest)
    assert (list(single.lights), list(single.relight_lights)) == (["013"], ["011", "009"])
    tested = next(frame for frame in single.frames if frame.split == scene_pb2.SPLIT_TEST)
    assert [image.light for image in tested.images] == ["013", "011", "009"]
    several = select_lights(manifest, ("013", "011", "009"))
    assert list(several.relight_lights) == []

"""Pictures in memory are linear, straight-alpha, and reduced by area."""

import numpy as np
import pytest
from flashcache.evaluation.metrics import over_white
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading import radiance
from lambent_capture.loading.load import load_scene
from lambent_capture.pictures.colour_space import ColourSpace
from lambent_capture.pictures.upright import turned_pose
from lambent_core.errors import WorkerError
from lambent_proto.v1 import scene_pb2
from PIL import Image
from support.captures import REFERENCES, look_at, save, write_blender, write_tensoir

SCENE = REFERENCES / "scenes" / "tensoir_synthetic"


def load(folder, max_side=1000, **options):
    return load_scene(folder, describe_scene(folder), max_side=max_side, **options)


def test_a_half_transparent_pixel_over_white_is_blended_in_linear_light(tmp_path):
    folder = write_blender(tmp_path)
    pixels = np.zeros((12, 12, 4), dtype=np.uint8)
    pixels[..., 0], pixels[..., 3] = 188, 128  # sRGB 188 is half of full radiance
    save(folder / "train" / "r_0.png", pixels)
    picture = load(folder).train[0].images["capture"]
    alpha = 128 / 255
    expected = [0.5029 * alpha + 1 - alpha, 1 - alpha, 1 - alpha]
    np.testing.assert_allclose(over_white(picture)[0, 0], expected, atol=1e-3)


def test_alpha_is_not_decoded_like_a_colour(tmp_path):
    folder = write_blender(tmp_path)
    pixels = np.full((12, 12, 4), 128, dtype=np.uint8)
    save(folder / "train" / "r_0.png", pixels)
    assert load(folder).train[0].images["capture"][0, 0, 3] == pytest.approx(128 / 255)


def with_first_frame(folder, **fields):
    manifest = describe_scene(folder)
    for name, value in fields.items():
        setattr(manifest.frames[0], name, value)
    return load_scene(folder, manifest, max_side=1000).train[0].images["capture"]


@pytest.mark.parametrize("kind", ["grey", "rgb", "alpha"])
def test_the_level_of_a_mask_file_is_the_alpha_of_an_opaque_photograph(tmp_path, kind):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.full((12, 12, 3), 200, dtype=np.uint8))
    level = np.arange(144, dtype=np.uint8).reshape(12, 12)
    files = {
        "grey": level,
        "rgb": np.stack([level] * 3, -1),
        "alpha": np.stack([level * 0 + 9] * 3 + [level], -1),
    }
    save(folder / "m.png", files[kind])
    np.testing.assert_allclose(with_first_frame(folder, mask="m.png")[..., 3], level / 255.0, atol=1e-6)


def test_a_photograph_that_was_cut_out_already_keeps_the_edges_of_its_mask(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.full((12, 12, 4), 128, dtype=np.uint8))
    save(folder / "m.png", np.full((12, 12), 128, dtype=np.uint8))
    assert with_first_frame(folder, mask="m.png")[0, 0, 3] == pytest.approx(128 / 255)


def test_a_mask_of_another_size_than_the_photograph_is_refused(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "m.png", np.full((12, 11), 128, dtype=np.uint8))
    with pytest.raises(WorkerError, match=r"scene\.mask_size: m\.png has 11 x 12 pixels"):
        with_first_frame(folder, mask="m.png")


def test_exposure_scales_linear_light_and_leaves_alpha_alone(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.full((12, 12, 4), 188, dtype=np.uint8))
    picture = with_first_frame(folder, exposure=2.0)
    np.testing.assert_allclose(picture[0, 0], [1.0058, 1.0058, 1.0058, 188 / 255], atol=2e-3)
    np.testing.assert_array_equal(
        with_first_frame(folder, exposure=0.0), with_first_frame(folder, exposure=1.0)
    )


def test_a_picture_without_alpha_is_opaque_everywhere(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.full((12, 12, 3), 255, dtype=np.uint8))
    np.testing.assert_array_equal(load(folder).train[0].images["capture"], np.ones((12, 12, 4)))


def test_a_grey_picture_gets_three_equal_channels(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.full((12, 12), 188, dtype=np.uint8))
    picture = load(folder).train[0].images["capture"]
    np.testing.assert_allclose(picture[0, 0], [0.5029, 0.5029, 0.5029, 1.0], atol=1e-3)


def test_reducing_ignores_the_colour_of_transparent_pixels(tmp_path):
    folder = write_blender(tmp_path)
    pixels = np.zeros((12, 12, 4), dtype=np.uint8)
    pixels[::2] = [255, 0, 0, 255]
    pixels[1::2] = [0, 255, 0, 0]
    save(folder / "train" / "r_0.png", pixels)
    picture = load(folder, max_side=6).train[0].images["capture"]
    np.testing.assert_allclose(picture[2, 3], [1.0, 0.0, 0.0, 0.5], atol=1e-6)


def test_reducing_keeps_the_mean_of_premultiplied_radiance():
    large = load(SCENE).test[0].images["venice_sunset_000"]
    small = load(SCENE, max_side=50).test[0].images["venice_sunset_000"]
    assert small.shape == (50, 50, 4)
    for picture in (large, small):
        picture[..., :3] *= picture[..., 3:]
    np.testing.assert_allclose(small.mean(axis=(0, 1)), large.mean(axis=(0, 1)), rtol=1e-4)


def test_reducing_keeps_the_direction_of_every_pixel_corner():
    camera = load(SCENE, max_side=50).test[0].camera
    full = load(SCENE).test[0].camera
    assert camera.width / camera.focal_x == pytest.approx(full.width / full.focal_x)
    assert camera.centre_x / camera.width == pytest.approx(0.5)


def test_normals_are_unit_vectors_on_the_object_and_zero_beside_it():
    truth = load(SCENE).test[0].truth["normal"]
    length = np.linalg.norm(truth[..., :3], axis=-1)
    np.testing.assert_allclose(length[truth[..., 3] > 0], 1.0, atol=1e-5)
    np.testing.assert_array_equal(length[truth[..., 3] == 0], 0.0)


def test_truth_has_the_documented_channels_and_training_views_have_none():
    scene = load(SCENE)
    channels = {kind: values.shape[-1] for kind, values in scene.test[0].truth.items()}
    assert channels == {"albedo": 4, "normal": 4, "roughness": 1, "metallic": 1, "distance": 1}
    assert all(not view.truth for view in scene.train)
    assert set(scene.test[0].images) == {"venice_sunset_000", "venice_sunset_120", "studio_small_05"}


def test_reduced_metalness_of_a_dielectric_edge_stays_zero():
    truth = load(SCENE, max_side=40).test[0].truth
    assert truth["metallic"].max() == 0.0
    assert 0.0 < truth["roughness"].max() <= 1.0


def test_points_seen_by_one_camera_fall_into_the_silhouette_of_another():
    # Turns red for any flip of an axis, of rows, or of the pose.
    first, second = load(SCENE).test
    camera = first.camera
    rows, columns = np.nonzero(first.truth["distance"][..., 0])
    inside = first.images["venice_sunset_000"][rows, columns, 3] == 1.0
    rows, columns = rows[inside], columns[inside]
    local = np.stack(
        [
            (columns + 0.5 - camera.centre_x) / camera.focal_x,
            -(rows + 0.5 - camera.centre_y) / camera.focal_y,
            -np.ones(len(rows)),
        ],
        axis=-1,
    )
    directions = local @ camera.camera_to_world[:3, :3].T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    points = camera.position + first.truth["distance"][rows, columns] * directions
    seen = (points - second.camera.position) @ second.camera.camera_to_world[:3, :3]
    column = second.camera.centre_x + second.camera.focal_x * seen[:, 0] / -seen[:, 2]
    row = second.camera.centre_y - second.camera.focal_y * seen[:, 1] / -seen[:, 2]
    alpha = second.images["venice_sunset_000"][..., 3]
    hit = alpha[np.floor(row).astype(int), np.floor(column).astype(int)] > 0.0
    assert hit.mean() > 0.98


def test_a_file_that_disappears_is_named(tmp_path):
    folder = write_blender(tmp_path)
    manifest = describe_scene(folder)
    (folder / "train" / "r_1.png").unlink()
    with pytest.raises(WorkerError, match=r"scene\.file_missing: train/r_1\.png"):
        load_scene(folder, manifest, max_side=64)
    with pytest.raises(WorkerError, match=r"scene\.file_missing: train/r_1\.png"):
        load_scene(folder, manifest, max_side=64, store=tmp_path / "store")


def test_lights_can_be_chosen_when_loading():
    scene = load(SCENE, lights=("venice_sunset_120",))
    assert scene.lights == ("venice_sunset_120",)
    assert all(set(view.images) == {"venice_sunset_120"} for view in scene.train)


@pytest.mark.parametrize(("layout", "turns"), [("photographs", 1), ("nerf-synthetic", 0)])
def test_only_photographs_whose_cameras_were_found_here_are_turned_upright(tmp_path, layout, turns):
    folder = write_blender(tmp_path)
    pixels = np.zeros((12, 12, 4), dtype=np.uint8)
    pixels[2, 9] = 255
    save(folder / "train" / "r_0.png", pixels)
    manifest = describe_scene(folder)
    manifest.layout = layout
    pose = turned_pose(look_at(np.array([3.0, 1.0, 1.2]), np.zeros(3)), -1)
    manifest.frames[0].camera.camera_to_world[:] = pose.ravel()
    view = load_scene(folder, manifest, max_side=1000).train[0]
    np.testing.assert_array_equal(view.images["capture"][..., 3] > 0.0, np.rot90(pixels[..., 3] > 0, turns))
    np.testing.assert_allclose(view.camera.camera_to_world, turned_pose(pose, turns))


def blender_with_object(tmp_path, columns=slice(40, 60), rows=slice(30, 50), side=120):
    """Write a capture in which the object covers a small part of every photograph; each pixel is its own."""
    folder = write_blender(tmp_path)
    pixels = np.zeros((side, side, 4), dtype=np.uint8)
    pixels[..., 0], pixels[..., 1] = np.arange(side), np.arange(side)[:, None]
    pixels[rows, columns, 3] = 255
    for path in folder.rglob("*.png"):
        save(path, pixels)
    return folder


def test_the_size_counts_pixels_of_the_object_and_not_of_the_frame(tmp_path):
    folder = blender_with_object(tmp_path, slice(20, 100), slice(30, 90))
    frame, crop = load(folder, max_side=44).train[0], load(folder, max_side=44, crop="object").train[0]
    assert frame.images["capture"].shape == (44, 44, 4)
    assert crop.images["capture"].shape[:2] == (crop.camera.height, crop.camera.width) == (34, 44)
    assert crop.images["capture"][..., 3].sum() > 1.5 * frame.images["capture"][..., 3].sum()
    assert crop.camera.focal_x > 1.2 * frame.camera.focal_x


def test_a_small_object_is_cut_out_and_not_enlarged(tmp_path):
    folder = blender_with_object(tmp_path)
    whole, crop = load(folder).train[0], load(folder, max_side=64, crop="object").train[0]
    margins = crop.margins
    assert crop.images["capture"].shape == (22, 22, 4)
    assert (margins.left, margins.top, margins.right, margins.bottom) == (39, 29, 59, 69)
    np.testing.assert_array_equal(crop.images["capture"], whole.images["capture"][29:51, 39:61])
    assert crop.camera.centre_x == pytest.approx(whole.camera.centre_x - 39)
    assert crop.camera.focal_x == pytest.approx(whole.camera.focal_x)


def test_photographs_of_several_sizes_each_keep_their_object(tmp_path):
    folder = blender_with_object(tmp_path, slice(20, 100), slice(30, 90))
    small = np.zeros((60, 60, 4), dtype=np.uint8)
    small[10:40, 5:45] = 255
    save(folder / "train" / "r_1.png", small)
    manifest = describe_scene(folder)
    manifest.frames[1].camera.width = manifest.frames[1].camera.height = 60
    scene = load_scene(folder, manifest, max_side=30, crop="object")
    assert {view.camera.width for view in scene.train} == {30}
    for view in scene.train:
        assert view.images["capture"].shape[:2] == (view.camera.height, view.camera.width)
        assert view.images["capture"][..., 3].max() == 1.0


def test_test_views_are_cut_out_unless_benchmarks_are_measured_on_them(tmp_path):
    real = load(blender_with_object(tmp_path / "real"), crop="object")
    assert real.test[0].camera.width == 22
    synthetic = write_tensoir(tmp_path / "synthetic")
    for path in synthetic.rglob("*.png"):
        pixels = np.zeros((12, 12, 4), dtype=np.uint8)
        pixels[5:7, 5:7] = 255
        save(path, pixels)
    truth = load(synthetic, crop="object").test[0]
    assert (truth.camera.width, truth.margins.left) == (12, 0)


def test_a_frame_with_truth_keeps_its_whole_picture_in_any_layout(tmp_path):
    folder = blender_with_object(tmp_path)
    manifest = describe_scene(folder)
    frame = next(frame for frame in manifest.frames if frame.split == scene_pb2.SPLIT_TEST)
    frame.truth["albedo"] = frame.images[0].path
    scene = load_scene(folder, manifest, max_side=1000, crop="object")
    assert [view.camera.width for view in scene.test] == [120, 22]


def test_only_the_crop_of_a_photograph_becomes_float(tmp_path, monkeypatch):
    folder = blender_with_object(tmp_path)
    made = []

    def spy(space, levels):
        assert levels.dtype == np.uint8
        made.append(levels.shape)
        return convert(space, levels)

    convert = ColourSpace.linear
    monkeypatch.setattr(ColourSpace, "linear", spy)
    load(folder, max_side=64, crop="object")
    assert set(made) == {(22, 22, 3)}


def test_channels_at_the_end_of_the_scale_are_flagged_where_the_object_is(tmp_path):
    folder = write_blender(tmp_path)
    pixels = np.zeros((12, 12, 4), dtype=np.uint8)
    pixels[:, :6, 3] = 255
    pixels[2, 3, :3] = [251, 252, 255]
    pixels[2, 9, :3] = 255  # transparent
    save(folder / "train" / "r_0.png", pixels)
    view = load(folder).train[0]
    expected = np.zeros((12, 12, 3), dtype=bool)
    expected[2, 3, 1:] = True
    np.testing.assert_array_equal(view.clipped["capture"], expected)
    assert view.clipped["capture"].dtype == bool


def test_photographs_that_are_not_clipped_have_no_flags(tmp_path):
    folder = write_blender(tmp_path)
    save(folder / "train" / "r_0.png", np.full((12, 12, 3), 251, dtype=np.uint8))
    assert not load(folder).train[0].clipped


def test_a_reduced_pixel_is_clipped_if_more_than_a_speck_of_what_covers_it_was(tmp_path):
    folder = write_blender(tmp_path)
    pixels = np.zeros((120, 120, 3), dtype=np.uint8)
    pixels[:10, :10] = 100
    pixels[:5, 10:20] = 255
    pixels[15, 15] = 255  # one of a hundred
    pixels[20, :] = 255
    save(folder / "train" / "r_0.png", pixels)
    flags = load(folder, max_side=12).train[0].clipped["capture"]
    assert flags[0, :3, 0].tolist() == [False, True, False]
    assert not flags[1].any()
    assert flags[2].all()


def test_pictures_of_floats_have_no_end_of_the_scale(tmp_path):
    truth = REFERENCES / "scenes" / "tensoir_synthetic"
    exr = next(truth.rglob("*.exr"))
    manifest = describe_scene(write_blender(tmp_path))
    frame = manifest.frames[0]
    frame.images[0].path, frame.images[0].encoding = str(exr.resolve()), "linear"
    rgba, flags = radiance.linear_photograph(tmp_path, frame, frame.images[0], (0, 0, 4, 4), None)
    assert rgba.shape == (4, 4, 4)
    assert flags is None


def test_a_photograph_that_was_much_reduced_is_decoded_once_until_it_changes(tmp_path, monkeypatch):
    folder, store, decoded = blender_with_object(tmp_path / "capture"), tmp_path / "store", []
    pixels = np.asarray(Image.open(folder / "train" / "r_0.png")).copy()
    pixels[35, 45, :3] = 255
    save(folder / "train" / "r_0.png", pixels)
    right = radiance.read_picture
    monkeypatch.setattr(radiance, "read_picture", lambda *given: decoded.append(given) or right(*given))
    manifest = describe_scene(folder)

    def load_kept(max_side=20, crop="object"):
        decoded.clear()
        return load_scene(folder, manifest, max_side=max_side, crop=crop, store=store).train[0]

    first, again = load_kept(), None
    assert len(decoded) == 7
    again = load_kept()
    assert decoded == []
    np.testing.assert_array_equal(again.images["capture"], first.images["capture"])
    np.testing.assert_array_equal(again.clipped["capture"], first.clipped["capture"])
    assert (again.margins, again.camera.centre_x) == (first.margins, first.camera.centre_x)
    for changed in ({"max_side": 18}, {"crop": "frame"}):
        load_kept(**changed)
        assert len(decoded) == 7
    manifest.frames[0].exposure = 2.0
    brighter = load_kept()
    assert len(decoded) == 1
    np.testing.assert_allclose(brighter.images["capture"][..., 0], 2.0 * first.images["capture"][..., 0])
    pixels[..., 2] = 90
    save(folder / "train" / "r_0.png", pixels)
    load_kept()
    assert len(decoded) == 1
    for path in store.iterdir():
        path.write_bytes(b"damaged")
    load_kept()
    assert len(decoded) == 7


def test_pictures_that_are_decoded_quickly_are_not_kept(tmp_path):
    folder = blender_with_object(tmp_path / "capture")
    load_scene(folder, describe_scene(folder), max_side=64, crop="frame", store=tmp_path / "store")
    assert not (tmp_path / "store").exists()

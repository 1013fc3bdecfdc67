"""Wrong arguments end in our errors, arrays are taken where they make sense, every `repr` is one line."""

import lambent_relight
import numpy as np
import pytest
from lambent_core.pictures import RenderSettings
from lambent_relight import (
    BundleError,
    Camera,
    CameraError,
    EnvironmentFileError,
    MaterialEdit,
    RelightError,
    Renderer,
    SettingError,
    cameras_from_arrays,
    cameras_json,
    environment_from_array,
    load_bundle,
    load_cameras,
    load_environment,
    look_at,
    render,
    turntable,
    write_environment,
    write_picture_exr,
    write_png,
)
from lambent_relight.arguments import array, number, whole
from lambent_relight.settings import Changes
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere

SKY = np.full((4, 8, 3), 0.5, np.float32)
FIELDS = {
    "name": "a",
    "width": 8,
    "height": 6,
    "focal_x": 9.0,
    "focal_y": 9.0,
    "centre_x": 4.0,
    "centre_y": 3.0,
}


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arguments") / "ball.relight"
    return load_bundle(write_analytic_bundle(folder, AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)])))


@pytest.fixture(scope="module")
def renderer(bundle):
    return Renderer(bundle, reader="onnx")


@pytest.fixture(scope="module")
def view():
    return turntable(1, radius=4.0, width=12, height=10)[0]


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda: load_bundle(None), BundleError),
        (lambda: load_environment(7), EnvironmentFileError),
        (lambda: load_environment(b"sky.exr"), EnvironmentFileError),
        (lambda: load_cameras(["a.json"]), CameraError),
        (lambda: environment_from_array("sky"), EnvironmentFileError),
        (lambda: environment_from_array(np.ones((4, 8))), EnvironmentFileError),
        (lambda: environment_from_array(SKY).rotated("90"), EnvironmentFileError),
        (lambda: lambent_relight.Environment([[1.0]]), EnvironmentFileError),
        (lambda: write_environment("sky.exr", np.ones((4, 8))), EnvironmentFileError),
        (lambda: write_environment("sky.exr", environment_from_array(SKY).rotated(9)), EnvironmentFileError),
        (lambda: Renderer("ball.relight"), SettingError),
        (lambda: look_at((0, 0), (0, 0, 1)), CameraError),
        (lambda: look_at((0, 0, 1), (0, 0, 1)), CameraError),
        (lambda: turntable(2.5, radius=1.0), CameraError),
        (lambda: turntable(True, radius=1.0), CameraError),
        (lambda: turntable(2, radius="far"), CameraError),
        (lambda: turntable(2, radius=1.0, width=0), CameraError),
        (lambda: turntable(2, radius=1.0, target=(0.0, np.nan, 0.0)), CameraError),
        (lambda: Camera(**FIELDS, camera_to_world=np.eye(3)), CameraError),
        (lambda: Camera(**FIELDS, camera_to_world=2.0 * np.eye(4)), CameraError),
        (lambda: Camera(**FIELDS | {"width": 8.5}, camera_to_world=np.eye(4)), CameraError),
        (lambda: Camera(**FIELDS | {"focal_x": 0.0}, camera_to_world=np.eye(4)), CameraError),
        (lambda: cameras_from_arrays(np.eye(4), width=8, height=8, focal=9.0), CameraError),
        (lambda: cameras_from_arrays(np.eye(4)[None], width=8, height=8, focal=9.0, names="ab"), CameraError),
        (lambda: cameras_json(["camera"]), CameraError),
        (lambda: write_png("a.png", SKY), SettingError),
        (lambda: write_picture_exr("a.exr", SKY), SettingError),
        (lambda: MaterialEdit(albedo_gain="red"), SettingError),
        (lambda: MaterialEdit(albedo_gain=np.ones(4)), SettingError),
        (lambda: MaterialEdit(roughness_scale="rough"), SettingError),
        (lambda: MaterialEdit(albedo=(0.5, 2.0, 0.5)), SettingError),
    ],
)
def test_a_wrong_argument_is_an_error_of_ours_that_names_it(call, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(kind) as raised:
        call()
    assert raised.value.code.partition(".")[0] in ("bundle", "camera", "environment", "relight")
    assert raised.value.message
    assert raised.value.advice
    assert not list(tmp_path.iterdir())


def test_every_setting_may_be_given_by_name():
    assert set(Changes.__annotations__) - {"albedo_ratio", "soft_edges"} == set(RenderSettings.model_fields)


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": "first"},
        {"environment": None},
        {"environment": SKY[0]},
        {"settings": {"spp": 8}},
        {"rotate_deg": "90"},
        {"rotate_deg": np.inf},
        {"object_rotate_deg": (1, 2)},
        {"edit": {"roughness_scale": 0.5}},
        {"albedo_ratio": (1.0, 2.0)},
        {"albedo_ratio": -1.0},
        {"albedo_ratio": [[1.0], [1.0, 2.0]]},
        {"background": "beige"},
        {"background": (1.0, 1.0)},
        {"background": 7},
        {"progress": 0.5},
        {"spp": "many"},
    ],
)
def test_rendering_refuses_a_wrong_argument_before_it_looks(renderer, view, changes, monkeypatch):
    given = {"camera": view, "environment": SKY, "spp": 2} | changes
    if "background" not in changes:
        monkeypatch.setattr(renderer, "view", lambda *args: pytest.fail("rays were traced"))
    with pytest.raises(RelightError):
        renderer.render(**given)


@pytest.mark.parametrize(
    "wrong", [{"num_threads": 0}, {"num_threads": 1.5}, {"reader": "fast"}, {"kept_rays": -1}]
)
def test_a_renderer_refuses_wrong_settings(bundle, wrong):
    with pytest.raises(SettingError):
        Renderer(bundle, **wrong)


def test_an_array_and_a_path_are_the_environment_that_they_hold(renderer, view, tmp_path):
    path = tmp_path / "sky.exr"
    write_environment(path, SKY, half=False)
    settings = RenderSettings(spp=2, antialias=1)
    pictures = [
        renderer.render(view, light, settings).rgb
        for light in (environment_from_array(SKY), SKY, SKY.astype(np.float64), path, str(path))
    ]
    assert pictures[0].max() > 0.0
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture, pictures[0])


def test_an_environment_object_is_written_like_its_array(tmp_path):
    write_environment(tmp_path / "a.exr", environment_from_array(SKY))
    np.testing.assert_array_equal(load_environment(tmp_path / "a.exr").radiance, SKY)


def test_poses_of_another_program_become_the_cameras_they_are():
    made = turntable(3, radius=2.0, width=20, height=10)
    poses = np.stack([camera.camera_to_world for camera in made])
    for given in (poses, poses[:, :3], poses.tolist()):
        cameras = cameras_from_arrays(given, width=20, height=10, focal=made[0].focal_x)
        assert [camera.key() for camera in cameras] == [camera.key() for camera in made]
    named = cameras_from_arrays(poses, width=20, height=10, focal=9.0, names=["a", "b", "c"])
    assert [camera.name for camera in named] == ["a", "b", "c"]


def test_a_camera_takes_lists_and_keeps_an_array_of_its_own():
    pose = np.eye(4)
    camera = Camera(**FIELDS, camera_to_world=pose)
    pose[0, 3] = 9.0
    assert camera.camera_to_world[0, 3] == 0.0
    assert Camera(**FIELDS, camera_to_world=np.eye(4).tolist()).key() == camera.key()


def test_colours_of_an_edit_may_be_arrays_or_one_number():
    assert MaterialEdit(albedo_gain=np.array([1, 2, 3])) == MaterialEdit(albedo_gain=(1.0, 2.0, 3.0))
    assert MaterialEdit(albedo_gain=0.5).albedo_gain == (0.5, 0.5, 0.5)
    assert MaterialEdit(albedo=np.float32(0.25)).albedo == (0.25, 0.25, 0.25)


def test_every_public_object_shows_itself_in_one_short_line(bundle, renderer, view):
    picture = render(bundle, view, SKY, spp=2, antialias=1)
    objects = (bundle, renderer, view, picture, environment_from_array(SKY).rotated(30), MaterialEdit())
    for each in objects:
        text = repr(each)
        assert type(each).__name__ in text
        assert "\n" not in text
        assert len(text) < 300
    assert "12 x 10" in repr(view)
    assert "rotated by 30 degrees" in repr(objects[4])
    assert "ball.relight" in repr(renderer)
    assert "12 x 10" in repr(picture)


def test_numbers_and_arrays_are_checked_for_kind_range_and_shape():
    assert number(np.float32(0.5), "x") == 0.5
    assert whole(np.int64(3), "n", 0) == 3
    assert array([1, 2, 3], (None,), "a").dtype == np.float64
    for call in (
        lambda: number(True, "x"),
        lambda: number(np.nan, "x"),
        lambda: number([[1.0], [1.0, 2.0]], "x"),
        lambda: number(1.0, "x", above=1.0),
        lambda: number(1.0, "x", below=1.0),
        lambda: number(10**400, "x"),
        lambda: whole(3.0, "n", 0),
        lambda: whole(5, "n", 0, 4),
        lambda: array([1.0, np.inf], (2,), "a"),
        lambda: array([[1.0], [1.0, 2.0]], (None, None), "a"),
        lambda: array([1.0], (2,), "a"),
    ):
        with pytest.raises(SettingError):
            call()

"""The demo's pictures and its way through the service, on a scene whose truth is exact."""

import json

import numpy as np
import pytest
from lambent import local_server
from lambent.cli import demo_run as demo
from lambent.cli.output import Output
from lambent.contact_sheet import write_contact_sheet
from lambent.demo_pictures import Sample, format_table, make_pictures, read_figures
from lambent.errors import JobNotSucceededError, LambentError
from lambent_relight import environment_from_array, load_bundle, render, turntable, write_environment
from lambent_relight.images import encode_png
from PIL import Image
from support.analytic_bundle import manifest_of, write_analytic_bundle, write_manifest
from support.analytic_scene import AnalyticScene, Sphere, Surface

SCENE = AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0, Surface(albedo=(0.6, 0.3, 0.2)))])
LIGHTS = {"sky": (0.9, 0.9, 0.9), "dusk": (0.9, 0.4, 0.2), "noon": (0.5, 0.7, 1.0)}


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Return (bundle folder, sample) of a ball under three skies; the truth is exact up to noise."""
    root = tmp_path_factory.mktemp("demo")
    bundle = write_analytic_bundle(root / "bundle", SCENE)
    maps = {name: np.full((4, 8, 3), colour, np.float32) for name, colour in LIGHTS.items()}
    # The light of a sky from above only, so that a relit picture is not flat.
    for radiance in maps.values():
        radiance[2:] *= 0.3
    (bundle / "env").mkdir()
    write_environment(bundle / "env" / "trained_sky.exr", maps["sky"])
    write_manifest(bundle, manifest_of(SCENE))
    sample = root / "sample"
    (sample / "envmaps").mkdir(parents=True)
    opened = load_bundle(bundle)
    views = turntable(3, radius=4.0, width=20, height=20)
    for view, folder in zip(views, ("train_000", "test_000", "test_001"), strict=True):
        _write_view(sample / folder, view, opened, maps)
    info = {"scene": "ball", "train_env": "sky", "rotations": ["000"], "test_envs": ["dusk", "noon"]}
    (sample / "scene.json").write_text(json.dumps(info))
    for name in ("dusk", "noon"):
        write_environment(sample / "envmaps" / f"{name}.exr", maps[name])
    return bundle, Sample.open(sample)


def _write_view(folder, view, opened, maps):
    folder.mkdir()
    for name, radiance in maps.items():
        picture = render(opened, view, environment_from_array(radiance), spp=256, seed=1)
        stem = "rgba_sky_000" if name == "sky" else f"rgba_{name}"
        Image.fromarray(encode_png(picture)).save(folder / f"{stem}.png")
    for stem, values in (("albedo", picture.albedo), ("normal", 0.5 + 0.5 * picture.normal)):
        rgba = np.concatenate([values, picture.coverage], axis=-1)
        Image.fromarray(np.round(255 * rgba).astype(np.uint8)).save(folder / f"{stem}.png")
    for stem, values in (("roughness", picture.perceptual_roughness), ("metallic", picture.metalness)):
        Image.fromarray(np.round(255 * values[..., 0]).astype(np.uint8)).save(folder / f"{stem}.png")
    pose = ",".join(map(str, view.camera_to_world.ravel()))
    angle = 2 * np.arctan(0.5 * view.width / view.focal_x)
    metadata = {"imw": 20, "imh": 20, "cam_angle_x": angle, "cam_transform_mat": pose}
    (folder / "metadata.json").write_text(json.dumps(metadata))


@pytest.fixture
def exr_maps(monkeypatch):
    """Read the sample's maps as EXR (the bundled sample has .hdr)."""
    monkeypatch.setattr(Sample, "environment", lambda self, light: self.folder / "envmaps" / f"{light}.exr")


def test_an_exact_bundle_is_far_above_every_floor(world, exr_maps, tmp_path):
    bundle, sample = world
    figures = make_pictures(bundle, sample, tmp_path, lambda text: None)
    by_name = {figure.name: figure for figure in figures}
    assert by_name["reconstruction, PSNR"].value > 35
    assert by_name["albedo (scaled), PSNR"].value > 40
    assert by_name["normals, mean error"].value < 1.0
    assert by_name["roughness, rmse"].value < 0.02
    assert by_name["metalness, rmse"].value < 0.02
    for light in ("dusk", "noon"):
        relit = by_name[f"relit under {light}, PSNR"]
        assert relit.value > 35
        assert relit.value > relit.floor + 10
    assert all((f.value > f.floor) == f.larger_is_better for f in figures if "reconstruction" not in f.name)


def test_pictures_sheet_and_figures_are_written_and_found_again(world, exr_maps, tmp_path):
    bundle, sample = world
    assert read_figures(bundle, tmp_path) is None
    figures = make_pictures(bundle, sample, tmp_path, lambda text: None)
    assert read_figures(bundle, tmp_path) == figures
    for name in ("reconstruction", "relit_dusk", "relit_noon"):
        assert (tmp_path / "test_000" / f"{name}.png").is_file()
        assert (tmp_path / "test_001" / f"{name}.exr").is_file()
    with Image.open(tmp_path / "contact_sheet.png") as sheet:
        assert sheet.width > 10 * 192
    assert "floor" in (tmp_path / "metrics.txt").read_text()
    report = json.loads((tmp_path / "metrics.json").read_text())
    for name in ("bundle_files_sha256", "renderer"):
        (tmp_path / "metrics.json").write_text(json.dumps({**report, name: "another"}))
        assert read_figures(bundle, tmp_path) is None


def test_the_table_has_a_line_for_every_figure(world, exr_maps, tmp_path):
    bundle, sample = world
    table = format_table(make_pictures(bundle, sample, tmp_path, lambda text: None))
    words = ("reconstruction", "albedo", "dusk", "noon", "normals", "roughness", "metalness", " dB", " deg")
    for word in words:
        assert word in table


def test_a_contact_sheet_places_every_tile_in_its_column(tmp_path):
    red, blue = np.zeros((4, 4, 3)), np.zeros((4, 4, 3))
    red[..., 0], blue[..., 2] = 1.0, 1.0
    write_contact_sheet(tmp_path / "s.png", ["a", "b"], [("row", [red, blue])], title="t")
    pixels = np.asarray(Image.open(tmp_path / "s.png").convert("RGB"))
    assert tuple(pixels[150, 14 + 96]) == (255, 0, 0)
    assert tuple(pixels[150, 14 + 192 + 6 + 96]) == (0, 0, 255)


class _FakeClient:
    """Just enough of a client for the demo's choice of a job."""

    def __init__(self, known):
        self.known = known
        self.calls = []

    def jobs(self, **filters):
        self.calls.append(("jobs", filters))
        return iter(self.known)

    def push(self, folder, **options):
        self.calls.append(("push", options["name"]))
        return demo.Job(id="scene_1", state="uploaded")

    def submit(self, scene_id, **options):
        self.calls.append(("submit", options))
        return demo.Job(id="job_new", state="queued")

    def retry(self, job_id):
        self.calls.append(("retry", job_id))
        return demo.Job(id="job_again", state="queued")


@pytest.mark.parametrize(
    ("state", "job_id", "last_call"),
    [
        (None, "job_new", "submit"),
        ("succeeded", "job_1", "jobs"),
        ("running", "job_1", "jobs"),
        ("failed", "job_again", "retry"),
        ("cancelled", "job_again", "retry"),
    ],
)
def test_the_same_scene_preset_and_seed_are_the_same_job(world, state, job_id, last_call):
    _, sample = world
    client = _FakeClient([demo.Job(id="job_1", state=state)] if state else [])
    job = demo._find_or_submit(client, sample.folder, "fast", 0, Output(as_json=True))
    assert job.id == job_id
    assert client.calls[-1][0] == last_call
    label = client.calls[0][1]["label"]
    assert label.startswith("lambent.demo=")
    assert label.endswith("-fast-0")
    if state is None:
        assert client.calls[-1][1]["labels"] == dict([label.split("=")])


def test_a_job_that_fails_ends_the_demo_with_its_reason():
    failed = demo.Job.from_json(
        {"id": "j", "state": "failed", "error": {"code": "oom", "message": "no memory"}}
    )

    class Client:
        def watch(self, job_ids):
            return iter([failed])

    with pytest.raises(JobNotSucceededError, match="oom: no memory"):
        demo._follow(Client(), failed, Output(as_json=True))


def test_a_server_that_does_not_start_tells_the_end_of_its_log(tmp_path, monkeypatch):
    monkeypatch.setattr(local_server.sys, "executable", "/bin/false")
    with (
        pytest.raises(LambentError, match=r"demo\.server_failed"),
        local_server.local_server(tmp_path / "data"),
    ):
        pass

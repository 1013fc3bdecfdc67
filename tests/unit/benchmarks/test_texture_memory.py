"""The photographs that `texture_memory` makes up, and the memory that it sees."""

import json
import os
import sys

import numpy as np
import pytest
from PIL import Image

from benchmarks.texture_memory import CONTRAST, enlarged, natural, reach_of, watched, write_run

SIDE = 32


@pytest.fixture
def run(tmp_path):
    """Return a run on a capture of two photographs of a square of 16 pixels in the middle."""
    capture, folder = tmp_path / "capture", tmp_path / "run"
    capture.mkdir()
    (folder / "scene").mkdir(parents=True)
    rgba = np.zeros((SIDE, SIDE, 4), np.uint8)
    rgba[8:24, 8:24] = (120, 80, 40, 255)
    frames = []
    for number in range(2):
        Image.fromarray(rgba).save(capture / f"{number}.png")
        camera = {"width": SIDE, "height": SIDE, "focal_x": 50.0, "focal_y": 60.0}
        camera |= {"centre_x": 15.0, "centre_y": 16.0, "camera_to_world": [1.0] * 16}
        images = [{"light": "day", "path": f"{number}.png"}, {"light": "night", "path": "absent.png"}]
        frame = {"name": f"{number}", "split": "SPLIT_TRAIN", "camera": camera, "images": images}
        frames.append(frame | {"truth": {"albedo": "albedo.png"}, "mask": ""})
    frames.append(frames[0] | {"split": "SPLIT_TEST"})
    manifest = {"lights": ["day"], "frames": frames}
    (folder / "scene" / "manifest.json").write_text(json.dumps(manifest))
    (folder / "run.json").write_text(json.dumps({"scene": str(capture), "config": {"preset": "tiny"}}))
    return folder


def test_detail_has_the_contrast_and_the_spectrum_of_natural_pictures():
    field = natural(256, np.random.default_rng(0))
    assert field.mean() == pytest.approx(1.0, abs=1e-4)
    assert field.std() == pytest.approx(CONTRAST, rel=1e-3)
    power = np.abs(np.fft.rfft2(field)) ** 2
    # Amplitude 1 / f: four times the frequency has a sixteenth of the power.
    assert power[0, 40] / power[0, 10] == pytest.approx(1.0 / 16.0, rel=0.01)


def test_photographs_are_the_captures_enlarged_until_the_object_fills_them(run, tmp_path):
    assert reach_of([tmp_path / "capture" / "0.png"]) == pytest.approx(15.0 / 31.0)
    target = tmp_path / "out" / "run"
    target.parent.mkdir()
    side = write_run(run, target, 5, 0.04, 128)
    assert side == 200
    frames = json.loads((target / "scene" / "manifest.json").read_text())["frames"]
    assert [frame["name"] for frame in frames] == [f"view_{number:03d}" for number in range(5)]
    paths = [frame["images"][0]["path"] for frame in frames]
    assert paths == [f"photograph_00{k}.jpg" for k in (0, 1, 0, 1, 0)]
    with Image.open(tmp_path / "out" / "scene" / frames[0]["mask"]) as mask:
        assert mask.size == (200, 200)
        assert 0.9 < (np.asarray(mask) > 0).mean() < 1.0
    with Image.open(tmp_path / "out" / "scene" / paths[0]) as picture:
        assert picture.format == "JPEG"
        middle = np.asarray(picture)[40:160, 40:160].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [120, 80, 40], rtol=0.15)
    record = json.loads((target / "run.json").read_text())
    assert record["scene"] == str(tmp_path / "out" / "scene")
    assert record["config"]["export"]["transport_size"] == 128
    assert record["config"]["preset"] == "tiny"


def test_cameras_see_what_was_enlarged_where_it_is_now(run, tmp_path):
    target = tmp_path / "out" / "run"
    target.parent.mkdir()
    side = write_run(run, target, 1, 0.04, 128)
    camera = json.loads((target / "scene" / "manifest.json").read_text())["frames"][0]["camera"]
    share = min(1.0, 1.05 * 15.0 / 31.0)
    # A corner of the old square, 8 pixels from the border, by the old and by the new camera.
    for focal, centre, old_focal, old_centre in (
        ("focal_x", "centre_x", 50.0, 15.0),
        ("focal_y", "centre_y", 60.0, 16.0),
    ):
        slope = (8.0 - old_centre) / old_focal
        place = camera[centre] + slope * camera[focal]
        expected = (8.0 - SIDE * (1.0 - share) / 2.0) / (SIDE * share) * side
        assert place == pytest.approx(expected)


def test_the_field_is_repeated_and_a_picture_cut_to_its_middle(run, tmp_path):
    field = np.ones((16, 16), np.float32)
    photograph, mask = enlarged(tmp_path / "capture" / "0.png", 0.5, 64, field)
    assert (np.asarray(mask) == 255).mean() > 0.9
    np.testing.assert_allclose(np.asarray(photograph)[32, 32], [120, 80, 40], atol=1)


def test_memory_is_seen_while_it_is_taken_and_by_what_it_is_for(monkeypatch):
    # Of runs in this process, whose allocator keeps what was freed.
    for name in [name for name in os.environ if name.startswith("MALLOC_")]:
        monkeypatch.delenv(name)
    script = """
import json, time
def tell(doing):
    print(json.dumps({"event": "progress", "doing": doing}), flush=True)
tell("photograph")
data = bytearray(150_000_000)
data[::4096] = b"x" * len(data[::4096])
time.sleep(0.5)
del data
tell("light")
time.sleep(0.3)
"""
    found = watched([sys.executable, "-c", script])
    assert 150e6 < found.peak < 250e6
    assert 150e6 < found.highest["photograph"] <= found.peak
    assert found.highest["light"] < 100e6
    assert 0.4 < found.seconds["photograph"] < 20.0


def test_a_command_that_fails_ends_the_benchmark():
    with pytest.raises(SystemExit, match="ended with 3"):
        watched([sys.executable, "-c", "raise SystemExit(3)"])

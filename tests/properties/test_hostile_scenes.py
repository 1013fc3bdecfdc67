"""However a capture is damaged, checking it ends in a report."""

import json
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.problems import MAX_FINDINGS
from lambent_proto.v1 import scene_pb2
from support.captures import read_transforms, write_blender, write_tensoir, write_transforms

pytestmark = pytest.mark.slow

LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=12)
    | st.sampled_from(["../x", "train/r_0", "NaN", 10**400])
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
)
KEYS = st.sampled_from(
    ["file_path", "transform_matrix", "camera_angle_x", "fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "frames"]
)
QUICK = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


def assert_is_report(report):
    assert len(report.findings) <= MAX_FINDINGS
    errors = [finding for finding in report.findings if finding.severity == scene_pb2.SEVERITY_ERROR]
    assert report.usable == (not errors)
    assert all(finding.code.startswith("scene.") and finding.message for finding in report.findings)


@QUICK
@given(key=KEYS, value=VALUES, frame=st.integers(-1, 2))
def test_any_value_in_transforms_json_ends_in_a_report(key, value, frame):
    with tempfile.TemporaryDirectory() as name:
        folder = write_blender(Path(name), num_train=3, num_test=0)
        transforms = read_transforms(folder)
        (transforms if frame < 0 else transforms["frames"][frame])[key] = value
        write_transforms(folder, "train", transforms)
        assert_is_report(inspect_files(folder).report)


@QUICK
@given(key=st.sampled_from(["imw", "imh", "cam_angle_x", "cam_transform_mat"]), value=VALUES)
def test_any_value_in_metadata_json_ends_in_a_report(key, value):
    with tempfile.TemporaryDirectory() as name:
        folder = write_tensoir(Path(name), num_train=3, num_test=0)
        path = folder / "train_001" / "metadata.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
        assert_is_report(inspect_files(folder).report)


@QUICK
@given(
    key=st.sampled_from(["scene", "train_env", "rotations", "near_far", "bbox"]),
    value=VALUES,
)
def test_any_value_in_scene_json_ends_in_a_report(key, value):
    with tempfile.TemporaryDirectory() as name:
        folder = write_tensoir(Path(name), num_train=3, num_test=0)
        (folder / "scene.json").write_text(json.dumps({"train_env": "sunset", key: value}))
        assert_is_report(inspect_files(folder).report)


@QUICK
@given(
    suffix=st.sampled_from([".png", ".jpg", ".webp", ".exr"]),
    start=st.integers(0, 400),
    damage=st.binary(min_size=0, max_size=40),
    keep=st.floats(0.0, 1.0),
)
def test_any_damage_to_a_picture_ends_in_a_report(suffix, start, damage, keep):
    with tempfile.TemporaryDirectory() as name:
        folder = write_blender(Path(name), num_train=4, num_test=0)
        path = folder / "train" / "r_1.png"
        data = bytearray(path.read_bytes())
        data[start : start + len(damage)] = damage
        path.unlink()
        path.with_suffix(suffix).write_bytes(data[: int(keep * len(data))])
        assert_is_report(inspect_files(folder).report)

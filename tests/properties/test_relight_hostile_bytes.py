"""Readers accept or refuse untrusted files of any content; they never fail in another way."""

import json
import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lambent_core.errors import BundleError, CameraError, EnvironmentFileError
from lambent_relight.bundle.onnx_check import check_onnx
from lambent_relight.cameras import cameras_json, parse_cameras, turntable
from lambent_relight.environment.maps import load_environment, write_environment
from support.analytic_bundle import material_model
from support.analytic_scene import AnalyticScene, Sphere

CAREFUL = settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
EDITS = st.lists(
    st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 8), st.binary(max_size=8)),
    min_size=1,
    max_size=4,
)


def edited(data: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    """Return `data` with stretches replaced by other bytes; each edit is (place, length, replacement)."""
    for place, length, replacement in edits:
        start = int(place * len(data))
        data = data[:start] + replacement + data[start + length :]
    return data


def flat_hdr() -> bytes:
    rows = np.random.default_rng(0).integers(0, 256, (4, 8, 4), np.uint8)
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1\n\n-Y 4 +X 8\n" + rows.tobytes()


def coded_hdr() -> bytes:
    row = struct.pack(">BBH", 2, 2, 8) + b"\x88\x07" + b"\x08abcdefgh" + b"\x84\x01\x04wxyz" + b"\x88\x80"
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n" + 4 * row


@pytest.mark.parametrize("base", [flat_hdr(), coded_hdr()], ids=["flat", "coded"])
@given(edits=EDITS)
@CAREFUL
def test_a_damaged_radiance_file_is_read_or_refused(tmp_path, base, edits):
    path = tmp_path / "sky.hdr"
    path.write_bytes(base)
    load_environment(path)
    path.write_bytes(edited(base, edits))
    with suppress(EnvironmentFileError):
        assert np.isfinite(load_environment(path).radiance).all()


@given(edits=EDITS)
@CAREFUL
def test_a_damaged_exr_file_is_read_or_refused(tmp_path, edits):
    path = tmp_path / "sky.exr"
    write_environment(path, np.random.default_rng(0).random((4, 8, 3)))
    path.write_bytes(edited(path.read_bytes(), edits))
    with suppress(EnvironmentFileError):
        assert np.isfinite(load_environment(path).radiance).all()


GRAPH = material_model(AnalyticScene((Sphere((0.0, 0.0, 0.0), 1.0),))).SerializeToString()


@given(edits=EDITS)
@CAREFUL
def test_a_damaged_graph_is_accepted_or_refused(edits):
    assert check_onnx(GRAPH, path="material.onnx", weights_bytes=0) == []
    with suppress(BundleError):
        assert check_onnx(edited(GRAPH, edits), path="material.onnx", weights_bytes=0) == []


VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
FIELDS = ("name", "width", "height", "focal_x", "focal_y", "centre_x", "centre_y", "camera_to_world")


@given(field=st.sampled_from(FIELDS), value=VALUES)
@CAREFUL
def test_any_value_in_a_camera_is_read_or_refused(field, value):
    cameras = json.loads(cameras_json(turntable(1, radius=2.0)))
    cameras["cameras"][0][field] = value
    with suppress(CameraError):
        (camera,) = parse_cameras(json.dumps(cameras).encode())
        assert camera.width >= 1
        assert np.isfinite(camera.camera_to_world).all()

"""rembg's networks run from a file that the user has; nothing is ever fetched."""

import socket
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import onnx
import pytest
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.rembg import PREFERRED, RembgSegmenter, find_model, segment
from lambent_capture.masks.segmenter import ENTRY_POINTS, find_segmenter
from lambent_core.errors import UsageError, WorkerError
from onnx import TensorProto, helper

SIDE = 320
ROOT = Path(__file__).parents[4]
# Not imported to look: that compiles PyMatting, which takes minutes.
needs_rembg = pytest.mark.skipif(find_spec("rembg") is None, reason="needs the extra rembg")


def write_network(path, red=1.0, bias=-0.5):
    """Write a network of U^2-Net's shape that takes what is red for the object."""
    weights = np.zeros((1, 3, 1, 1), dtype=np.float32)
    weights[0, :, 0, 0] = (red, -red, -red)
    graph = helper.make_graph(
        [
            helper.make_node("Conv", ["picture", "weights", "bias"], ["level"]),
            helper.make_node("Sigmoid", ["level"], ["mask"]),
        ],
        "redness",
        [helper.make_tensor_value_info("picture", TensorProto.FLOAT, [1, 3, SIDE, SIDE])],
        [helper.make_tensor_value_info("mask", TensorProto.FLOAT, [1, 1, SIDE, SIDE])],
        [
            helper.make_tensor("weights", TensorProto.FLOAT, weights.shape, weights.ravel()),
            helper.make_tensor("bias", TensorProto.FLOAT, [1], [bias]),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path


def red_box(left):
    """Return a view with a red box on blue, and where the box is."""
    pixels = np.zeros((120, 160, 3), dtype=np.uint8)
    pixels[..., 2] = 180
    inside = np.zeros((120, 160), dtype=bool)
    inside[30:90, left : left + 50] = True
    pixels[inside] = (230, 10, 10)
    return MaskView(f"view {left}", pixels, None), inside


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """Give rembg an empty folder of models, and no network to fetch any."""
    for name in ("U2NET_HOME", "XDG_DATA_HOME", "OMP_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REMBG_HOME", str(tmp_path / "rembg"))

    def refuse(*_args, **_options):
        raise AssertionError("something wants the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    return tmp_path / "rembg"


@needs_rembg
@pytest.mark.parametrize("option", ["file", "named", ""])
def test_the_users_network_finds_the_object(home, tmp_path, option):
    if option == "file":
        option = str(write_network(tmp_path / "mine.onnx"))
    else:
        write_network(home / "models" / "u2net" / "u2net.onnx")
        option = "u2net" if option == "named" else ""
    views, inside = zip(*(red_box(left) for left in (20, 70)), strict=True)
    coverages = segment.configured(option)(views)
    for coverage, truth in zip(coverages, inside, strict=True):
        assert coverage.shape == truth.shape
        found = coverage > 0.5
        assert (found & truth).sum() / (found | truth).sum() > 0.95
    assert "pymatting" not in sys.modules


@needs_rembg
def test_a_picture_without_the_object_is_an_error_that_says_so(tmp_path):
    network = write_network(tmp_path / "mine.onnx")
    plain = MaskView("plain", np.full((60, 80, 3), 90, dtype=np.uint8), None)
    with pytest.raises(WorkerError) as refused:
        RembgSegmenter(option=str(network))([plain, plain])
    assert refused.value.code == "scene.mask_missing"


def test_without_a_model_the_advice_is_to_fetch_one(home):
    with pytest.raises(UsageError) as refused:
        find_model("")
    assert refused.value.code == "config.segmenter_model"
    assert str(home / "models" / "u2net" / "u2net.onnx") in str(refused.value)
    assert not home.exists()


def test_models_of_earlier_versions_of_rembg_are_found(tmp_path, monkeypatch):
    monkeypatch.setenv("U2NET_HOME", str(tmp_path / "old"))
    path = write_network(tmp_path / "old" / "isnet-general-use.onnx")
    assert find_model("") == ("isnet-general-use", path)


def test_the_best_model_that_is_there_is_chosen(home):
    write_network(home / "models" / "u2netp" / "u2netp.onnx")
    best = write_network(home / "models" / "birefnet-general" / "birefnet-general.onnx")
    assert find_model("") == (PREFERRED[0], best)


@pytest.mark.parametrize("name", ["sam", "u2net_cloth_seg"])
def test_networks_for_something_else_are_refused(name):
    with pytest.raises(UsageError, match="birefnet-general"):
        find_model(name)


@needs_rembg
def test_a_file_that_is_no_network_is_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(UsageError, match="not a network that rembg can run"):
        RembgSegmenter(option=str(tmp_path / "text.onnx"))([red_box(20)[0]])
    with pytest.raises(UsageError, match="there is no such file"):
        find_model(str(tmp_path / "gone.onnx"))


def test_without_the_package_the_advice_is_to_install_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rembg.sessions", None)
    with pytest.raises(UsageError, match=r"pip install 'lambent\[rembg\]'"):
        RembgSegmenter(option=str(write_network(tmp_path / "a.onnx")))([red_box(20)[0]])


def test_the_worker_offers_it_by_name():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["entry-points"][ENTRY_POINTS] == {"rembg": "lambent_capture.masks.rembg:segment"}


class Offered:
    """What an installed package offers."""

    names = ("rembg", "plain")

    def __getitem__(self, name):
        return type("Entry", (), {"load": staticmethod(lambda: segment if name == "rembg" else len)})


def test_an_option_after_the_name_is_given_to_the_segmenter(monkeypatch):
    monkeypatch.setattr("lambent_capture.masks.segmenter.entry_points", lambda group: Offered())
    assert find_segmenter("rembg") is segment
    assert find_segmenter("rembg=/models/C:x.onnx") == RembgSegmenter(option="/models/C:x.onnx")
    with pytest.raises(UsageError, match="takes no option"):
        find_segmenter("plain=more")

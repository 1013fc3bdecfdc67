"""The registry of layouts, and what readers of captures may import."""

import subprocess
import sys
from pathlib import Path

import pytest
from lambent_capture.layouts.readers import reader_of
from lambent_core.layouts import LAYOUTS
from lambent_server.storage.paths import is_picture, is_scene_file

LISTS_MODULES = """
import importlib, pkgutil, sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"torch", "triton", "lambent_relight", "flashcache", "onnxruntime"}:
            raise ImportError(f"{name} is not installed here")

sys.meta_path.insert(0, Refuse())
import lambent_capture

for module in pkgutil.walk_packages(lambent_capture.__path__, "lambent_capture."):
    if module.name != "lambent_capture.masks.rembg":
        importlib.import_module(module.name)
from pathlib import Path
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.load import load_scene

folder = Path(sys.argv[1])
inspected = inspect_files(folder)
assert inspected.report.usable, inspected.report
print(len(load_scene(folder, inspected.manifest, max_side=8).train))
"""


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_of_the_registry_has_a_reader(name: str):
    reader = reader_of(name)
    assert callable(reader.is_layout)
    assert callable(reader.read_capture)
    if LAYOUTS[name].own_files is not None:
        assert callable(reader.own_files)


def test_files_that_only_one_layout_has_are_scene_files_and_no_pictures():
    for path in ("bear/0-camera.pkl", "bear/synthetic_split_128.pkl"):
        assert is_scene_file(path)
        assert not is_picture(path)
    assert not is_scene_file("bear/model.pkl")


def test_captures_are_read_without_torch_and_without_a_renderer():
    folder = Path(__file__).parents[2] / "references" / "layouts" / "nerfstudio"
    ran = subprocess.run([sys.executable, "-c", LISTS_MODULES, folder], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) > 0

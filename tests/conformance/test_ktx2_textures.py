"""KTX 2 textures of a GLB: what basisu wrote is what three.js shows, and what the validator says of it."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from lambent_asset.bundle.glb import write_glb
from lambent_core.colour import linear_from_srgb
from lambent_relight.asset.glb import glb_with_textures
from lambent_relight.asset.ktx2 import KTX2, ktx2_of
from lambent_relight.asset.textured_mesh import png_of, textured_mesh_from_glb
from lambent_relight.baked.mesh import glb_chunks
from lambent_relight.baked.raster import rasterise
from lambent_relight.cameras import turntable
from scipy import ndimage
from support import other_programs
from support.atlas_box import SIZES, atlas_box, coloured
from support.chromium import program
from support.three_page import WEB, three_page

pytestmark = [pytest.mark.browser, pytest.mark.slow]
SURFACE = atlas_box(128)
PLACES = (SURFACE.positions / SIZES + 0.5).astype(np.float32)
CAMERA = turntable(1, radius=6.0, elevation_deg=25.0, width=192, height=160, start_deg=20.0)[0]
_SRGB, _LINEAR = 2, 1


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with the box as it is, and with KTX 2 textures."""
    folder = tmp_path_factory.mktemp("ktx2")
    plain = write_glb(SURFACE, coloured(SURFACE, linear_from_srgb(PLACES)), unit="unknown")
    (folder / "plain.glb").write_bytes(plain)
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("PATH", str(other_programs.basisu().parent), prepend=":")
        packed = glb_with_textures(plain, textured_mesh_from_glb(plain), ktx2=True)
    (folder / "packed.glb").write_bytes(packed)
    return folder


def test_three_js_shows_the_textures_that_basisu_wrote(files: Path, tmp_path: Path):
    if program() is None or not (WEB / "node_modules" / "three").is_dir():
        pytest.skip("needs Chromium and the web tool chain")
    drawn = {}
    with three_page(files, tmp_path) as page:
        for name in ("plain", "packed"):
            assert page.load(f"{name}.glb") == len(SURFACE.faces)
            drawn[name] = {
                kind: page.draw(kind, CAMERA).astype(int) for kind in ("colour", "packed", "normal")
            }
    face = rasterise(SURFACE.vertices, SURFACE.faces, CAMERA).face // 2
    inside = (ndimage.maximum_filter(face, 13) == ndimage.minimum_filter(face, 13)) & (face >= 0)
    assert inside.sum() > 1000
    for kind, picture in drawn["plain"].items():
        error = np.abs(drawn["packed"][kind] - picture)[inside][:, :3]
        assert error.mean() < 1.5, kind
        assert np.percentile(error, 99) < 8, kind


def test_files_state_their_colour_space_and_have_all_smaller_versions(files: Path):
    document, payload = glb_chunks((files / "packed.glb").read_bytes())
    assert document["extensionsRequired"] == [KTX2]
    spaces = []
    for texture in document["textures"]:
        assert "source" not in texture
        image = document["images"][texture["extensions"][KTX2]["source"]]
        assert image["mimeType"] == "image/ktx2"
        view = document["bufferViews"][image["bufferView"]]
        data = payload[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        # KTX 2: width, height at 20, levels at 40, the data format descriptor's place at 48.
        numbers = np.frombuffer(data, "<u4", 17, 12)
        assert (numbers[2], numbers[3], numbers[7]) == (128, 128, 8)
        descriptor = data[int(numbers[9]) :]
        spaces.append(descriptor[4 + 10])
    assert spaces == [_SRGB, _LINEAR, _LINEAR]


def test_the_khronos_validator_only_says_that_it_does_not_know_ktx2(files: Path):
    if shutil.which("node") is None or not (WEB / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("needs node and the web tool chain")
    command = ["node", "scripts/validate_gltf.mjs", str(files / "packed.glb")]
    done = subprocess.run(command, cwd=WEB, capture_output=True, text=True, timeout=60, check=False)
    report = json.loads(done.stdout)
    assert report["issues"]["numErrors"] == 0
    texts = {message["code"]: message["message"] for message in report["issues"]["messages"]}
    # The extension, its type of picture, and what only the extension refers to.
    assert set(texts) == {
        "UNSUPPORTED_EXTENSION",
        "VALUE_NOT_IN_LIST",
        "IMAGE_UNRECOGNIZED_FORMAT",
        "UNUSED_OBJECT",
    }
    assert KTX2 in texts["UNSUPPORTED_EXTENSION"]
    assert "image/ktx2" in texts["VALUE_NOT_IN_LIST"]


def test_colours_survive_within_a_few_steps(monkeypatch):
    monkeypatch.setenv("PATH", str(other_programs.basisu().parent), prepend=":")
    ramp = np.linspace(0.0, 1.0, 64)
    picture = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None], 0.5), axis=-1)
    assert len(ktx2_of(png_of(picture), srgb=True)) < 64 * 64 * 2

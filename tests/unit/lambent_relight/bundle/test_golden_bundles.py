"""Bundles that were exported once, which readers must open and relight as ever.

`tests/golden/bundles` holds them with the pictures they gave when they were put there. They are never written
again (docs/reference/bundle-format.md, Versions).
"""

import hashlib
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from lambent_proto import BUNDLE_VERSION
from lambent_relight import BundleError, Renderer, load_bundle
from support.golden_light import SPP, golden_light

FOLDER = Path(__file__).parents[3] / "golden" / "bundles"
PICTURES = [
    (path.name.removesuffix(".json"), quality)
    for path in sorted(FOLDER.glob("*.json"))
    for quality in json.loads(path.read_text())["rgb"]
]
LARGEST_RMS = {"preview": 2e-3, "baked": 2e-3, "refined": 0.03}
"""Linear radiance, of a light of about 0.7; refined pictures have noise."""


@pytest.mark.parametrize(("name", "quality"), PICTURES)
def test_a_bundle_gives_the_pictures_it_gave(name, quality):
    golden = json.loads((FOLDER / f"{name}.json").read_text())
    bundle = load_bundle(FOLDER / f"{name}.relight.zip")
    assert bundle.manifest.schema_version == golden["schema_version"] == BUNDLE_VERSION
    (camera,) = bundle.cameras()
    renderer = Renderer(bundle, num_threads=1, reader="onnx")
    picture = renderer.render(camera, golden_light(), quality=quality, spp=SPP, antialias=1)
    expected = np.array(golden["rgb"][quality])
    assert 0.05 < expected[picture.opacity[..., 0] > 0.5].mean() < 1.0
    difference = picture.rgb * picture.opacity - expected
    assert np.sqrt(np.mean(difference**2)) < LARGEST_RMS[quality]
    np.testing.assert_allclose(picture.opacity[..., 0], golden["opacity"][quality], atol=1e-3)


def test_a_full_bundle_has_rounded_networks_and_a_lite_one_has_none():
    full, lite = (load_bundle(FOLDER / f"{name}.relight.zip") for name in ("ball", "ball_lite"))
    assert {tensor.dtype for tensor in full.manifest.tensors} == {"float16", "float32"}
    assert any(graph.rounding for graph in full.manifest.graphs)
    assert not lite.has_networks
    assert not lite.manifest.tensors


def copied(name, folder, change):
    """Return a copy of a golden bundle as a folder, after `change(folder)`."""
    with zipfile.ZipFile(FOLDER / f"{name}.relight.zip") as archive:
        archive.extractall(folder)
    change(folder)
    return folder


def cut_short(path):
    def change(folder):
        data = (folder / path).read_bytes()
        (folder / path).write_bytes(data[: len(data) // 2])

    return change


def swapped(first, second):
    def change(folder):
        one, other = (folder / first).read_bytes(), (folder / second).read_bytes()
        (folder / first).write_bytes(other)
        (folder / second).write_bytes(one)

    return change


def one_bit_of_a_texture(folder):
    """Turn one bit in the middle of the normal map, which lies at the end of the mesh file."""
    data = bytearray((folder / "mesh" / "asset.glb").read_bytes())
    data[-200] ^= 1
    (folder / "mesh" / "asset.glb").write_bytes(data)


@pytest.mark.parametrize(
    ("path", "change"),
    [
        ("mesh/asset.glb", cut_short("mesh/asset.glb")),
        ("mesh/asset.glb", one_bit_of_a_texture),
        ("transport/direct_sh7.bin", cut_short("transport/direct_sh7.bin")),
        (
            "transport/direct_sh7.bin",
            swapped("transport/direct_sh7.bin", "transport/visibility_sh4.bin"),
        ),
        ("env/trained_a_night.exr", swapped("env/trained_day.exr", "env/trained_a_night.exr")),
        ("models/weights.bin", cut_short("models/weights.bin")),
    ],
)
def test_a_file_that_is_cut_short_changed_or_swapped_is_named(path, change, tmp_path):
    folder = copied("ball", tmp_path / "spoiled", change)
    message = rf'bundle\.digest_mismatch: "{path}" is not the file the manifest describes; fetch'
    with pytest.raises(BundleError, match=message):
        load_bundle(folder)


def test_an_archive_that_ends_early_is_refused(tmp_path):
    data = (FOLDER / "ball.relight.zip").read_bytes()
    (tmp_path / "half.zip").write_bytes(data[: len(data) // 2])
    with pytest.raises(BundleError, match=r"bundle\.archive_damaged"):
        load_bundle(tmp_path / "half.zip")


def test_textures_of_another_size_than_stated_are_refused(tmp_path):
    def change(folder):
        path = folder / "manifest.json"
        manifest = json.loads(path.read_text())
        manifest["atlas"]["size"], manifest["atlas"]["material_size"] = 4096, 64
        path.write_text(json.dumps(manifest))

    folder = copied("ball", tmp_path / "larger", change)
    (camera,) = load_bundle(folder).cameras()
    with pytest.raises(BundleError, match="4096") as raised:
        Renderer(load_bundle(folder), num_threads=1).render(camera, golden_light(), quality="baked")
    assert raised.value.code == "bundle.mesh_invalid"


DIGESTS = {"ball": "2804771bbf7be707", "ball_lite": "1f82e542d3663823"}


@pytest.mark.parametrize("name", DIGESTS)
def test_no_golden_bundle_was_written_again(name):
    data = (FOLDER / f"{name}.relight.zip").read_bytes()
    assert hashlib.sha256(data).hexdigest()[:16] == DIGESTS[name]

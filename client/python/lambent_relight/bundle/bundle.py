"""A relightable bundle, opened and checked.

Everything is checked before anything is used: paths, links, sizes, SHA-256 of every file, the version,
the conventions, and what the graphs refer to. Source: docs/reference/bundle-format.md.
"""

import math
import re
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from google.protobuf import json_format
from lambent_core.errors import BundleError
from lambent_proto import BUNDLE_VERSION
from lambent_proto.v1.bundle_pb2 import BundleManifest

from lambent_relight.arguments import file_path, refusal
from lambent_relight.bundle.archive import FileSource, check_path, open_source, read_checked, verify
from lambent_relight.bundle.onnx_check import check_onnx
from lambent_relight.bundle.uncertainty import UncertaintyGrid, read_uncertainty
from lambent_relight.cameras import Camera, parse_cameras
from lambent_relight.environment.maps import Environment, load_environment

_MAX_MANIFEST_BYTES = 16 << 20
_MAX_GRAPH_BYTES = 64 << 20
_MAX_WEIGHTS_BYTES = 2 << 30
_MAX_PICTURE_BYTES = 512 << 20
WEIGHTS_PATH = "models/weights.bin"
NETWORKS = ("gbuffer", "material", "fast_cache")
"""Graphs of which a bundle has all or, if it has baked transport, none."""
MAX_ATLAS = 8192
"""Texels along a side of the largest atlas that is written."""
_CONVENTIONS = {
    "up_axis": "z",
    "handedness": "right",
    "environment_convention": "tensoir",
    "radiance": "linear-rec709",
}


@dataclass(frozen=True, eq=False)
class Bundle:
    """A checked bundle. Graph and weight bytes are those that were checked."""

    path: Path
    manifest: BundleManifest
    source: FileSource

    def __repr__(self) -> str:
        """Return folder, version, lights and size in one line."""
        lights = ", ".join(list(self.manifest.train_lights)[:4])
        size = sum(int(file.size_bytes) for file in self.manifest.files) / 1e6
        return (
            f"Bundle({str(self.path)!r}, format {self.manifest.schema_version}, light {lights or 'unknown'}, "
            f"{len(self.manifest.files)} files of {size:.3g} MB)"
        )

    @property
    def has_networks(self) -> bool:
        """Whether the bundle has graphs for rays and points; lite bundles have only baked transport."""
        return any(graph.name in NETWORKS for graph in self.manifest.graphs)

    def graph_path(self, name: str, light: str = "") -> str:
        """Return the path of the graph `name` ("gbuffer", "material", "fast_cache" of a training light)."""
        for graph in self.manifest.graphs:
            if graph.name == name and (not light or graph.light == light):
                return graph.path
        raise BundleError(
            "bundle.graph_missing",
            f'there is no graph "{name}"' + (f' for the light "{light}"' if light else ""),
            f"the bundle has {[graph.path for graph in self.manifest.graphs]}",
        )

    def graph(self, path: str) -> bytes:
        """Return the bytes of an ONNX graph."""
        return read_checked(self.source, path, limit_bytes=_MAX_GRAPH_BYTES)

    def read(self, path: str, limit_bytes: int) -> bytes:
        """Return the bytes of a file that the manifest has to list."""
        if all(file.path != path for file in self.manifest.files):
            raise BundleError("bundle.file_missing", f'"{path[:200]}" is not in files', "export it again")
        return read_checked(self.source, path, limit_bytes=limit_bytes)

    @cached_property
    def weights(self) -> bytes:
        """The bytes of models/weights.bin; empty when the graphs carry their own weights."""
        if not any(file.path == WEIGHTS_PATH for file in self.manifest.files):
            return b""
        return read_checked(self.source, WEIGHTS_PATH, limit_bytes=_MAX_WEIGHTS_BYTES)

    def cameras(self) -> list[Camera]:
        """Return the cameras of cameras.json: those the object was photographed from."""
        for file in self.manifest.files:
            if file.role == "cameras":
                data = read_checked(self.source, file.path, limit_bytes=_MAX_GRAPH_BYTES)
                return parse_cameras(data, source=file.path)
        raise BundleError(
            "bundle.file_missing", "there is no file with the role 'cameras'", "export it again"
        )

    def trained_environment(self, light: str) -> Environment:
        """Return the environment recovered for a training light."""
        data = read_checked(self.source, f"env/trained_{light}.exr", limit_bytes=_MAX_PICTURE_BYTES)
        with tempfile.TemporaryDirectory(prefix="lambent-") as folder:
            copy = Path(folder) / "trained.exr"
            copy.write_bytes(data)
            return load_environment(copy)

    def uncertainty(self) -> UncertaintyGrid | None:
        """Return the uncertainty of the materials, or None if the bundle has none."""
        if not self.manifest.HasField("uncertainty"):
            return None
        stated = self.manifest.uncertainty
        data = self.read(stated.path, _MAX_PICTURE_BYTES)
        box = stated.box
        return read_uncertainty(data, list(box.minimum), list(box.maximum), list(stated.channels))


def load_bundle(path: Path | str) -> Bundle:
    """Return the bundle in the folder or zip archive at `path`.

    Raises BundleError, with a code that starts with `bundle.`, unless every check of
    docs/reference/bundle-format.md holds. Nothing is written to disk and no graph is run.
    """
    path = file_path(path, "path", refuse=refusal("bundle.argument", BundleError))
    source = open_source(path)
    present = source.paths()
    if "manifest.json" not in present:
        raise BundleError(
            "bundle.manifest_missing",
            f'"{path}" has no manifest.json',
            "give the folder that holds it, or a .zip",
        )
    manifest = _parse_manifest(read_checked(source, "manifest.json", limit_bytes=_MAX_MANIFEST_BYTES))
    _check_version(manifest)
    _check_files(manifest, present, source)
    _check_values(manifest)
    bundle = Bundle(path=path, manifest=manifest, source=source)
    _check_graphs(bundle)
    return bundle


def peek_bundle(path: Path | str) -> Bundle:
    """Return the bundle at `path` of which only some files are there, for what its manifest and cameras say.

    The manifest is checked, files and graphs are not: nothing else of the bundle may be used.
    """
    path = file_path(path, "path", refuse=refusal("bundle.argument", BundleError))
    source = open_source(path)
    manifest = _parse_manifest(read_checked(source, "manifest.json", limit_bytes=_MAX_MANIFEST_BYTES))
    _check_version(manifest)
    _check_values(manifest)
    return Bundle(path=path, manifest=manifest, source=source)


def _parse_manifest(data: bytes) -> BundleManifest:
    try:
        # Fields may be added without another version, as long as readers may ignore them.
        return json_format.Parse(data.decode("utf-8"), BundleManifest(), ignore_unknown_fields=True)
    except (json_format.ParseError, UnicodeDecodeError, RecursionError) as error:
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise BundleError(
            "bundle.manifest_unreadable", f"manifest.json cannot be read ({reason})", "fetch the bundle again"
        ) from error


def _check_version(manifest: BundleManifest) -> None:
    if manifest.schema_version != BUNDLE_VERSION:
        raise BundleError(
            "bundle.version_unknown",
            f"the bundle has format version {manifest.schema_version[:32]!r}, "
            f"this release reads version {BUNDLE_VERSION!r} alone",
            "export the bundle again with this release, or open it with the release that wrote it",
        )


def _check_files(manifest: BundleManifest, present: set[str], source: FileSource) -> None:
    stated = [file.path for file in manifest.files]
    for name in stated:
        check_path(name)
    if len(set(stated)) != len(stated):
        raise BundleError("bundle.manifest_invalid", "a file is listed twice", "export the bundle again")
    missing, extra = sorted(set(stated) - present), sorted(present - set(stated) - {"manifest.json"})
    if missing:
        raise BundleError("bundle.file_missing", f"{missing[:8]} are not there", "fetch the bundle again")
    if extra:
        raise BundleError("bundle.file_unlisted", f"{extra[:8]} are not in the manifest", "remove them")
    for file in manifest.files:
        if not (0.0 <= file.size_bytes < math.inf):
            raise BundleError(
                "bundle.manifest_invalid", f'"{file.path}" has no possible size', "export the bundle again"
            )
        verify(source, file.path, int(file.size_bytes), file.sha256)


def _check_values(manifest: BundleManifest) -> None:
    def invalid(what: str) -> BundleError:
        return BundleError("bundle.manifest_invalid", what, "export the bundle again")

    for name, expected in _CONVENTIONS.items():
        stated = getattr(manifest.world, name)
        if stated != expected:
            raise BundleError(
                "bundle.convention_unknown",
                f"world.{name} is {stated[:64]!r}, this reader knows {expected!r}",
                "export the bundle with the conventions of docs/reference/conventions.md",
            )
    rays = manifest.secondary_rays
    if not (0.0 <= rays.origin_offset < math.inf and 0.0 <= rays.near < rays.far < math.inf):
        raise invalid("secondary_rays needs origin_offset >= 0 and 0 <= near < far")
    lower, upper = list(manifest.bounds.minimum), list(manifest.bounds.maximum)
    if (
        len(lower) != 3
        or len(upper) != 3
        or not all(-math.inf < a < b < math.inf for a, b in zip(lower, upper, strict=True))
    ):
        raise invalid("bounds needs three minimum values below three maximum values")
    scale = list(manifest.albedo_scale_rgb)
    if len(scale) != 3 or not all(0.0 < value < math.inf for value in scale):
        raise invalid("albedo_scale_rgb needs three positive numbers")
    atlas = manifest.atlas
    if manifest.HasField("transport"):
        sizes = (atlas.size, atlas.material_size)
        if not (0.0 < atlas.texel_size < math.inf and all(0 < size <= MAX_ATLAS for size in sizes)):
            raise invalid(f"atlas needs a positive texel_size and sizes of 1 to {MAX_ATLAS} texels")


def _check_graphs(bundle: Bundle) -> None:
    listed = {file.path for file in bundle.manifest.files}
    for graph in bundle.manifest.graphs:
        if graph.path not in listed:
            raise BundleError(
                "bundle.file_missing", f'the graph "{graph.path}" is not in files', "export the bundle again"
            )
        # External data is resolved relative to the graph, so graphs must be next to weights.bin.
        if not re.fullmatch(r"models/[\w.\-]+\.onnx", graph.path):
            raise BundleError(
                "bundle.manifest_invalid", f'the graph "{graph.path}" is not in models/', "export it again"
            )
        data = bundle.graph(graph.path)
        check_onnx(data, path=graph.path, weights_bytes=len(bundle.weights))
    if bundle.has_networks or not bundle.manifest.HasField("transport"):
        for name in NETWORKS:
            bundle.graph_path(name)

"""Helpers for tests of refused bundles: a bundle's manifest, an archive of it, and why it is refused."""

import zipfile
from pathlib import Path

import pytest
from google.protobuf import json_format
from lambent_core.errors import BundleError
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.bundle.bundle import load_bundle
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere


def write_ball(folder: Path) -> Path:
    """Write a bundle of one grey ball and return its folder."""
    return write_analytic_bundle(folder / "ball.relight", AnalyticScene((Sphere((0.0, 0.0, 0.0), 1.0),)))


def manifest_in(folder: Path) -> BundleManifest:
    """Return the manifest of a bundle, whatever it says."""
    return json_format.Parse((folder / "manifest.json").read_text(encoding="utf-8"), BundleManifest())


def store(folder: Path, manifest: BundleManifest) -> None:
    """Write the manifest as it is, its list of files too."""
    text = json_format.MessageToJson(manifest, preserving_proto_field_name=True)
    (folder / "manifest.json").write_text(text, encoding="utf-8")


def zipped(folder: Path, *, compression: int = zipfile.ZIP_STORED) -> Path:
    """Return an archive of the bundle, written beside it."""
    path = folder.with_suffix(".relight.zip")
    with zipfile.ZipFile(path, "w", compression) as archive:
        for file in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(file, file.relative_to(folder).as_posix())
    return path


def refusal(path: Path) -> str:
    """Return the code that a bundle is refused with; it comes with advice."""
    with pytest.raises(BundleError) as caught:
        load_bundle(path)
    assert caught.value.advice
    return caught.value.code

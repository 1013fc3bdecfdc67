"""Bundles that are refused for what surrounds their files: archives, limits, networks that are half there."""

from pathlib import Path

import pytest
from lambent_relight.bundle import archive, bundle
from lambent_relight.bundle.bundle import load_bundle
from support.refused_bundle import manifest_in, refusal, store, write_ball, zipped


@pytest.fixture
def folder(tmp_path) -> Path:
    return write_ball(tmp_path)


def without_graphs(folder: Path, names: set[str]) -> None:
    """Take graphs out of a bundle, files and entries."""
    manifest = manifest_in(folder)
    gone = [graph for graph in manifest.graphs if graph.name in names]
    for graph in gone:
        (folder / graph.path).unlink()
        manifest.files.remove(next(file for file in manifest.files if file.path == graph.path))
        manifest.graphs.remove(graph)
    store(folder, manifest)


def test_an_encrypted_archive_is_refused_by_name(folder):
    path = zipped(folder)
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 8] |= 1  # the flag of the first entry in the archive's list
    path.write_bytes(data)
    assert refusal(path) == "bundle.encrypted"


def test_an_archive_whose_bytes_do_not_fit_their_checksum_is_damaged(folder):
    path = zipped(folder)
    data = bytearray(path.read_bytes())
    at = data.index((folder / "manifest.json").read_bytes())
    data[at + 5] ^= 1
    path.write_bytes(data)
    assert refusal(path) == "bundle.file_damaged"


@pytest.mark.parametrize("packed", [False, True])
def test_more_files_than_any_bundle_has_are_refused(folder, monkeypatch, packed):
    path = zipped(folder) if packed else folder
    count = sum(file.is_file() for file in folder.rglob("*"))
    monkeypatch.setattr(archive, "MAX_FILES", count)
    assert load_bundle(path).has_networks
    monkeypatch.setattr(archive, "MAX_FILES", count - 1)
    assert refusal(path) == "bundle.too_many_files"


@pytest.mark.parametrize("limit", ["_MAX_GRAPH_BYTES", "_MAX_MANIFEST_BYTES"])
def test_graphs_and_manifests_have_limits_of_their_own(folder, monkeypatch, limit):
    monkeypatch.setattr(bundle, limit, 100)
    assert refusal(folder) == "bundle.too_large"


@pytest.mark.parametrize("names", [{"material"}, {"gbuffer", "material", "fast_cache"}])
def test_networks_that_are_half_there_or_not_replaced_by_transport_are_missed(folder, names):
    without_graphs(folder, names)
    assert refusal(folder) == "bundle.graph_missing"

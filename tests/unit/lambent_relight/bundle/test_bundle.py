"""Opening bundles: everything is checked before anything is used."""

import shutil
import stat
import zipfile
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from google.protobuf import json_format
from lambent_core.errors import BundleError
from lambent_relight.bundle.archive import check_path
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.bundle.graphs import OnnxCaches
from lambent_relight.bundle.onnx_check import check_onnx, keep_outputs, metadata
from support.analytic_bundle import write_manifest
from support.refused_bundle import manifest_in, refusal, store, write_ball, zipped

ATLAS = {"size": 64, "material_size": 64, "texel_size": 0.01}


@pytest.fixture
def bundle(tmp_path) -> Path:
    return write_ball(tmp_path)


def test_a_folder_and_a_zip_of_it_are_the_same_bundle(bundle):
    from_folder = load_bundle(bundle)
    for compression in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        from_zip = load_bundle(zipped(bundle, compression=compression))
        assert from_zip.manifest == from_folder.manifest
        assert from_zip.weights == from_folder.weights
        assert [c.name for c in from_zip.cameras()] == [c.name for c in from_folder.cameras()]


def test_fields_that_are_not_known_are_passed_over(bundle):
    text = (bundle / "manifest.json").read_text(encoding="utf-8")
    text = text.replace('"schema_version"', '"invented_later": {"a": 1}, "schema_version"')
    (bundle / "manifest.json").write_text(text, encoding="utf-8")
    load_bundle(bundle)


@pytest.mark.parametrize("version", ["2", "0", "", "1.3", "1.0.0", "latest"])
def test_another_version_is_refused_with_what_to_do(bundle, version):
    manifest = manifest_in(bundle)
    manifest.schema_version = version
    store(bundle, manifest)
    message = (
        rf"bundle\.version_unknown: .*'{version}', this release reads version '1' alone; export .* again"
    )
    with pytest.raises(BundleError, match=message):
        load_bundle(bundle)


def test_a_changed_byte_in_any_file_is_noticed(bundle):
    for file in manifest_in(bundle).files:
        path = bundle / file.path
        data = path.read_bytes()
        path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
        assert refusal(bundle) == "bundle.digest_mismatch"
        assert refusal(zipped(bundle)) == "bundle.digest_mismatch"
        path.write_bytes(data)
    load_bundle(bundle)


def test_missing_and_additional_files_are_refused(bundle):
    (bundle / "models" / "extra.bin").write_bytes(b"x")
    assert refusal(bundle) == "bundle.file_unlisted"
    (bundle / "models" / "extra.bin").unlink()
    (bundle / "cameras.json").unlink()
    assert refusal(bundle) == "bundle.file_missing"
    (bundle / "manifest.json").unlink()
    assert refusal(bundle) == "bundle.manifest_missing"
    assert refusal(bundle / "nowhere") == "bundle.missing"


def test_links_are_refused_in_folders_and_archives(bundle, tmp_path):
    target = tmp_path / "weights.bin"
    shutil.move(bundle / "models" / "weights.bin", target)
    (bundle / "models" / "weights.bin").symlink_to(target)
    assert refusal(bundle) == "bundle.not_a_plain_file"
    (bundle / "models" / "weights.bin").unlink()
    archive = zipped(bundle)
    with zipfile.ZipFile(archive, "a") as opened:
        link = zipfile.ZipInfo("models/weights.bin")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        opened.writestr(link, str(target))
    assert refusal(archive) == "bundle.not_a_plain_file"


def test_a_linked_folder_inside_a_bundle_is_refused(bundle, tmp_path):
    shutil.move(bundle / "models", tmp_path / "models")
    (bundle / "models").symlink_to(tmp_path / "models", target_is_directory=True)
    assert refusal(bundle) == "bundle.not_a_plain_file"


@pytest.mark.parametrize(
    "path",
    ["../x", "/etc/passwd", "a/../../x", "a//b", "./a", "a\\..\\b", "C:/x", "", "a/", "a\0b", "x" * 2000],
)
def test_paths_that_could_leave_the_bundle_are_refused(bundle, path):
    with pytest.raises(BundleError, match=r"bundle\.path_unsafe"):
        check_path(path)
    manifest = manifest_in(bundle)
    manifest.files[0].path = path
    store(bundle, manifest)
    assert refusal(bundle) == "bundle.path_unsafe"


def test_an_archive_whose_names_leave_it_is_refused(bundle):
    archive = zipped(bundle)
    with zipfile.ZipFile(archive, "a") as opened:
        opened.writestr("../outside.txt", b"x")
    assert refusal(archive) == "bundle.path_unsafe"


def test_an_archive_that_unpacks_to_more_than_it_states_is_refused(bundle):
    manifest = manifest_in(bundle)
    manifest.files[0].size_bytes = 10.0
    store(bundle, manifest)
    assert refusal(zipped(bundle, compression=zipfile.ZIP_DEFLATED)) == "bundle.digest_mismatch"
    manifest.files[0].size_bytes = 1e15
    store(bundle, manifest)
    assert refusal(bundle) == "bundle.too_large"


def test_damaged_archives_are_refused(bundle):
    archive = zipped(bundle)
    data = archive.read_bytes()
    archive.write_bytes(data[: len(data) // 2])
    assert refusal(archive) == "bundle.archive_damaged"
    archive.write_bytes(data[:300] + bytes(40) + data[340:])
    assert refusal(archive).startswith("bundle.")


@pytest.mark.parametrize("text", ["", "[3]", "{", '{"files": 3}', "\udcff"])
def test_an_unreadable_manifest_is_refused(bundle, text):
    (bundle / "manifest.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    assert refusal(bundle) == "bundle.manifest_unreadable"


def merged(**values):
    return lambda manifest: json_format.ParseDict(values, manifest)


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (merged(world={"up_axis": "y"}), "convention_unknown"),
        (merged(world={"environment_convention": "opengl"}), "convention_unknown"),
        (merged(secondary_rays={"near": 1.0, "far": 1.0}), "manifest_invalid"),
        (merged(secondary_rays={"origin_offset": "NaN"}), "manifest_invalid"),
        (lambda m: m.bounds.maximum.__setitem__(1, -5.0), "manifest_invalid"),
        (lambda m: m.albedo_scale_rgb.__setitem__(0, 0.0), "manifest_invalid"),
        (merged(transport={"size": 64}, atlas=ATLAS | {"texel_size": "NaN"}), "manifest_invalid"),
        (merged(transport={"size": 64}, atlas=ATLAS | {"size": 1 << 20}), "manifest_invalid"),
        (lambda m: m.files.append(m.files[0]), "manifest_invalid"),
        (lambda m: setattr(m.graphs[0], "path", "cameras.json"), "manifest_invalid"),
        (lambda m: setattr(m.graphs[0], "path", "models/other.onnx"), "file_missing"),
        (lambda m: m.graphs.pop(0), "graph_missing"),
    ],
)
def test_values_this_reader_cannot_work_with_are_refused(bundle, spoil, code):
    manifest = manifest_in(bundle)
    spoil(manifest)
    store(bundle, manifest)
    assert refusal(bundle) == f"bundle.{code}"


def change_graph(bundle: Path, change) -> None:
    """Rewrite one graph with `change(model)` and state its new hash, as an attacker would."""
    path = bundle / "models" / "material.onnx"
    model = onnx.load(path, load_external_data=False)
    change(model)
    path.write_bytes(model.SerializeToString())
    write_manifest(bundle, manifest_in(bundle))


def external(model) -> onnx.TensorProto:
    return next(t for t in model.graph.initializer if t.data_location == onnx.TensorProto.EXTERNAL)


def set_entry(tensor, key, value):
    next(entry for entry in tensor.external_data if entry.key == key).value = value


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("location", "/etc/passwd"),
        ("location", "../../secret"),
        ("location", "other.bin"),
        ("offset", "-4"),
        ("offset", "999999999"),
        ("length", "999999999"),
    ],
)
def test_a_graph_that_reads_outside_the_weights_is_refused(bundle, key, value):
    change_graph(bundle, lambda model: set_entry(external(model), key, value))
    assert refusal(bundle) == "bundle.external_data"


def test_outside_data_is_found_in_nested_graphs_and_attributes(bundle):
    def hide(model):
        tensor = onnx.TensorProto()
        tensor.CopyFrom(external(model))
        set_entry(tensor, "location", "/etc/passwd")
        inner = onnx.helper.make_graph([], "inner", [], [], [tensor])
        model.graph.node[0].attribute.append(onnx.helper.make_attribute("body", inner))

    change_graph(bundle, hide)
    assert refusal(bundle) == "bundle.external_data"


def test_operators_outside_the_standard_are_refused(bundle):
    change_graph(bundle, lambda model: setattr(model.graph.node[0], "domain", "com.example"))
    assert refusal(bundle) == "bundle.graph_operators"


def test_bytes_that_are_no_graph_are_refused(bundle):
    (bundle / "models" / "material.onnx").write_bytes(b"\xff" * 100)
    write_manifest(bundle, manifest_in(bundle))
    assert refusal(bundle) == "bundle.graph_damaged"


def test_graphs_inside_graphs_without_end_are_refused():
    model = b""
    for key in [0x32, 0x2A, 0x0A] * 60 + [0x3A]:  # graph in attribute in node in graph ... in model
        model = bytes([key, len(model) % 128 | 128, len(model) // 128]) + model
    with pytest.raises(BundleError, match=r"bundle\.graph_damaged"):
        check_onnx(model, path="deep.onnx", weights_bytes=0)


def test_a_graph_with_other_outputs_is_refused_when_it_is_opened(bundle):
    def rename(model):
        node = next(node for node in model.graph.node if node.output[0] == "albedo")
        node.output[0] = model.graph.output[0].name = "base_colour"

    change_graph(bundle, rename)
    caches = OnnxCaches(load_bundle(bundle), num_threads=1)
    with pytest.raises(BundleError, match=r"bundle\.graph_signature"):
        caches.material(np.ones((1, 3), np.float32))


def test_a_graph_that_fails_while_it_runs_is_an_error_of_the_bundle(bundle):
    def break_shape(model):
        node = next(node for node in model.graph.node if node.output[0] == "albedo")
        model.graph.initializer.append(onnx.numpy_helper.from_array(np.array([7, 3]), "seven"))
        node.op_type = "Reshape"
        node.input.append("seven")

    change_graph(bundle, break_shape)
    caches = OnnxCaches(load_bundle(bundle), num_threads=1)
    with pytest.raises(BundleError, match=r"bundle\.graph_failed"):
        caches.material(np.ones((2, 3), np.float32))


def test_trimming_a_graph_keeps_what_is_asked_for_and_nothing_else(bundle):
    weights = (bundle / "models" / "weights.bin").read_bytes()
    data = (bundle / "models" / "gbuffer.onnx").read_bytes()
    trimmed = keep_outputs(data, {"distance"})
    nodes = [onnx.load_from_string(d).graph.node for d in (data, trimmed)]
    assert 0 < len(nodes[1]) < len(nodes[0])
    values = np.random.default_rng(0).normal(size=(2, 50, 3)).astype(np.float32)
    results = []
    for model in (data, trimmed):
        options = onnxruntime.SessionOptions()
        options.add_external_initializers_from_files_in_memory(["weights.bin"], [weights], [len(weights)])
        session = onnxruntime.InferenceSession(model, options)
        results.append(session.run(["distance"], {"origin": values[0], "direction": values[1]})[0])
    assert [output.name for output in session.get_outputs()] == ["distance"]
    np.testing.assert_array_equal(*results)


def test_a_graph_with_inner_graphs_is_trimmed_of_outputs_only(bundle):
    model = onnx.load(bundle / "models" / "gbuffer.onnx", load_external_data=False)
    inner = onnx.helper.make_graph([], "inner", [], [], [])
    model.graph.node[0].attribute.append(onnx.helper.make_attribute("body", inner))
    trimmed = onnx.load_from_string(keep_outputs(model.SerializeToString(), {"distance"}))
    assert len(trimmed.graph.node) == len(model.graph.node)
    assert [output.name for output in trimmed.graph.output] == ["distance"]


def test_metadata_of_a_graph_is_read(bundle):
    path = bundle / "models" / "material.onnx"
    model = onnx.load(path, load_external_data=False)
    onnx.helper.set_model_props(model, {"a.b": "1", "größe": "{}"})
    assert metadata(model.SerializeToString()) == {"a.b": "1", "größe": "{}"}
    assert metadata(path.read_bytes()) == {}


def test_the_look_into_a_graph_agrees_with_the_onnx_package(bundle):
    path = bundle / "models" / "gbuffer.onnx"
    model = onnx.load(path, load_external_data=False)
    expected = {
        (t.name, *(entry.value for entry in t.external_data))
        for t in model.graph.initializer
        if t.external_data
    }
    found = check_onnx(path.read_bytes(), path="gbuffer.onnx", weights_bytes=2**40)
    assert {(t.name, t.location, str(t.offset), str(t.length)) for t in found} == expected != set()

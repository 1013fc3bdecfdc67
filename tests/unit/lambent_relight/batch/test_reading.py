"""Manifests of batches: what is read, and how what cannot be meant is pointed at."""

from pathlib import Path

import pytest
from lambent.errors import UsageProblemError
from lambent.manifest_file import load_document
from lambent_core.pictures import RenderQuality, safe_name
from lambent_relight.aovs import PASSES
from lambent_relight.batch.manifest import Cameras
from lambent_relight.batch.reading import ManifestError, read_manifest

BASE = Path("/somewhere")
SMALL = {
    "schema": "lambent-batch/1",
    "assets": ["cow.relight"],
    "environments": ["sky.exr"],
    "cameras": [{"turntable": 2}],
}


def load(tmp_path, text):
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    return load_document(path)


def problems(**changes):
    """Return {pointer: message} of a manifest with these members changed; None removes one."""
    document = {name: value for name, value in {**SMALL, **changes}.items() if value is not None}
    with pytest.raises(ManifestError) as caught:
        read_manifest(document, BASE)
    return {each.pointer: each.message for each in caught.value.problems}


def test_short_forms_take_their_names_from_the_files():
    found = read_manifest(SMALL, BASE)
    assert [(asset.called, asset.bundle) for asset in found.assets] == [("cow", BASE / "cow.relight")]
    assert [(light.called, light.map) for light in found.environments] == [("sky", BASE / "sky.exr")]
    assert found.cameras == [Cameras(turntable=2)]
    assert found.qualities == [RenderQuality()]
    assert found.files.files == ["png", "exr"]
    assert tuple(found.files.passes) == PASSES


EVERY_FIELD = """
schema: lambent-batch/1
name: spring
assets:
  - name: red
    bundle_id: bundle_1
    material: {albedo_gain: [1, 2, 3], albedo: [0.5, 0, 0], roughness_scale: 0.5}
    object_rotate_deg: 30
environments: [{name: dusk, map: d.hdr, axes: mitsuba, sun_clamp: 50, mend: true, rotate_deg: 90}]
cameras:
  - name: low
    turntable: 3
    size: 64
    radius: 2
    elevation_deg: 5
    field_of_view_deg: 50
    start_deg: 10
  - {file: c.json, views: [front]}
  - all
settings: {seed: 7, antialias: 1, background: white}
qualities: [preview, {name: final, quality: refined, spp: 8, until_stderr: 0.01, indirect: false}]
output: {files: [exr], passes: [normal], half: false, path: "{environment}/{quality}_{camera}"}
"""


def test_every_field_arrives(tmp_path):
    found = read_manifest(load(tmp_path, EVERY_FIELD).value, BASE)
    (asset,), (light,) = found.assets, found.environments
    assert asset.bundle_id == "bundle_1"
    assert asset.bundle is None
    assert (asset.edit.albedo_gain, asset.edit.albedo) == ((1.0, 2.0, 3.0), (0.5, 0.0, 0.0))
    assert (asset.edit.roughness_scale, asset.object_rotate_deg) == (0.5, 30.0)
    assert (light.axes, light.sun_clamp, light.mend) == ("mitsuba", 50.0, True)
    assert light.rotate_deg == 90.0
    low, file, every = found.cameras
    assert (low.name, low.turntable, low.size, low.radius) == ("low", 3, 64, 2.0)
    assert (low.elevation_deg, low.field_of_view_deg, low.start_deg) == (5.0, 50.0, 10.0)
    assert (file.file, file.views) == (BASE / "c.json", ["front"])
    assert every.all_views
    assert found.qualities == [
        RenderQuality(quality="preview", seed=7, antialias=1, background="white"),
        RenderQuality(
            name="final", spp=8, until_stderr=0.01, indirect=False, seed=7, antialias=1, background="white"
        ),
    ]
    assert (found.files.files, found.files.passes, found.files.half) == (["exr"], ["normal"], False)


def test_a_list_of_angles_is_as_many_environments():
    found = read_manifest({**SMALL, "environments": [{"map": "sky.exr", "rotate_deg": [0, 90.5]}]}, BASE)
    assert [(light.called, light.rotate_deg) for light in found.environments] == [
        ("sky_0", 0.0),
        ("sky_90.5", 90.5),
    ]


def test_places_of_environments_are_those_of_the_document_however_many_each_stands_for():
    lights = [{"map": "sky.exr", "rotate_deg": [0, 90]}, {"map": "b.exr", "axes": "unreal"}]
    assert list(problems(environments=lights)) == ["/environments/1/axes"]
    found = read_manifest({**SMALL, "environments": [lights[0], "b.exr"]}, BASE)
    assert [found.light_pointer(index) for index in range(3)] == [
        "/environments/0",
        "/environments/0",
        "/environments/1",
    ]


@pytest.mark.parametrize(
    ("changes", "pointer", "word"),
    [
        ({"schema": None}, "", "schema is missing"),
        ({"schema": "lambent-batch/2"}, "/schema", "lambent-batch/1"),
        ({"assets": []}, "/assets", "1 to 1000"),
        ({"assets": None}, "", "assets"),
        ({"colour": 1}, "/colour", "there is no 'colour'"),
        ({"settings": {"sppp": 1}}, "/settings/sppp", "did you mean 'spp'?"),
        ({"settings": {"spp": 1}}, "/settings/spp", "from 2 to 65536"),
        ({"settings": {"spp": 2.5}}, "/settings/spp", "whole number"),
        ({"settings": {"indirect": 1}}, "/settings/indirect", "true or false"),
        ({"settings": {"exposure_ev": float("nan")}}, "/settings/exposure_ev", "a number"),
        ({"settings": {"bounces": "many"}}, "/settings/bounces", "auto, adapted, baked, transport, one"),
        ({"settings": {"quality": "best"}}, "/settings/quality", "preview, baked, refined"),
        ({"assets": [{"name": "a"}]}, "/assets/0", "one of bundle and bundle_id"),
        ({"assets": [{"bundle": "a", "bundle_id": "b"}]}, "/assets/0", "one of bundle and bundle_id"),
        (
            {"assets": [{"bundle": "a", "material": {"albedo": [2, 0, 0]}}]},
            "/assets/0/material/albedo",
            "0 to 1",
        ),
        ({"assets": ["a", "b/a"]}, "/assets/1/name", 'a second asset is called "a"'),
        ({"assets": ["a", "A"]}, "/assets/1/name", "second asset"),
        ({"assets": [{"bundle": "a", "name": "../a"}]}, "/assets/0/name", "letters"),
        ({"environments": [{"map": "x.exr", "axes": "unreal"}]}, "/environments/0/axes", "skylibs"),
        ({"environments": [5]}, "/environments/0", "a mapping is expected, not 5"),
        ({"cameras": [{}]}, "/cameras/0", "one of turntable"),
        ({"cameras": [{"turntable": 2, "all_views": True}]}, "/cameras/0", "one of turntable"),
        ({"cameras": [{"all_views": False}]}, "/cameras/0", "one of turntable"),
        ({"cameras": [{"turntable": 0}]}, "/cameras/0", "one of turntable"),
        ({"cameras": [{"all_views": True, "radius": 2}]}, "/cameras/0/radius", "turntable"),
        ({"cameras": [{"poses": [{"name": "x"}]}]}, "/cameras/0/poses/0", "is missing"),
        ({"qualities": ["preview", "preview"]}, "/qualities/1/name", "second quality"),
        ({"output": {"files": ["jpg"]}}, "/output/files", "png, exr"),
        ({"output": {"passes": ["shadow"]}}, "/output/passes", "albedo"),
        ({"output": {"path": "{asset}/{nobody}"}}, "/output/path", "{camera}"),
        ({"output": {"path": "{asset}/../{camera}"}}, "/output/path", "relative"),
        ({"output": {"path": "/{camera}"}}, "/output/path", "relative"),
        ({"output": {"path": "{camera.__class__}"}}, "/output/path", "may name"),
        ({"output": {"path": "{asset}"}}, "/output/path", "add {camera}"),
        ({"assets": ["a", "b"], "output": {"path": "{camera}"}}, "/output/path", "add {asset}"),
    ],
)
def test_what_cannot_be_meant_is_pointed_at(changes, pointer, word):
    found = problems(**changes)
    assert pointer in found, found
    assert word in found[pointer]


def test_all_problems_are_told_at_once():
    assert len(problems(settings={"spp": 0, "seed": -1, "x": 1}, cameras=[{}])) == 4


def test_names_of_cameras_become_names_of_files():
    assert safe_name("train/r 000.png") == "train_r_000.png"
    assert "/" not in safe_name("../../etc")
    assert safe_name("…") == "_"


def test_a_document_knows_the_line_of_every_place(tmp_path):
    found = load(tmp_path, "schema: x\nassets:\n  - cow\n  - name: mug\n    spp: 1e-3\n")
    assert found.value == {"schema": "x", "assets": ["cow", {"name": "mug", "spp": 0.001}]}
    places = {"": 1, "/assets": 2, "/assets/0": 3, "/assets/1": 4, "/assets/1/spp": 5, "/assets/1/gone": 4}
    assert {pointer: found.where(pointer) for pointer in places} == {
        pointer: f"m.yaml:{line}" for pointer, line in places.items()
    }


def test_anchors_and_merge_keys_are_followed(tmp_path):
    found = load(tmp_path, "a: &d {spp: 8, seed: 1}\nb: {<<: *d, seed: 2}\n")
    assert found.value["b"] == {"spp": 8, "seed": 2}


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a: [1\nb: 2", "m.yaml:2"),
        ("a: 1\na: 2", 'duplicate key "a"'),
        ("a: !!python/object/apply:os.system ['true']", "m.yaml:1"),
        ("? [1, 2]\n: 3", "a name is expected"),
        ("a: 1\n---\nb: 2", "m.yaml:2"),
        ("\t- x", "m.yaml:1"),
        ("[" * 5000, "m.yaml"),
        (
            "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
            + "".join(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 10)}]\n" for n in range(8)),
            "200000 values",
        ),
    ],
)
def test_what_is_no_manifest_is_refused_with_its_line(tmp_path, text, word):
    with pytest.raises(UsageProblemError) as caught:
        load(tmp_path, text)
    assert caught.value.code == "batch.manifest"
    assert word in caught.value.message


def test_a_file_that_is_not_there_or_no_text_is_refused(tmp_path):
    with pytest.raises(UsageProblemError, match=r"batch\.manifest"):
        load_document(tmp_path / "no.yaml")
    (tmp_path / "m.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageProblemError, match=r"batch\.manifest"):
        load_document(tmp_path / "m.yaml")

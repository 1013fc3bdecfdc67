"""The key of a picture: every input is in its key, and bytes are looked at, not sizes."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
from lambent_core.pictures import RenderMaterial, RenderQuality
from lambent_relight.aovs import PASSES
from lambent_relight.batch import plan as planning
from lambent_relight.batch.journal import MadeFile, open_journal
from lambent_relight.batch.manifest import Asset, Files, Light
from lambent_relight.batch.plan import Row, renderer_digest
from lambent_relight.cameras import turntable
from support.small_batch import record

ROW = Row(
    path="a/b",
    asset=Asset(name="a", bundle_id="x"),
    light=Light(name="b", environment_id="x"),
    quality=RenderQuality(),
    camera=turntable(1, radius=2.0)[0],
    bundle_digest="0" * 64,
    light_digest="1" * 64,
)


def changed(**parts):
    """Return ROW with members of its members changed: quality={"spp": 3}."""
    found = ROW
    for name, values in parts.items():
        part = getattr(found, name)
        if isinstance(values, dict):
            values = replace(part, **values) if name == "camera" else part.model_copy(update=values)
        found = replace(found, **{name: values})
    return found


@pytest.mark.parametrize("suffix", ["png", "exr"])
@pytest.mark.parametrize(
    "row",
    [
        changed(bundle_digest="2" * 64),
        changed(light_digest="2" * 64),
        changed(light={"rotate_deg": 1.0}),
        changed(light={"mend": True}),
        changed(light={"sun_clamp": 2.0}),
        changed(light={"axes": "skylibs"}),
        changed(asset={"object_rotate_deg": 1.0}),
        changed(asset={"material": RenderMaterial(albedo_gain=[1.0, 1.0, 0.9])}),
        changed(asset={"material": RenderMaterial(albedo=[0.5, 0.5, 0.5])}),
        changed(asset={"material": RenderMaterial(roughness_scale=0.9)}),
        changed(camera={"width": 511}),
        changed(camera={"camera_to_world": np.eye(4)}),
        changed(quality={"quality": "baked"}),
        changed(quality={"spp": 65}),
        changed(quality={"until_stderr": 0.1}),
        changed(quality={"antialias": 1}),
        changed(quality={"indirect": False}),
        changed(quality={"bounces": "one"}),
        changed(quality={"seed": 1}),
        changed(quality={"background": "white"}),
    ],
)
def test_every_input_is_in_the_key(row, suffix):
    assert row.key(suffix, Files()) != ROW.key(suffix, Files())


def test_names_are_not_in_the_key():
    other = changed(
        asset={"name": "x"}, light={"name": "y"}, quality={"name": "z"}, camera={"name": "c"}, path="d"
    )
    assert other.key("png", Files()) == ROW.key("png", Files())
    bare = Files(passes=["normal"])
    assert other.key("exr", bare) == ROW.key("exr", bare)


def test_a_cryptomatte_has_the_assets_name_in_it():
    assert changed(asset={"name": "x"}).key("exr", Files()) != ROW.key("exr", Files())


def test_each_file_has_a_key_of_its_own():
    for shown in (changed(quality={"exposure_ev": 1.0}), changed(quality={"tone_mapping": "agx"})):
        assert shown.key("exr", Files()) == ROW.key("exr", Files())
        assert shown.key("png", Files()) != ROW.key("png", Files())
    assert ROW.key("png", Files()) != ROW.key("exr", Files())
    for files in (Files(half=False), Files(passes=list(PASSES[:2]))):
        assert ROW.key("exr", files) != ROW.key("exr", Files())
        assert ROW.key("png", files) == ROW.key("png", Files())
    assert ROW.key("exr", Files(passes=list(PASSES[::-1]))) == ROW.key("exr", Files())


def test_another_renderer_makes_other_pictures(monkeypatch):
    before = ROW.key("png", Files())
    assert len(renderer_digest()) == 64
    monkeypatch.setattr(planning, "renderer_digest", lambda: "3" * 64)
    assert ROW.key("png", Files()) != before


def test_a_file_of_the_same_size_with_other_bytes_is_not_known(tmp_path):
    (tmp_path / "a.png").write_bytes(b"abcd")
    digest = hashlib.sha256(b"abcd").hexdigest()
    one = MadeFile(path="a.png", key="key", sha256=digest, size_bytes=4)
    with open_journal(tmp_path) as journal:
        journal.add(record("a", {"png": one}))
        assert journal.known("png", "a", "key") == one
        assert journal.known("png", "elsewhere", "key") == one
        assert journal.known("png", "a", "other key") is None
        (tmp_path / "a.png").write_bytes(b"abcX")
        assert journal.known("png", "a", "key") is None
    with open_journal(tmp_path) as journal:
        assert journal.records == {"a": record("a", {"png": one})}

"""Notes about a finished bundle."""

import pytest
from flashcache.config import ExportConfig
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_run.run.export_notes import LITE_BYTES, tell_about
from support.recording_reporter import RecordingReporter


def told(manifest, **settings):
    reporter = RecordingReporter()
    tell_about(reporter, manifest, ExportConfig(**settings))
    return {fields["code"]: fields["message"] for fields in reporter.named("finding")}


def bundle(size_bytes=1000, atlas=512):
    manifest = BundleManifest()
    manifest.files.add(path="mesh/asset.glb", role="mesh", size_bytes=size_bytes - 100)
    manifest.files.add(path="cameras.json", role="cameras", size_bytes=100)
    manifest.atlas.size, manifest.atlas.material_size = atlas, 512
    return manifest


def test_a_size_that_the_texture_has_not_is_a_finding_that_says_why():
    found = told(bundle(), atlas_size=2048)
    assert list(found) == ["export.atlas_unused"]
    assert "--atlas 2048" in found["export.atlas_unused"]
    assert "512 texels" in found["export.atlas_unused"]
    assert "hardly finer" in found["export.atlas_unused"]
    of_model = told(bundle(), atlas_size=2048, albedo="model")["export.atlas_unused"]
    assert 'export.albedo is "model"' in of_model


@pytest.mark.parametrize(("atlas", "wanted"), [(2048, 2048), (512, 0), (4096, 0)])
def test_a_size_that_was_obeyed_or_left_open_is_none(atlas, wanted):
    assert told(bundle(atlas=atlas), atlas_size=wanted) == {}


def test_a_lite_bundle_above_its_goal_is_a_finding_that_says_what_to_do():
    heavy = bundle(LITE_BYTES + 1, atlas=4096)
    found = told(heavy, transport_tier="lite", weights="none", atlas_size=4096)
    assert list(found) == ["export.lite_size"]
    assert "10.0 MB" in found["export.lite_size"]
    assert found["export.lite_size"].endswith("export it with a smaller --atlas")
    with_networks = told(heavy, transport_tier="lite", weights="fp16", atlas_size=4096)
    assert with_networks["export.lite_size"].endswith("--weights none and a smaller --atlas")
    plain = told(bundle(LITE_BYTES + 1), transport_tier="lite", weights="none")
    assert plain["export.lite_size"].endswith("fewer --faces")


def test_other_tiers_and_small_lite_bundles_are_none():
    assert told(bundle(50 * LITE_BYTES)) == {}
    assert told(bundle(LITE_BYTES), transport_tier="lite") == {}

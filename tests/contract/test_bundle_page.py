"""docs/reference/bundle-format.md describes the messages of a bundle as they are."""

import re
from pathlib import Path

import pytest
from lambent_asset.textures.photo_albedo import LARGEST_SIZE, LEAST_SIZE
from lambent_proto.v1.bundle_pb2 import Atlas, BundleManifest
from lambent_relight.bundle.bundle import MAX_ATLAS

TEXT = (Path(__file__).parents[2] / "docs" / "reference" / "bundle-format.md").read_text(encoding="utf-8")
ATLAS = TEXT.split("\n### atlas\n", 1)[1].split("\n## ", 1)[0]


def test_the_atlas_is_a_list_of_all_its_fields():
    assert re.findall(r"^\* `(\w+)`", ATLAS, re.MULTILINE) == [item.name for item in Atlas.DESCRIPTOR.fields]


def test_the_sizes_of_the_atlas_are_those_that_are_written_and_read():
    assert f"1 to {MAX_ATLAS}." in ATLAS
    assert LARGEST_SIZE["lite"] == LEAST_SIZE
    assert f"{LEAST_SIZE} to {LARGEST_SIZE['full']}, a lite one of {LEAST_SIZE}." in ATLAS


@pytest.mark.parametrize("name", [item.name for item in BundleManifest.DESCRIPTOR.fields])
def test_every_field_of_the_manifest_is_on_the_page(name):
    assert f"`{name}`" in TEXT


def test_rows_of_tables_can_be_read():
    rows = [line for line in TEXT.splitlines() if line.startswith("| `")]
    assert max(map(len, rows)) < 400

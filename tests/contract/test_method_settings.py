"""docs/reference/method-settings.md names settings that exist and quotes the values that presets have."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from flashcache.ablations import ABLATIONS
from flashcache.config import SIZE_STEP, Config, to_dict
from flashcache.presets import fast, paper_tensoir, preset
from flashcache.presets_paper import SCENES
from lambent_server.api import parameters as job_parameters

TEXT = (Path(__file__).parents[2] / "docs" / "reference" / "method-settings.md").read_text(encoding="utf-8")
DATASETS = ("paper_tensoir", "paper_openillumination", "paper_glossy")
_PATH = re.compile(r"`((?:space|model|stage_one|stage_two|pixels)\.[a-z_.]+|max_side)`")
_ROW = re.compile(r"^\| `([a-z_.]+)` \| ([^|]+) \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)


def value_of(config: Config, path: str) -> Any:
    found: Any = to_dict(config)
    for name in path.split("."):
        found = found[name]
    return found


def section(title: str) -> str:
    return TEXT.split(f"## {title}\n", 1)[1].split("\n## ", 1)[0]


@pytest.mark.parametrize("path", sorted(set(_PATH.findall(TEXT))))
def test_a_setting_of_the_page_exists(path: str):
    value_of(paper_tensoir(), path)


BY_DATASET = _ROW.findall(section("The paper, by dataset"))


def test_the_table_by_dataset_was_understood():
    assert len(BY_DATASET) > 20


@pytest.mark.parametrize("row", BY_DATASET, ids=[row[0] for row in BY_DATASET])
def test_a_dataset_has_the_values_of_the_page(row):
    path, *texts = row
    assert [value_of(preset(name), path) for name in DATASETS] == [json.loads(text) for text in texts]


SWITCHES = [
    (path, paper.strip(), cpu.strip())
    for path, _, paper, cpu in _ROW.findall(section("Other switches"))
    + [
        (path, "", paper, cpu)
        for path, paper, cpu in re.findall(
            r"^\| [^|]+ \| `([a-z_.]+)` \| ([^|]+) \| ([^|]+) \|$",
            section("Where gradients of the physical pictures go"),
            re.MULTILINE,
        )
    ]
]


@pytest.mark.parametrize(("path", "paper", "cpu"), SWITCHES, ids=[row[0] for row in SWITCHES])
def test_a_switch_has_the_values_of_the_page(path: str, paper: str, cpu: str):
    for config, text in ((paper_tensoir(), paper), (fast(), cpu)):
        found = value_of(config, path)
        assert found == (text if isinstance(found, str) else json.loads(text))


def test_all_ablations_and_published_scenes_are_on_the_page():
    named = set(re.findall(r"`([a-z_0-9]+)`", section("Ablations")))
    assert set(ABLATIONS) - {"full"} <= named
    for scenes in SCENES.values():
        for scene in scenes:
            assert re.search(rf":{scene}`", TEXT)


def test_server_and_worker_agree_on_the_sizes_that_can_be_made():
    assert job_parameters.SIZE_STEP == SIZE_STEP

"""Every code that a user can encounter is documented, and every documented code exists."""

import re
from pathlib import Path

import lambent_asset
import lambent_capture
import lambent_core
import lambent_relight
import lambent_run
from lambent_relight import asset

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "findings-codes.md"
AREAS = "scene|run|config|device|evaluate|export|pipeline|training|benchmark|render|bake|mesh_file"
CLIENT_AREAS = "bundle|environment|camera"
FILES = {"run.json", "scene.json", "scene.xml", "benchmark.json"}
# Modules, and a name of a file.
NO_CODES = {"bundle.bundle", "environment.maps", "environment.exr"}


def codes_in_sources():
    packages = (lambent_core, lambent_capture, lambent_asset, lambent_run, asset)
    folders = [Path(package.__path__[0]) for package in packages]
    text = "\n".join(path.read_text(encoding="utf-8") for folder in folders for path in folder.rglob("*.py"))
    return set(re.findall(rf'"((?:{AREAS})\.[a-z_]+)"', text)) - FILES


def codes_in_page():
    return set(re.findall(rf"`((?:{AREAS})\.[a-z_]+)`", PAGE.read_text(encoding="utf-8"))) - FILES


def test_every_code_is_documented():
    assert not codes_in_sources() - codes_in_page()


def test_no_code_is_documented_that_does_not_exist():
    assert not codes_in_page() - codes_in_sources()


def test_the_codes_of_the_clients_library_are_documented_and_exist():
    folders = [Path(package.__path__[0]) for package in (lambent_core, lambent_relight)]
    text = "\n".join(path.read_text(encoding="utf-8") for folder in folders for path in folder.rglob("*.py"))
    found = set(re.findall(rf'"((?:{CLIENT_AREAS})\.[a-z_]+)"', text)) - NO_CODES
    assert found == set(re.findall(rf"`((?:{CLIENT_AREAS})\.[a-z_]+)`", PAGE.read_text(encoding="utf-8")))

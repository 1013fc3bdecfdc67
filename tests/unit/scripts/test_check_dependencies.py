"""Dependencies are pinned, and have a licence that is allowed; bills of materials are CycloneDX."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import check_dependencies
import pytest

ROOT = Path(__file__).parents[3]


def test_this_repository_has_no_problems():
    assert check_dependencies.check() == []


@pytest.mark.parametrize("text", ["numpy>=2\n", "numpy\n", "numpy==2.0\nNumPy==2.1\n"])
def test_a_line_that_pins_nothing_or_twice_is_refused(text: str):
    with pytest.raises(ValueError, match=r"constraints.txt"):
        check_dependencies.pins(text)


def test_what_is_installed_or_required_has_to_be_pinned_at_its_version():
    pinned = dict.fromkeys(check_dependencies.required(), "1.0")
    assert check_dependencies.unpinned(pinned, [("numpy", "1.0"), ("torch", "1.0+cpu"), ("pip", "9")]) == []
    (other,) = check_dependencies.unpinned(pinned, [("numpy", "2.0")])
    assert other == "numpy 2.0 is installed, constraints.txt says 1.0"
    (missing,) = check_dependencies.unpinned(pinned, [("leftpad", "3.0")])
    assert "not pinned" in missing
    del pinned["numpy"]
    assert check_dependencies.unpinned(pinned, []) == ["numpy is required by pyproject.toml and not pinned"]


def test_an_npm_package_needs_an_allowed_licence_and_a_checksum():
    sound = {"license": "(MIT OR CC0-1.0)", "integrity": "sha512-x"}
    packages = {
        "": {},
        "node_modules/sound": sound,
        "node_modules/copyleft": {**sound, "license": "GPL-3.0-only"},
        "node_modules/nameless": {"integrity": "sha512-x"},
        "node_modules/a/node_modules/unsealed": {**sound, "integrity": "sha1-x"},
    }
    found = check_dependencies.refused({"packages": packages}, {"MIT OR CC0-1.0"})
    assert [each.split()[2] for each in found] == ["unsealed", "copyleft", "nameless"]


def test_a_python_package_under_another_licence_is_refused(tmp_path: Path):
    folder = tmp_path / "strict-1.0.dist-info"
    folder.mkdir()
    metadata = "Metadata-Version: 2.4\nName: strict\nVersion: 1.0\nLicense-Expression: {}\n"
    command = [sys.executable, "-m", "piplicenses", "--packages", "strict"]
    found = {}
    for licence in ("MIT", "GPL-3.0-only", "GPL-3.0-only AND MIT"):
        (folder / "METADATA").write_text(metadata.format(licence))
        environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        found[licence] = done.returncode
    assert found == {"MIT": 0, "GPL-3.0-only": 1, "GPL-3.0-only AND MIT": 1}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not installed")
def test_the_bills_of_materials_name_what_we_depend_on(tmp_path: Path):
    tools = [f"BIN={Path(sys.executable).parent}", f"SBOM={tmp_path}"]
    subprocess.run(["make", "-o", ".venv/.installed", "sbom", *tools], cwd=ROOT, check=True)
    for name, wanted in (("python", {"torch", "fastapi"}), ("web", {"three"})):
        bill = json.loads((tmp_path / f"{name}.json").read_text())
        assert bill["bomFormat"] == "CycloneDX"
        assert wanted <= {each["name"] for each in bill["components"]}

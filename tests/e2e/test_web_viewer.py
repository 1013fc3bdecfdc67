"""The web viewer in Chromium: its own browser tests, with pictures that Python drew."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.chromium import program
from support.three_page import WEB
from support.viewer_fixture import write_fixture

pytestmark = [pytest.mark.browser, pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def fixture_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bundle, maps, and the pictures that the viewer must show."""
    folder = tmp_path_factory.mktemp("viewer") / "fixture"
    write_fixture(folder)
    return folder


def run(fixture_folder: Path, *files: str) -> None:
    """Run browser tests: all, or those of some files."""
    if program() is None or not (WEB / "node_modules" / "playwright-core").is_dir():
        pytest.skip("needs Chromium and the web tool chain")
    npx = shutil.which("npx")
    assert npx is not None
    done = subprocess.run(
        [npx, "vitest", "run", "--config", "vitest.browser.config.ts", *files],
        cwd=WEB,
        env={
            **os.environ,
            "LAMBENT_VIEWER_FIXTURE": str(fixture_folder),
            "PYTHON": sys.executable,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]


QUICK = [
    "camera",
    "comparisons",
    "embed",
    "finish",
    "golden",
    "ground",
    "interface",
    "lights",
    "loading",
    "picture",
]
BROWSER = WEB / "tests" / "browser"


def test_the_viewer_shows_what_python_does_and_does_what_it_is_asked_for(fixture_folder: Path) -> None:
    run(fixture_folder, *(f"tests/browser/{name}.browser.ts" for name in QUICK))


@pytest.mark.long
@pytest.mark.parametrize(
    "name", sorted({path.name.split(".")[0] for path in BROWSER.glob("*.browser.ts")} - set(QUICK))
)
def test_the_viewer_passes_its_other_browser_tests(fixture_folder: Path, name: str) -> None:
    run(fixture_folder, f"tests/browser/{name}.browser.ts")

"""The wheel: it brings the built web pages, so that nobody who installs it needs Node."""

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import require_pages

ROOT = Path(__file__).parents[2]
PAGES = "lambent_pages/dist"

pytestmark = pytest.mark.slow


def build(root: Path, target: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Build the wheel of a source tree."""
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(target)]
    env = {**os.environ, **environment}
    return subprocess.run(command, cwd=root, env=env, capture_output=True, text=True, check=False)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a small source tree that is built by the rules of this one, and whose pages git ignores."""
    root = tmp_path / "tree"
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore", "scripts/require_pages.py"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes((ROOT / name).read_bytes())
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    for package in packages["wheel"]["packages"]:
        (root / package).mkdir(parents=True)
        (root / package / "__init__.py").touch()
    return root


def add_pages(root: Path) -> None:
    """Write what the build of the pages would."""
    dist = root / "client/python" / PAGES
    (dist / "assets").mkdir(parents=True)
    for name in ("jobs.html", "viewer.html", "masks.html", "assets/jobs-1a2b.js"):
        (dist / name).write_text(name)


def test_a_wheel_contains_the_pages_although_git_ignores_them(tree: Path, tmp_path: Path):
    assert "dist/" in (tree / ".gitignore").read_text().split()
    add_pages(tree)
    done = build(tree, tmp_path)
    assert done.returncode == 0, done.stderr
    [wheel] = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"{PAGES}/jobs.html", f"{PAGES}/assets/jobs-1a2b.js", "lambent_pages/__init__.py"} <= names


def test_a_wheel_without_pages_is_refused_unless_that_is_wanted(tree: Path, tmp_path: Path):
    done = build(tree, tmp_path)
    assert done.returncode != 0
    assert "make pages" in done.stderr + done.stdout
    assert not list(tmp_path.glob("*.whl"))
    assert build(tree, tmp_path, LAMBENT_WITHOUT_PAGES="1").returncode == 0


def test_every_page_that_a_wheel_needs_has_a_source():
    assert {path.name for path in (ROOT / "client/web").glob("*.html")} >= set(require_pages.REQUIRED)

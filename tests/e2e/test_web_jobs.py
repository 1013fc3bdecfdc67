"""The pages in a real browser: upload, live progress over a killed server, results, links, masks.

The tests themselves are those of client/web/tests/pages, which drive the system's Chromium.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import lambent_pages
import pytest
from support.chromium import program

WEB = Path(__file__).resolve().parents[2] / "client" / "web"

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def run(test: str, timeout_s: float) -> None:
    """Run one file of browser tests and fail with its output."""
    if program() is None:
        pytest.skip("needs Chromium")
    if shutil.which("npx") is None or not (WEB / "node_modules").is_dir():
        pytest.skip("needs Node and `make setup`")
    assert lambent_pages.are_built(), "run `make pages` first"
    command = ["npx", "vitest", "run", "--config", "vitest.pages.config.ts", f"tests/pages/{test}.browser.ts"]
    environment = {**os.environ, "PYTHON": sys.executable, "NO_COLOR": "1"}
    done = subprocess.run(
        command, cwd=WEB, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.timeout(400)
def test_the_pages_lead_from_an_upload_to_a_result_whatever_happens_to_the_server():
    run("jobs", 390.0)


@pytest.mark.long
@pytest.mark.timeout(400)
def test_a_shared_bundle_is_seen_on_the_sites_that_its_link_names():
    run("embedding", 390.0)


@pytest.mark.timeout(400)
def test_a_mark_on_one_photograph_takes_a_wrong_part_out_of_the_others():
    run("masks", 390.0)


@pytest.mark.long
@pytest.mark.timeout(1300)
def test_photographs_that_are_dropped_become_a_relit_object_on_another_site():
    run("artist", 1290.0)


@pytest.mark.long
@pytest.mark.timeout(400)
def test_the_pages_speak_german():
    run("words", 390.0)


def test_no_file_of_browser_tests_is_left_out():
    run_here = set(re.findall(r'^    run\("(\w+)"', Path(__file__).read_text(encoding="utf-8"), re.MULTILINE))
    assert {path.name.split(".")[0] for path in (WEB / "tests" / "pages").glob("*.browser.ts")} == run_here

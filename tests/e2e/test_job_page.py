"""The page at `/` in a real browser: one-time link, live cards, keyboard."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.chromium import Page, browser, program
from support.live_server import LiveServer

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    if program() is None:
        pytest.skip("needs Chromium")
    with LiveServer(tmp_path_factory.mktemp("page") / "data") as server:
        yield server


@pytest.fixture(scope="module")
def page(server: LiveServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with browser(tmp_path_factory.mktemp("profile")) as page:
        page.open(server.login_url)
        page.wait("document.querySelector('#connection')?.textContent === 'live'", 30)
        yield page


def state(job: str) -> str:
    """Return the JavaScript that reads a card's state."""
    return f"document.getElementById('{job}_name')?.closest('li').querySelector('.state').textContent"


def test_the_link_logs_in_once_and_leaves_no_code_behind(server: LiveServer, page: Page, tmp_path: Path):
    assert page.evaluate("location.href") == f"{server.url}/"
    page.open(f"{server.url}/")
    page.wait("document.querySelector('#connection')?.textContent === 'live'")
    assert page.evaluate("document.cookie") == ""
    with browser(tmp_path) as other:
        other.open(server.login_url)
        other.wait("document.querySelector('#message')?.textContent.includes('not logged in')")


def test_a_job_is_shown_while_it_runs_and_when_it_has_ended(server: LiveServer, page: Page):
    scene = server.scene()
    job = server.submit(scene, num_steps=60, step_s=0.05)
    page.wait(f"{state(job)} === 'running'")
    card = f"document.getElementById('{job}_name').closest('li')"
    assert page.wait(f"{card}.querySelector('h2').textContent !== '{scene}'")
    page.wait(f"{card}.querySelector('progress').value > 0.1")
    page.wait(f"{card}.querySelector('.figures').textContent.includes('of 60')")
    page.wait(f"{card}.querySelector('img').naturalWidth > 0")
    page.wait(f"{state(job)} === 'succeeded'")
    links = page.wait(f"[...{card}.querySelectorAll('.artifacts a')].map((a) => a.textContent).join()")
    assert links == "report.json"
    manifest = page.evaluate(f"fetch({card}.querySelector('.manifest').href).then((r) => r.json())")
    assert manifest["name"] == "sleep"


def test_a_job_is_cancelled_and_run_again_by_keyboard(server: LiveServer, page: Page):
    job = server.submit(server.scene(), num_steps=2000, step_s=0.05)
    page.wait(f"{state(job)} === 'running'")
    for button, wanted in (("cancel", "cancelled"), ("retry", "cancelled")):
        page.evaluate("document.activeElement.blur()")
        for _ in range(30):
            page.press("Tab")
            name, place = (
                page.evaluate(f"document.activeElement.{each}")
                for each in ("className", "getAttribute('aria-describedby')")
            )
            if (name, place) == (button, f"{job}_name"):
                break
        else:
            raise AssertionError(f"{button} cannot be reached with the Tab key")
        page.press("Enter")
        page.wait(f"{state(job)} === '{wanted}'")
    server.wait(job, "cancelled")
    page.wait(f"document.querySelector('#jobs li h2').id > '{job}_name'")
    newest = server.client.get("/v1/jobs").json()["items"][0]["id"]
    assert newest > job
    server.client.post(f"/v1/jobs/{newest}:cancel")
    server.wait(newest, "cancelled")


def test_the_page_finds_back_after_a_restart_of_the_server(server: LiveServer, page: Page):
    server.settings["port"] = int(server.url.rpartition(":")[2])
    server.end()
    page.wait("document.querySelector('#connection')?.textContent.includes('does not answer')")
    server.start()
    page.wait("document.querySelector('#connection')?.textContent === 'live'")
    job = server.submit(server.scene(), num_steps=2)
    page.wait(f"{state(job)} === 'succeeded'")


def test_the_browser_has_nothing_to_complain_about(page: Page):
    complaints = [text for text in page.console if "ERR_CONNECTION" not in text and "net::ERR" not in text]
    assert complaints == []

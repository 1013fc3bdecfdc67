"""view in a browser: what it serves, to whom, and what it says where it cannot."""

import http.client
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest
from lambent.cli.output import Output
from lambent.cli.web_view import Exhibit, serving, view_in_browser, write_light
from lambent.errors import LambentError, UsageProblemError
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.environment.axes import QUARTER_TURNS
from lambent_relight.environment.input import EnvironmentInput
from lambent_relight.environment.maps import load_environment, write_environment
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Box, Surface

SCENE = AnalyticScene((Box((-0.5,) * 3, (0.5,) * 3, Surface(albedo=(0.5, 0.5, 0.5))),))


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundle")
    write_analytic_bundle(folder, SCENE)
    return folder


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    (folder / "viewer.html").write_text("<title>viewer</title>")
    return folder


@pytest.fixture(scope="module")
def sky(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("light") / "my sky.exr"
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[4, 9] = (4.0, 2.0, 1.0)
    write_environment(path, radiance)
    return path


@pytest.fixture
def url(bundle: Path, pages: Path, sky: Path) -> Iterator[str]:
    exhibit = Exhibit(bundle=load_bundle(bundle), light={"0-sky.exr": sky}, pages=pages)
    # A bundle with a file that its manifest does not name is refused; one may appear later.
    (bundle / "diary.txt").write_text("not part of the bundle")
    with serving(exhibit) as url:
        yield url
    (bundle / "diary.txt").unlink()


def ask(url: str, path: str, method: str = "GET", **headers: str) -> http.client.HTTPResponse:
    """Return an answer whose `text` is its body."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=10)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    answer.body = answer.read()  # type: ignore[attr-defined]
    connection.close()
    return answer


def test_the_link_leads_to_the_viewer_the_bundle_and_the_light(url: str, bundle: Path, sky: Path):
    assert urlsplit(url).hostname == "127.0.0.1"
    page = ask(url, urlsplit(url).path)
    assert (page.status, page.body) == (200, b"<title>viewer</title>")
    assert "default-src 'none'" in page.headers["content-security-policy"]
    assert ask(url, urlsplit(url).path, **{"if-none-match": page.headers["etag"]}).status == 304
    given = dict(parse_qsl(urlsplit(url).fragment))
    manifest = ask(url, given["src"] + "manifest.json")
    assert manifest.body == (bundle / "manifest.json").read_bytes()
    assert ask(url, given["src"] + "models/gbuffer.onnx").status == 200
    light = ask(url, given["env"].removeprefix("url:"))
    assert light.body == sky.read_bytes()
    assert int(light.headers["content-length"]) == len(light.body)


def test_only_files_that_the_manifest_names_are_given_out(url: str):
    source = dict(parse_qsl(urlsplit(url).fragment))["src"]
    for path in ("diary.txt", "", "../diary.txt", "..%2fdiary.txt", "%2fetc%2fpasswd", "manifest.json/"):
        assert ask(url, source + path).status == 404, path


def test_whoever_lacks_the_key_gets_nothing(url: str):
    source = dict(parse_qsl(urlsplit(url).fragment))["src"]
    key = source.split("/")[2]
    for wrong in (source.replace(key, key[:-1]), source.replace(key, "x"), "/show//bundle/", "/bundle/"):
        assert ask(url, wrong + "manifest.json").status == 404, wrong


def test_another_host_name_and_writing_are_refused(url: str):
    for host in ("evil.example", "127.0.0.1.nip.io", ""):
        assert ask(url, "/viewer.html", host=host).status == 421, host
    assert ask(url, "/viewer.html", host="localhost:1").status == 200
    for method in ("POST", "PUT", "DELETE"):
        assert ask(url, "/viewer.html", method).status == 501
    head = ask(url, "/viewer.html", "HEAD")
    assert (head.status, head.body) == (200, b"")
    assert head.headers["content-length"] == "21"


def test_maps_are_served_in_our_convention(sky: Path, tmp_path: Path):
    other = next(name for name, turns in QUARTER_TURNS.items() if turns)
    remarks: list[str] = []
    given = EnvironmentInput(axes=other, sun_clamp=2.0)
    [(name, path)] = write_light([sky], given, tmp_path, remarks.append).items()
    assert name == "0-my_sky.exr"
    before, after = load_environment(sky).radiance, load_environment(path).radiance
    assert after.max() == pytest.approx(2.0)
    assert np.argmax(after.sum(-1)) != np.argmax(before.sum(-1))
    assert any("sun clamp" in remark for remark in remarks)


def test_the_link_is_printed_and_opened_until_it_is_ended(bundle: Path, pages: Path, monkeypatch, capsys):
    opened: list[str] = []

    def look() -> None:
        assert ask(opened[0], "/viewer.html").status == 200

    monkeypatch.setenv("DISPLAY", ":0")
    light = EnvironmentInput()
    view_in_browser(bundle, [], light, Output(False), pages=pages, open_page=opened.append, wait=look)
    assert opened[0] in capsys.readouterr().out
    with pytest.raises(ConnectionRefusedError):
        ask(opened[0], "/viewer.html")
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    view_in_browser(bundle, [], light, Output(True), pages=pages, open_page=opened.append, wait=lambda: None)
    assert len(opened) == 1


def test_what_cannot_be_shown_is_explained(bundle: Path, pages: Path, tmp_path: Path):
    def show(what: Path, maps: list[Path], pages: Path) -> None:
        view_in_browser(what, maps, EnvironmentInput(), Output(True), pages=pages, wait=lambda: None)

    with pytest.raises(UsageProblemError, match="make pages"):
        show(bundle, [], tmp_path)
    with pytest.raises(LambentError, match=r"^bundle\."):
        show(tmp_path, [], pages)
    with pytest.raises(UsageProblemError, match=r"^environment\."):
        show(bundle, [pages / "viewer.html"], pages)

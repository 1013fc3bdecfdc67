"""The page that corrects masks is answered on this machine, to whoever has its key, and to nobody else."""

import http.client
import io
import json
import threading
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from lambent_capture.editor.requests import MOST_BYTES, Desk, DeskHandler
from lambent_capture.editor.session import correct_masks
from lambent_capture.masks.corrections import Correction, corrections_from, record_of
from lambent_capture.masks.editing import Editing, Superseded
from lambent_capture.masks.find import FindSettings, find_object
from lambent_core.errors import UsageError
from lambent_pages.loopback import serving
from PIL import Image
from support.ball_on_table import HEIGHT, WIDTH, ball_on_table

BOX = {"frame": "v03", "label": "background", "box": [90, 60, 110, 80]}
MARKED = {"version": 1, "corrections": [BOX]}
NOTHING = {"version": 1, "corrections": []}


@cache
def found():
    capture = ball_on_table(8)
    return capture, find_object(capture.photographs, capture.points, FindSettings())


def editing() -> Editing:
    capture, work = found()
    return Editing(work, capture.photographs)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    (folder / "masks.html").write_text("<title>masks</title>")
    return folder


class Visitor:
    """Asks as the page does."""

    def __init__(self, url: str) -> None:
        self.parts = urlsplit(url)
        self.key = parse_qs(self.parts.fragment)["key"][0]

    def ask(self, path: str, body: object = None, **headers: str) -> tuple[int, bytes, dict[str, str]]:
        connection = http.client.HTTPConnection(self.parts.hostname or "", self.parts.port, timeout=60)
        if body is None:
            connection.request("GET", path, headers=headers)
        else:
            text = body if isinstance(body, str) else json.dumps(body)
            connection.request("POST", path, text, {"content-type": "application/json"} | headers)
        answer = connection.getresponse()
        content = answer.read()
        connection.close()
        return answer.status, content, {name.lower(): value for name, value in answer.getheaders()}

    def edit(self, what: str, body: object = None, **headers: str) -> tuple[int, bytes, dict[str, str]]:
        return self.ask(f"/edit/{self.key}/{what}", body, **headers)


@pytest.fixture
def desk(pages: Path) -> Desk:
    kept: list[object] = []
    made = Desk(editing=editing(), corrections=(), keep=kept.append, command="lambent train", pages=pages)
    object.__setattr__(made, "kept", kept)
    return made


@pytest.fixture
def visitor(desk: Desk) -> Iterator[Visitor]:
    with serving(lambda *given: DeskHandler(*given, desk=desk)) as origin:
        yield Visitor(f"{origin}{desk.address()}")


def picture(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)))


def test_the_page_gets_the_capture_its_pictures_and_its_masks(visitor: Visitor):
    status, page, headers = visitor.ask("/masks.html")
    assert (status, page) == (200, b"<title>masks</title>")
    assert "wasm-unsafe-eval" not in headers["content-security-policy"]
    capture = json.loads(visitor.edit("capture")[1])
    assert capture["corrections"] == NOTHING
    assert capture["frames"][3] == {"name": "v03", "width": WIDTH, "height": HEIGHT, "doubtful": False}
    _, jpeg, headers = visitor.edit("picture?frame=v03&side=100")
    assert headers["content-type"] == "image/jpeg"
    assert picture(jpeg).shape == (75, 100, 3)
    assert picture(visitor.edit("picture?frame=v03&side=999999")[1]).shape == (HEIGHT, WIDTH, 3)
    assert not picture(visitor.edit("mask?frame=v03")[1]).any()


@pytest.mark.slow
def test_corrections_are_kept_and_change_the_masks(visitor: Visitor, desk: Desk):
    first = json.loads(visitor.edit("corrections", NOTHING)[1])
    assert len(first["changed"]) == 8
    assert picture(visitor.edit("mask?frame=v03")[1])[70, 100] == 255
    second = json.loads(visitor.edit("corrections", MARKED)[1])
    assert "v03" in second["changed"]
    assert 0.5 < second["agreement"] <= 1.0
    mask = picture(visitor.edit("mask?frame=v03")[1])
    assert mask.dtype == np.uint8
    assert not mask[61:79, 91:109].any()
    assert [record_of(each) for each in desk.kept] == [NOTHING, MARKED]
    again = json.loads(visitor.edit("corrections", MARKED)[1])
    assert again["changed"] == []


def test_what_cannot_be_used_is_refused_and_not_kept(visitor: Visitor, desk: Desk):
    unknown = {"version": 1, "corrections": [BOX | {"frame": "elsewhere"}]}
    for body in ("{", {"version": 2}, unknown):
        status, content, _ = visitor.edit("corrections", body)
        assert (status, json.loads(content)["code"]) == (422, "config.corrections_invalid")
    assert visitor.edit("corrections", NOTHING, **{"content-type": "text/plain"})[0] == 415
    assert visitor.edit("corrections", "", **{"content-length": str(MOST_BYTES + 1)})[0] == 413
    assert visitor.edit("corrections", "", **{"content-length": "-1"})[0] == 413
    assert not desk.kept
    for path in ("mask?frame=v99", "mask", "picture?frame=v03&side=-1", "else", "../capture"):
        assert visitor.edit(path)[0] == 404, path


def test_strangers_get_nothing(visitor: Visitor, desk: Desk):
    for key in ("", "x", visitor.key[:-1]):
        assert visitor.ask(f"/edit/{key}/capture")[0] == 404, key
    assert visitor.edit("capture", host="evil.example")[0] == 421
    assert visitor.ask("/masks.html", host="evil.example")[0] == 421
    assert visitor.edit("corrections", NOTHING, origin="http://evil.example")[0] == 403
    assert visitor.edit("finish", MARKED, origin="http://evil.example")[0] == 403
    assert not desk.kept
    assert not desk.done.is_set()
    own = f"http://127.0.0.1:{visitor.parts.port}"
    assert visitor.edit("finish", MARKED, origin=own)[0] == 200
    assert desk.done.wait(10.0)


@pytest.mark.slow
def test_corrections_that_are_overtaken_are_not_drawn():
    one = editing()
    with one._drawing:
        outcomes: list[object] = []

        def ask() -> None:
            try:
                outcomes.append(one.apply(corrections_from(MARKED)))
            except Superseded as error:
                outcomes.append(error)

        first = threading.Thread(target=ask)
        first.start()
        while one._asked < 1:
            pass
        second = threading.Thread(target=ask)
        second.start()
        while one._asked < 2:
            pass
    first.join()
    second.join()
    assert sorted(type(each).__name__ for each in outcomes) == ["EditedMasks", "Superseded"]


@pytest.mark.slow
def test_the_session_ends_with_the_page_and_tells_where_it_is(pages: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("DISPLAY", ":0")
    told: list[str] = []
    kept: list[object] = []

    def open_page(url: str) -> None:
        threading.Thread(target=lambda: Visitor(url).edit("finish", MARKED)).start()

    done = correct_masks(
        editing(), (), kept.append, command="c", tell=told.append, open_page=open_page, pages=pages
    )
    assert done
    assert kept == [corrections_from(MARKED)]
    assert any("http://127.0.0.1:" in text for text in told)


def test_without_pages_it_says_how_they_are_built(tmp_path: Path):
    with pytest.raises(UsageError, match=r"run\.pages_not_built.*make pages"):
        correct_masks(editing(), (), lambda _: None, command="", tell=lambda _: None, pages=tmp_path)


def test_corrections_of_another_capture_are_refused_before_anything_is_served(pages: Path):
    other = [Correction(frame="elsewhere", is_object=True, points=((1.0, 1.0),), radius=2.0)]
    with pytest.raises(UsageError, match=r"config\.corrections_invalid.*elsewhere"):
        correct_masks(editing(), other, lambda _: None, command="", tell=lambda _: None, pages=pages)

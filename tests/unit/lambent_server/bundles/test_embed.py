"""The page of a share link, and reads of its bundle from pages of other origins."""

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import lambent_pages
import pytest
from lambent_server.core.clock import now
from lambent_server.database.schema import scenes
from lambent_server.database.tenancy import add
from lambent_server.maintenance.housekeeping import ENDED_SHARE_S, sweep
from support.api import TENANT, Api, expect, expect_problem, opened
from support.server_rows import add_bundle

NAME = '<script>alert("1")</script> & \\1'
SHOP = "https://shop.example"
BUILT = """<html><head><title>Lambent: a shared object</title>
<script type="module" src="./assets/embed-1a2b.js"></script></head></html>"""


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("api") / "data") as api:
        folder = tmp_path_factory.mktemp("files")
        files = {"manifest.json": b"{}", "preview/photo_a.png": b"photo", "preview/a.png": b"a"}
        add_bundle(api, folder, files, bundle_id="bundle_shown", scene_id="scene_named")
        add_bundle(api, folder, files | {"poster.webp": b"poster"}, bundle_id="bundle_poster")
        add_bundle(api, folder, {"manifest.json": b"{}"}, bundle_id="bundle_bare")
        with api.services.database.write() as connection:
            values = {"id": "scene_named", "name": NAME, "created_at": now()}
            connection.execute(add(TENANT, scenes, **_scene(values)))
        yield api


def _scene(values: dict) -> dict:
    """Return a row of a scene with a value in every column that needs one."""
    needed = [each for each in scenes.columns if not each.nullable and each.default is None]
    missing = {each.name for each in needed} - set(values) - {"tenant_id"}
    return values | {name: "" if scenes.c[name].type.python_type is str else 0 for name in missing}


@pytest.fixture(autouse=True)
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "shared.html").write_text(BUILT)
    monkeypatch.setattr(lambent_pages, "embed_page", partial(lambent_pages.embed_page, folder=tmp_path))


def make(api: Api, bundle_id: str = "bundle_shown", **body: object) -> tuple[dict, str]:
    """Return a share and its secret."""
    share = expect(api.post(f"/v1/bundles/{bundle_id}/shares", json=body), 201)
    return share, share["url"].partition("#")[2]


def ancestors(response) -> str:
    """Return who may frame a response."""
    policies = response.headers["content-security-policy"].split(";")
    (found,) = [each.strip() for each in policies if each.strip().startswith("frame-ancestors")]
    return found.removeprefix("frame-ancestors ")


def test_only_the_named_origins_may_frame_a_link(api: Api):
    both = [SHOP, "http://localhost:8080"]
    share, _ = make(api, frame_ancestors=both)
    assert share["frame_ancestors"] == both
    page = api.other(None).get(f"/embed/{share['id']}")
    expect_page(page, 200)
    assert ancestors(page) == " ".join(both)
    assert page.headers["cross-origin-resource-policy"] == "cross-origin"
    assert page.headers["cross-origin-embedder-policy"] == "require-corp"
    assert 'src="../assets/embed-1a2b.js"' in page.text
    listed = expect(api.get("/v1/bundles/bundle_shown/shares"), 200)["items"]
    assert [each["frame_ancestors"] for each in listed if each["id"] == share["id"]] == [both]


def expect_page(response, status: int) -> None:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "text/html; charset=utf-8"
    assert response.headers["cache-control"] == "no-store"


def test_a_link_may_not_be_framed_unless_asked_for(api: Api):
    share, _ = make(api)
    page = api.other(None).get(f"/embed/{share['id']}")
    assert ancestors(page) == "'none'"
    assert page.headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize(
    "text", ["*", "https://shop.example; script-src *", "https://shop.example/", 7, None]
)
def test_what_is_no_origin_is_refused(api: Api, text: object):
    answer = api.post("/v1/bundles/bundle_shown/shares", json={"frame_ancestors": [SHOP, text]})
    problem = expect_problem(answer, 422, "invalid_request")
    assert problem["errors"][0]["pointer"] == "#/frame_ancestors/1"


def test_a_link_has_at_most_twenty_origins(api: Api):
    many = [f"https://shop{place}.example" for place in range(21)]
    expect_problem(
        api.post("/v1/bundles/bundle_shown/shares", json={"frame_ancestors": many}), 422, "invalid_request"
    )
    expect(api.post("/v1/bundles/bundle_shown/shares", json={"frame_ancestors": many[:20]}), 201)


def test_the_page_names_its_object_and_escapes_the_name(api: Api):
    share, token = make(api)
    page = api.other(None).get(f"/embed/{share['id']}").text
    escaped = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; \\1"
    assert f"<title>{escaped}</title>" in page
    assert f'<meta property="og:title" content="{escaped}" />' in page
    assert "alert(" not in page.replace(escaped, "")
    picture = f"http://localhost/embed/{share['id']}/picture"
    assert f'<meta property="og:image" content="{picture}" />' in page
    assert '<meta name="lambent-bundle" content="bundle_shown" />' in page
    assert token.partition(".")[2] not in page


def test_the_picture_is_a_rendering_or_the_poster(api: Api):
    visitor = api.other(None)
    rendered, _ = make(api)
    answer = visitor.get(f"/embed/{rendered['id']}/picture")
    assert (answer.content, answer.headers["content-type"]) == (b"a", "image/png")
    assert answer.headers["cross-origin-resource-policy"] == "cross-origin"
    assert "sandbox" in answer.headers["content-security-policy"]
    poster, _ = make(api, "bundle_poster")
    answer = visitor.get(f"/embed/{poster['id']}/picture")
    assert (answer.content, answer.headers["content-type"]) == (b"poster", "image/webp")
    bare, _ = make(api, "bundle_bare")
    assert visitor.get(f"/embed/{bare['id']}/picture").status_code == 404
    page = visitor.get(f"/embed/{bare['id']}").text
    assert "og:image" not in page
    assert "<title>A relightable object</title>" in page


def test_of_two_posters_a_list_shows_the_small_one_and_a_link_the_large_one(api: Api, tmp_path: Path):
    files = {"manifest.json": b"{}", "thumbnail.webp": b"small", "poster.webp": b"large"}
    add_bundle(api, tmp_path, files, bundle_id="bundle_two_posters")
    share, _ = make(api, "bundle_two_posters")
    assert api.other(None).get(f"/embed/{share['id']}/picture").content == b"large"
    shown = expect(api.get("/v1/bundles/bundle_two_posters"), 200)["thumbnail_url"]
    assert api.get(shown).content == b"small"


def test_after_its_end_a_link_shows_neither_name_nor_picture(api: Api, monkeypatch: pytest.MonkeyPatch):
    visitor = api.other(None)
    revoked, _ = make(api, frame_ancestors=[SHOP])
    expect(api.delete(f"/v1/shares/{revoked['id']}"), 204)
    expired, _ = make(api, expires_in_s=60)
    for module in ("accounts.shares", "maintenance.housekeeping"):
        monkeypatch.setattr(f"lambent_server.{module}.now", lambda: time.time() + 61)
    sweep(api.services)
    for share in (revoked, expired):
        page = visitor.get(f"/embed/{share['id']}")
        expect_page(page, 410)
        assert "og:" not in page.text
        assert "lambent-bundle" not in page.text
        assert visitor.get(f"/embed/{share['id']}/picture").status_code == 404
    # The page that tells so stays in the frame.
    assert ancestors(visitor.get(f"/embed/{revoked['id']}")) == SHOP
    month = ENDED_SHARE_S + 62
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.now", lambda: time.time() + month)
    sweep(api.services)
    for unknown in (expired["id"], "share_nobody"):
        page = visitor.get(f"/embed/{unknown}")
        assert (page.status_code, page.headers["content-type"]) == (404, "text/html; charset=utf-8")
        assert "There is no such page" in page.text


def test_the_address_of_the_page_opens_no_bundle(api: Api):
    share, token = make(api, frame_ancestors=[SHOP])
    for wrong in (share["id"], f"{share['id']}.{'0' * 64}", token[:-1]):
        answer = api.other(None).get(
            "/v1/bundles/bundle_shown/manifest", headers={"authorization": f"Bearer {wrong}"}
        )
        expect_problem(answer, 401, "not_authenticated")


def read(api: Api, token: str, path: str = "/v1/bundles/bundle_shown/manifest", **headers: str):
    """Return the answer to a reader that sends the secret of a link in a header."""
    return api.other(None).get(path, headers={"authorization": f"Bearer {token}", **headers})


def test_the_secret_reads_its_bundle_from_a_header_and_nothing_else(api: Api):
    share, token = make(api)
    answer = read(api, token)
    expect(answer, 200)
    # Or the browser would continue showing what it has kept after the link was revoked.
    assert answer.headers["cache-control"] == "private, no-cache"
    for path in ("/v1/bundles/bundle_bare/manifest", "/v1/bundles/bundle_shown", "/v1/bundles", "/v1/jobs"):
        expect_problem(read(api, token, path), 401, "not_authenticated")
    expect(api.delete(f"/v1/shares/{share['id']}"), 204)
    expect_problem(read(api, token), 401, "not_authenticated")


def test_scripts_of_a_named_origin_may_read_and_no_others(api: Api):
    _, token = make(api, frame_ancestors=[SHOP])
    allowed = read(api, token, origin=SHOP)
    assert allowed.headers["access-control-allow-origin"] == SHOP
    assert "origin" in allowed.headers["vary"].lower()
    for origin in (
        "https://evil.example",
        "https://shop.example.evil.example",
        "null",
        "http://shop.example",
    ):
        assert "access-control-allow-origin" not in read(api, token, origin=origin).headers
    _, closed = make(api)
    assert "access-control-allow-origin" not in read(api, closed, origin=SHOP).headers
    # A visitor's own login is nothing that other pages may use.
    assert (
        "access-control-allow-origin"
        not in api.get("/v1/bundles/bundle_shown/manifest", headers={"origin": SHOP}).headers
    )


def preflight(api: Api, path: str, origin: str = SHOP, method: str = "GET"):
    """Return the answer to a browser that asks whether a page may read."""
    headers = {"origin": origin, "access-control-request-method": method}
    return api.other(None).request("options", path, headers=headers)


def test_a_browser_learns_before_it_reads_which_origins_may(api: Api):
    path = "/v1/bundles/bundle_poster/files/poster.webp"
    assert "access-control-allow-origin" not in preflight(api, path).headers
    share, _ = make(api, "bundle_poster", frame_ancestors=[SHOP])
    answer = preflight(api, path)
    assert answer.status_code == 204
    assert answer.headers["access-control-allow-origin"] == SHOP
    assert "authorization" in answer.headers["access-control-allow-headers"]
    assert "access-control-allow-credentials" not in answer.headers
    assert "access-control-allow-origin" not in preflight(api, path, "https://evil.example").headers
    expect_problem(preflight(api, path, method="DELETE"), 401, "not_authenticated")
    expect_problem(preflight(api, "/v1/bundles/bundle_poster"), 401, "not_authenticated")
    expect(api.delete(f"/v1/shares/{share['id']}"), 204)
    # Otherwise its page could not learn that the link has ended.
    assert preflight(api, path).headers["access-control-allow-origin"] == SHOP
    assert "access-control-allow-origin" not in preflight(api, path, "https://evil.example").headers


@pytest.mark.parametrize("end", ["revoked", "expired"])
def test_pages_that_a_link_names_can_read_that_it_has_ended_and_others_nothing(
    api: Api, monkeypatch: pytest.MonkeyPatch, end: str
):
    share, token = make(api, frame_ancestors=[SHOP], expires_in_s=60)
    _, other = make(api, frame_ancestors=["https://other.example"])
    if end == "revoked":
        expect(api.delete(f"/v1/shares/{share['id']}"), 204)
    else:
        monkeypatch.setattr("lambent_server.accounts.shares.now", lambda: time.time() + 61)
    path = "/v1/bundles/bundle_shown/files/preview/a.png"
    for asked in ("/v1/bundles/bundle_shown/manifest", path):
        answer = read(api, token, asked, origin=SHOP)
        expect_problem(answer, 401, "not_authenticated")
        assert answer.headers["access-control-allow-origin"] == SHOP
        assert "origin" in answer.headers["vary"].lower()
        assert "access-control-allow-credentials" not in answer.headers
        assert preflight(api, asked).headers["access-control-allow-origin"] == SHOP
    forged = f"{token[:-1]}{'0' if token[-1] != '0' else '1'}"
    silent = [
        read(api, token, origin="https://evil.example"),
        read(api, token, origin="https://other.example"),
        # Links to others, and secrets that are none.
        read(api, other, origin=SHOP),
        read(api, forged, origin=SHOP),
        read(api, token, "/v1/bundles/bundle_bare/manifest", origin=SHOP),
        read(api, token, "/v1/bundles", origin=SHOP),
        api.other(None).get(path, headers={"origin": SHOP}),
        preflight(api, path, "https://evil.example"),
    ]
    for answer in silent:
        assert "access-control-allow-origin" not in answer.headers


def test_the_scripts_of_the_element_may_be_read_from_anywhere(tmp_path: Path):
    (tmp_path / "assets").mkdir()
    for name in ("lambent-viewer.js", "assets/element-1a2b.js", "viewer.html"):
        (tmp_path / name).write_text("1")

    def allowed(name: str) -> str | None:
        page = lambent_pages.find(name, tmp_path)
        assert page is not None
        return page.headers.get("access-control-allow-origin")

    assert allowed("lambent-viewer.js") == "*"
    assert allowed("assets/element-1a2b.js") == "*"
    assert allowed("viewer.html") is None

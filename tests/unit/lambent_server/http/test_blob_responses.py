"""Responses with a file of which the server has a compressed copy."""

import gzip
from pathlib import Path

import pytest
from lambent_server.accounts import shares
from lambent_server.api.problems import Problem
from lambent_server.database.schema import bundle_files
from lambent_server.http.blob_responses import parse_range
from lambent_server.maintenance.compression import Compressor
from sqlalchemy import select
from support.api import TENANT, Api, served, sha256
from support.server_rows import add_bundle

PLANES = bytes(range(200)) * 400
OWN, PACKED = f'"{sha256(PLANES)}"', f'"{sha256(PLANES)}-gzip"'
SITE = "https://shop.example"


api = served(scope="module")


@pytest.fixture(scope="module")
def url(api: Api, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the address of a file that has a compressed copy."""
    files = {"manifest.json": b'{"name": "x"}' * 100, "planes.bin": PLANES}
    bundle = add_bundle(api, tmp_path_factory.mktemp("files"), files)
    assert Compressor(api.services, lambda: True).turn() == 2
    return f"/v1/bundles/{bundle}/files/planes.bin"


def raw(api: Api, url: str, method: str = "GET", **headers: str):
    """Return an answer with its body as it was sent; without Accept-Encoding unless `headers` has one."""
    named = {name.replace("_", "-"): value for name, value in {"accept_encoding": "", **headers}.items()}
    with api.stream(method, url, headers=named) as answer:
        answer.sent = b"".join(answer.iter_raw())
    return answer


@pytest.mark.parametrize("accepted", ["gzip", "br, gzip;q=0.5", "*"])
def test_who_accepts_gzip_gets_the_compressed_copy(api: Api, url: str, accepted: str):
    answer = raw(api, url, accept_encoding=accepted)
    assert answer.status_code == 200
    assert answer.headers["content-encoding"] == "gzip"
    assert gzip.decompress(answer.sent) == PLANES
    assert answer.headers["content-length"] == str(len(answer.sent))
    assert len(answer.sent) < len(PLANES) / 10
    assert answer.headers["etag"] == PACKED
    assert answer.headers["vary"] == "accept-encoding"
    # What every client of ours gets: the decoded bytes.
    assert api.get(url, headers={"accept-encoding": accepted}).content == PLANES


@pytest.mark.parametrize("accepted", ["", "identity", "br", "gzip;q=0", "br;q=1, gzip;q=0.000"])
def test_who_does_not_accept_gzip_gets_the_bytes_themselves(api: Api, url: str, accepted: str):
    answer = raw(api, url, accept_encoding=accepted)
    assert "content-encoding" not in answer.headers
    assert (answer.sent, answer.headers["etag"]) == (PLANES, OWN)
    assert answer.headers["vary"] == "accept-encoding"


def test_a_manifest_is_compressed_too(api: Api, url: str):
    manifest = f"{url.rpartition('/files/')[0]}/manifest"
    answer = raw(api, manifest, accept_encoding="gzip")
    assert gzip.decompress(answer.sent) == b'{"name": "x"}' * 100
    assert answer.headers["content-type"] == "application/json"


def test_a_range_is_of_the_bytes_themselves(api: Api, url: str):
    for if_range in ({}, {"if_range": OWN}):
        answer = raw(api, url, accept_encoding="gzip", range="bytes=10-19", **if_range)
        assert (answer.status_code, answer.sent) == (206, PLANES[10:20])
        assert "content-encoding" not in answer.headers
        assert answer.headers["content-range"] == f"bytes 10-19/{len(PLANES)}"
        assert (answer.headers["etag"], answer.headers["vary"]) == (OWN, "accept-encoding")


@pytest.mark.parametrize(
    "given", [{"range": "bytes=10-19", "if_range": PACKED}, {"range": "bytes=5-4"}, {"range": "lines=1-2"}]
)
def test_a_range_that_is_not_answered_gives_the_whole_compressed(api: Api, url: str, given: dict[str, str]):
    answer = raw(api, url, accept_encoding="gzip", **given)
    assert (answer.status_code, answer.headers["etag"]) == (200, PACKED)
    assert gzip.decompress(answer.sent) == PLANES


@pytest.mark.parametrize("tag", [OWN, PACKED, f'"x", W/{PACKED}'])
def test_a_client_that_has_either_representation_is_told_so(api: Api, url: str, tag: str):
    answer = raw(api, url, accept_encoding="gzip", if_none_match=tag)
    assert (answer.status_code, answer.sent) == (304, b"")
    assert answer.headers["etag"] in tag
    assert answer.headers["vary"] == "accept-encoding"


def test_a_compressed_copy_is_of_no_use_to_who_does_not_accept_it(api: Api, url: str):
    answer = raw(api, url, if_none_match=PACKED)
    assert (answer.status_code, answer.sent) == (200, PLANES)
    assert raw(api, url, if_none_match=OWN).status_code == 304


@pytest.mark.parametrize("accepted", ["gzip", ""])
def test_a_head_has_the_headers_of_the_whole_file(api: Api, url: str, accepted: str):
    whole = raw(api, url, accept_encoding=accepted)
    for more in ({}, {"range": "bytes=10-19"}):
        head = raw(api, url, "HEAD", accept_encoding=accepted, **more)
        assert (head.status_code, head.sent) == (200, b"")
        for name in ("etag", "content-length", "content-encoding", "vary", "cache-control", "content-type"):
            assert head.headers.get(name) == whole.headers.get(name), name


@pytest.mark.parametrize("left", [None, b"cut"])
def test_a_damaged_copy_is_not_sent(api: Api, url: str, left: bytes | None):
    copy = next((api.services.settings.data / "store" / "gzip").rglob(sha256(PLANES)))
    data = copy.read_bytes()
    copy.unlink()
    if left is not None:
        copy.write_bytes(left)
    for method, body in (("GET", PLANES), ("HEAD", b"")):
        answer = raw(api, url, method, accept_encoding="gzip")
        assert (answer.status_code, answer.sent) == (200, body)
        assert answer.headers["etag"] == OWN
        assert answer.headers["content-length"] == str(len(PLANES))
        assert "content-encoding" not in answer.headers
    copy.write_bytes(data)


def test_pages_elsewhere_and_share_links_get_compressed_files_too(api: Api, url: str):
    with api.services.database.write() as connection:
        row = shares.create(connection, TENANT, "bundle_x", 60.0, [SITE])
    token = shares.sign(api.app.state.share_secret, row)
    answer = raw(api, url, accept_encoding="gzip", authorization=f"Bearer {token}", origin=SITE)
    assert gzip.decompress(answer.sent) == PLANES
    assert answer.headers["access-control-allow-origin"] == SITE
    assert answer.headers["vary"] == "accept-encoding, origin"
    assert answer.headers["cache-control"] == "private, no-cache"
    held = {"if_none_match": answer.headers["etag"], "authorization": f"Bearer {token}"}
    assert raw(api, url, accept_encoding="gzip", **held).status_code == 304


def test_what_is_not_known_yet_is_sent_as_it_is(api: Api, tmp_path: Path):
    bundle = add_bundle(api, tmp_path, {"new.bin": PLANES + b"new"}, bundle_id="bundle_new")
    with api.services.database.read() as connection:
        column = select(bundle_files.c.gzip_bytes).where(bundle_files.c.bundle_id == bundle)
        assert connection.execute(column).scalar_one() is None
    answer = raw(api, f"/v1/bundles/{bundle}/files/new.bin", accept_encoding="gzip")
    assert answer.sent == PLANES + b"new"


def test_an_empty_file_has_no_part():
    assert parse_range("bytes=0-", 1) == (0, 1)
    with pytest.raises(Problem):
        parse_range("bytes=0-", 0)

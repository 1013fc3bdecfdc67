"""The built pages: which file an address names, and the headers it is sent with."""

import base64
import hashlib
import os
import re
from pathlib import Path

import lambent_pages
import pytest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder as the build makes it, and a secret beside it."""
    (tmp_path / "secret.html").write_text("secret")
    dist = tmp_path / "dist"
    (dist / "assets").mkdir(parents=True)
    (dist / "jobs.html").write_text("<title>jobs</title>")
    (dist / "viewer.html").write_text("<title>viewer</title>")
    for script in ("jobs-1a2b.js", "refineWorker-3c-4D_.js"):
        (dist / "assets" / script).write_text("1")
    (dist / "assets" / "infer-3c4d.wasm").write_bytes(b"\0asm")
    (dist / "assets" / "notes.md").write_text("not for browsers")
    return dist


def test_a_name_with_a_hash_is_kept_and_a_page_is_asked_for_again(folder: Path):
    script = lambent_pages.find("assets/jobs-1a2b.js", folder)
    page = lambent_pages.find("jobs.html", folder)
    assert script is not None
    assert page is not None
    assert script.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert script.headers["content-type"].startswith("text/javascript")
    assert page.headers["cache-control"] == "no-cache"
    assert page.content == b"<title>jobs</title>"


def test_an_etag_changes_with_the_file_and_answers_for_it(folder: Path):
    before = lambent_pages.find("jobs.html", folder)
    assert before is not None
    (folder / "jobs.html").write_text("<title>other</title>")
    after = lambent_pages.find("jobs.html", folder)
    assert after is not None
    assert lambent_pages.is_named(before.headers["etag"], f'"x", W/{before.headers["etag"]}')
    assert not lambent_pages.is_named(after.headers["etag"], before.headers["etag"])
    assert not lambent_pages.is_named(after.headers["etag"], None)


@pytest.mark.parametrize(
    "path",
    [
        "",
        "../secret.html",
        "assets/../../secret.html",
        "/etc/passwd",
        "assets",
        "assets/",
        "assets/notes.md",
        "./jobs.html",
        "jobs.html/",
        "assets\\jobs-1a2b.js",
        "nothing.html",
        "jobs.html\0",
    ],
)
def test_nothing_but_files_of_the_pages_is_found(folder: Path, path: str):
    assert lambent_pages.find(path, folder) is None


def test_only_the_worker_that_runs_networks_may_compile_webassembly(folder: Path):
    (folder / "shared.html").write_text("<title>shared</title>")
    pages = {
        **{path: lambent_pages.find(path, folder) for path in ("jobs.html", "viewer.html")},
        **{
            path.name: lambent_pages.find(f"assets/{path.name}", folder)
            for path in folder.glob("assets/*.js")
        },
        "shared": lambent_pages.embed_page("", ["https://shop.example"], folder),
    }
    for name, page in pages.items():
        assert page is not None
        policy = page.headers["content-security-policy"]
        assert ("'wasm-unsafe-eval'" in policy) == name.startswith("refineWorker-")
        assert "unsafe-inline" not in policy
        assert "'unsafe-eval'" not in policy
        assert "http" not in policy.replace("frame-ancestors https://shop.example", "")
        assert policy.startswith("default-src 'none';")


def test_pages_that_are_not_there_are_explained(folder: Path):
    assert lambent_pages.are_built(folder)
    (folder / "viewer.html").unlink()
    assert not lambent_pages.are_built(folder)
    page = lambent_pages.not_built()
    assert b"make pages" in page.content
    assert b"<script" not in page.content
    assert page.headers["cache-control"] == "no-store"


@pytest.mark.parametrize("make", [lambent_pages.not_found, lambent_pages.not_built])
def test_the_policy_of_a_page_without_the_build_allows_its_own_style_and_nothing_else(make):
    page = make()
    [style] = re.findall(rb"<style>(.*?)</style>", page.content, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(style).digest()).decode()
    policy = page.headers["content-security-policy"]
    assert f"style-src 'sha256-{digest}';" in policy
    assert "unsafe" not in policy
    # Attributes are not covered by the hash.
    assert b"style=" not in page.content


def test_a_compressed_copy_is_found_where_the_browser_takes_it(folder: Path):
    script = folder / "assets" / "jobs-1a2b.js"
    for suffix in (".br", ".gz"):
        script.with_name(script.name + suffix).write_bytes(suffix.encode())

    def encoding(header: str | None) -> str | None:
        page = lambent_pages.find("assets/jobs-1a2b.js", folder, accept_encoding=header)
        assert page is not None
        assert page.headers["vary"] == "accept-encoding"
        assert page.headers["content-type"].startswith("text/javascript")
        name = page.headers.get("content-encoding")
        assert page.content == {None: b"1", "br": b".br", "gzip": b".gz"}[name]
        return name

    assert encoding("gzip, deflate, br, zstd") == "br"
    assert encoding("gzip;q=0.5") == "gzip"
    assert encoding("br;q=0, GZIP") == "gzip"
    assert encoding("*;q=0.1, br;q=0.000") == "gzip"
    for header in (None, "", "identity", "deflate", "br;q=0, gzip;q=0.0", "br;q=x, gzip;q=-1"):
        assert encoding(header) is None


def test_a_copy_of_an_earlier_build_is_not_sent(folder: Path):
    script = folder / "assets" / "jobs-1a2b.js"
    copy = script.with_name(script.name + ".br")
    copy.write_bytes(b"old")
    os.utime(copy, ns=(0, script.stat().st_mtime_ns - 1))
    page = lambent_pages.find("assets/jobs-1a2b.js", folder, accept_encoding="br")
    assert page is not None
    assert page.content == b"1"
    assert lambent_pages.find("assets/jobs-1a2b.js.br", folder) is None

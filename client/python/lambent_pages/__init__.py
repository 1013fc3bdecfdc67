"""The built web pages and their HTTP headers, for the server and for `lambent view`.

The build of client/web writes them to the folder `dist` next to this module; wheels contain it.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

FOLDER = Path(__file__).parent / "dist"
"""Output folder of the build."""

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".json": "application/json",
    ".wasm": "application/wasm",
    ".exr": "image/x-exr",
    ".hdr": "image/vnd.radiance",
}
# File names in this folder contain a hash of their contents.
_HASHED = "assets"
# The pages that compute in WebAssembly; workers have the policy of their own script.
_WITHOUT_WASM = frozenset({"jobs.html", "masks.html", "share.html"})
_SHARED_HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-embedder-policy": "require-corp",
    "cross-origin-resource-policy": "same-origin",
}


@dataclass(frozen=True, slots=True)
class PageFile:
    """One file of the pages: its bytes, and the names and values of its headers in lower case."""

    content: bytes
    headers: dict[str, str]


def content_policy(*, wasm: bool) -> str:
    """Return the Content-Security-Policy of a page: nothing inline, nothing from other origins.

    With `wasm` scripts may compile WebAssembly, which is not the same as evaluating text.
    """
    script = "'self' 'wasm-unsafe-eval'" if wasm else "'self'"
    return (
        f"default-src 'none'; script-src {script}; worker-src 'self'; style-src 'self'; "
        "img-src 'self' blob: data:; media-src 'self' blob:; connect-src 'self' blob: data:; "
        "font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def are_built(folder: Path = FOLDER) -> bool:
    """Return whether the build has been run."""
    return (folder / "jobs.html").is_file() and (folder / "viewer.html").is_file()


def find(path: str, folder: Path = FOLDER) -> PageFile | None:
    """Return the file at a relative address such as "assets/viewer-1a2b.js"; None where there is none.

    Files with a hash in their name never change and are cached for a year; everything else is revalidated
    with its ETag.
    """
    parts = path.split("/")
    if any(part in ("", ".", "..") or "\\" in part or "\0" in part for part in parts):
        return None
    place = folder.joinpath(*parts)
    if place.suffix not in _TYPES or not place.is_file():
        return None
    state = place.stat()
    return _read(place, parts[0] == _HASHED and len(parts) > 1, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=256)
def _read(place: Path, is_hashed: bool, _changed_at: int, _size: int) -> PageFile:
    content = place.read_bytes()
    caching = "public, max-age=31536000, immutable" if is_hashed else "no-cache"
    headers = {
        "content-type": _TYPES[place.suffix],
        "cache-control": caching,
        "etag": f'"{hashlib.sha256(content).hexdigest()}"',
        "content-security-policy": content_policy(wasm=place.name not in _WITHOUT_WASM),
        **_SHARED_HEADERS,
    }
    return PageFile(content, headers)


def is_current(page: PageFile, if_none_match: str | None) -> bool:
    """Return whether the If-None-Match of a request matches the file, so that the response is 304."""
    tags = {tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")}
    return page.headers["etag"] in tags or "*" in tags


def not_built() -> PageFile:
    """Return the page that is served with status 503 if the pages have not been built."""
    text = """<!doctype html>
<html lang="en">
  <head>
    <meta charset="utf-8" />
    <meta name="viewport" content="width=device-width, initial-scale=1" />
    <title>Lambent: the web pages are not built</title>
  </head>
  <body>
    <main>
      <h1>The web pages are not built</h1>
      <p>This copy of Lambent was installed from its sources, without the pages. Build them there:</p>
      <pre><code>make pages</code></pre>
      <p>That needs Node 20. Then load this page again. A released wheel contains them.</p>
      <p>All else works without them: <code>lambent jobs</code>, <code>lambent submit</code>, the interface
      under <code>/v1</code>.</p>
    </main>
  </body>
</html>
"""
    headers = {
        "content-type": _TYPES[".html"],
        "cache-control": "no-store",
        "content-security-policy": content_policy(wasm=False),
        **_SHARED_HEADERS,
    }
    return PageFile(text.encode(), headers)

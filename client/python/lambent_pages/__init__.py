"""The built web pages and their HTTP headers, for the server and for `lambent view`.

The build of client/web writes them to the folder `dist` next to this module; wheels contain it.
"""

import base64
import hashlib
import re
from collections.abc import Sequence
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
_ENCODINGS = {"br": ".br", "gzip": ".gz"}
"""Content codings that the build has written beside a file, the best first, and their suffixes."""
# File names in this folder contain a hash of their contents.
_HASHED = "assets"
# The element for other people's pages.
_ELEMENT = "lambent-viewer.js"
# The script that compiles WebAssembly: a worker, which has the policy of its own response.
_WITH_WASM = re.compile(r"refineWorker-[\w-]+\.js")
# Of pages that must not depend on the build; colours and sizes are those of client/web/src/page/page.css.
_PLAIN_STYLE = """
      :root { color-scheme: light dark; font: 16px / 1.5 system-ui, sans-serif; }
      body {
        margin: 0;
        padding: 0 1rem;
        background: light-dark(#faf8f5, #16130f);
        color: light-dark(#231f1a, #efe9e0);
      }
      main {
        max-width: 34rem;
        margin: 18vh auto 2rem;
        padding: 1.5rem;
        border: 1px solid light-dark(#ddd5ca, #423a31);
        border-radius: 0.6rem;
        background: light-dark(#ffffff, #211d18);
      }
      h1, p, pre { margin: 0 0 0.75rem; overflow-wrap: anywhere; }
      h1 { font-size: 1.6rem; line-height: 1.25; }
      :last-child { margin-bottom: 0; }
      a { color: light-dark(#95500a, #f0a850); }
    """
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


def content_policy(*, wasm: bool = False, frame_ancestors: Sequence[str] = (), style: str = "") -> str:
    """Return the Content-Security-Policy of a page: nothing inline but `style`, nothing from other origins.

    With `wasm` a worker whose script it comes with may compile WebAssembly. Only pages of the
    origins `frame_ancestors`, which must be valid, may show the page in a frame. `style` is the text of the
    page's only style element, which is allowed by its hash.
    """
    ancestors = " ".join(frame_ancestors) or "'none'"
    script = "'self' 'wasm-unsafe-eval'" if wasm else "'self'"
    styles = "'self'"
    if style:
        styles = f"'sha256-{base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()}'"
    return (
        f"default-src 'none'; script-src {script}; worker-src 'self'; style-src {styles}; "
        "img-src 'self' blob: data:; media-src 'self' blob:; connect-src 'self' blob: data:; "
        f"font-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors {ancestors}"
    )


def are_built(folder: Path = FOLDER) -> bool:
    """Return whether the build has been run."""
    return (folder / "jobs.html").is_file() and (folder / "viewer.html").is_file()


def accepted_encodings(header: str | None) -> list[str]:
    """Return those of our content codings that an Accept-Encoding header allows, the best first.

    Source: RFC 9110, 12.5.3.
    """
    weights = {}
    for item in (header or "").lower().split(","):
        name, *parameters = (part.strip() for part in item.split(";"))
        weight = next((part[2:] for part in parameters if part.startswith("q=")), "1")
        weights[name] = bool(re.fullmatch(r"1(\.0*)?|0\.0*[1-9]\d*", weight))
    return [name for name in _ENCODINGS if weights.get(name, weights.get("*", False))]


def find(path: str, folder: Path = FOLDER, *, accept_encoding: str | None = None) -> PageFile | None:
    """Return the file at a relative address such as "assets/viewer-1a2b.js"; None where there is none.

    Files with a hash in their name never change and are cached for a year; everything else is revalidated
    with its ETag. The content is compressed if `accept_encoding`, the request's header, allows a coding that
    the build has written.
    """
    parts = path.split("/")
    if any(part in ("", ".", "..") or "\\" in part or "\0" in part for part in parts):
        return None
    place = folder.joinpath(*parts)
    if place.suffix not in _TYPES or not place.is_file():
        return None
    changed_at = place.stat().st_mtime_ns
    source, encoding = place, ""
    for name in accepted_encodings(accept_encoding):
        packed = place.with_name(place.name + _ENCODINGS[name])
        # An older copy is that of an earlier build.
        if packed.is_file() and packed.stat().st_mtime_ns >= changed_at:
            source, encoding = packed, name
            break
    state = source.stat()
    is_hashed = parts[0] == _HASHED and len(parts) > 1
    return _read(place, source, encoding, is_hashed, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=256)
def _read(
    place: Path, source: Path, encoding: str, is_hashed: bool, _changed_at: int, _size: int
) -> PageFile:
    content = source.read_bytes()
    caching = "public, max-age=31536000, immutable" if is_hashed else "no-cache"
    headers = {
        "content-type": _TYPES[place.suffix],
        **({"content-encoding": encoding} if encoding else {}),
        "vary": "accept-encoding",
        "cache-control": caching,
        "etag": f'"{hashlib.sha256(content).hexdigest()}"',
        "content-security-policy": content_policy(
            wasm=is_hashed and _WITH_WASM.fullmatch(place.name) is not None
        ),
        **_SHARED_HEADERS,
    }
    if is_hashed or place.name == _ELEMENT:
        # Scripts of the element, which pages of other origins load; they contain no user's data.
        headers["access-control-allow-origin"] = "*"
    return PageFile(content, headers)


def embed_page(head: str, frame_ancestors: Sequence[str] = (), folder: Path = FOLDER) -> PageFile | None:
    """Return the page of a share link, to be served one folder below the pages; None before the build.

    `head` is HTML for its head, with its title. Pages of the origins `frame_ancestors` may show it.
    """
    page = find("shared.html", folder)
    if page is None:
        return None
    text = page.content.decode().replace('="./', '="../')
    if head:
        text = re.sub("<title>.*?</title>", lambda _: head, text, count=1)
    headers = {
        "content-type": _TYPES[".html"],
        "cache-control": "no-store",
        "content-security-policy": content_policy(frame_ancestors=frame_ancestors),
        **_SHARED_HEADERS,
    }
    if frame_ancestors:
        # Pages that isolate themselves frame only what says that others may.
        headers["cross-origin-resource-policy"] = "cross-origin"
    return PageFile(text.encode(), headers)


def is_named(etag: str, if_none_match: str | None) -> bool:
    """Return whether the If-None-Match of a request names an ETag, so that the response is 304."""
    tags = {tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")}
    return etag in tags or "*" in tags


def not_found() -> PageFile:
    """Return the page that a person is sent with status 404."""
    return _plain_page(
        "Lambent: there is no such page",
        """<h1>There is no such page</h1>
      <p>The address may have been cut off when it was copied.</p>
      <p><a href="/">Scenes, jobs and bundles</a></p>""",
    )


def not_built() -> PageFile:
    """Return the page that is served with status 503 if the pages have not been built."""
    return _plain_page(
        "Lambent: the web pages are not built",
        """<h1>The web pages are not built</h1>
      <p>This copy of Lambent was installed from its sources, without the pages. Build them there:</p>
      <pre><code>make pages</code></pre>
      <p>That needs Node 20. Then load this page again. A released wheel contains them.</p>
      <p>All else works without them: <code>lambent jobs</code>, <code>lambent submit</code>, the interface
      under <code>/v1</code>.</p>""",
    )


def _plain_page(title: str, body: str) -> PageFile:
    text = f"""<!doctype html>
<html lang="en">
  <head>
    <meta charset="utf-8" />
    <meta name="viewport" content="width=device-width, initial-scale=1" />
    <meta name="color-scheme" content="light dark" />
    <title>{title}</title>
    <style>{_PLAIN_STYLE}</style>
  </head>
  <body>
    <main>
      {body}
    </main>
  </body>
</html>
"""
    headers = {
        "content-type": _TYPES[".html"],
        "cache-control": "no-store",
        "content-security-policy": content_policy(style=_PLAIN_STYLE),
        **_SHARED_HEADERS,
    }
    return PageFile(text.encode(), headers)

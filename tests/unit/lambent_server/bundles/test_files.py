"""Bundles, blobs and environments over REST."""

import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from lambent_relight import load_environment, write_environment
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, sha256
from support.server_rows import add_bundle

WEIGHTS = bytes(range(256)) * 10


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("api") / "data") as api:
        yield api


@pytest.fixture(scope="module")
def bundle(api: Api, tmp_path_factory: pytest.TempPathFactory) -> str:
    files = {"manifest.json": b'{"name": "x"}', "models/weights.bin": WEIGHTS, "page.html": b"<script>"}
    return add_bundle(api, tmp_path_factory.mktemp("files"), files)


def test_a_bundle_is_read_by_manifest_and_files(api: Api, bundle: str):
    answer = api.get(f"/v1/bundles/{bundle}/manifest")
    assert expect(answer, 200) == {"name": "x"}
    assert answer.headers["content-type"] == "application/json"
    answer = api.get(f"/v1/bundles/{bundle}/files/models/weights.bin")
    assert answer.content == WEIGHTS
    assert answer.headers["etag"] == f'"{sha256(WEIGHTS)}"'
    assert answer.headers["content-length"] == str(len(WEIGHTS))


@pytest.mark.parametrize(
    ("given", "first", "last"),
    [
        ("bytes=0-9", 0, 9),
        ("bytes=100-", 100, 2559),
        ("bytes=-5", 2555, 2559),
        ("bytes=2550-9999", 2550, 2559),
    ],
)
def test_a_part_of_a_file_is_sent_with_its_place(api: Api, bundle: str, given: str, first: int, last: int):
    answer = api.get(f"/v1/bundles/{bundle}/files/models/weights.bin", headers={"range": given})
    assert answer.status_code == 206
    assert answer.content == WEIGHTS[first : last + 1]
    assert answer.headers["content-range"] == f"bytes {first}-{last}/2560"
    assert answer.headers["content-length"] == str(last - first + 1)


def test_a_part_outside_of_the_file_is_a_416(api: Api, bundle: str):
    url = f"/v1/bundles/{bundle}/files/models/weights.bin"
    for given in ("bytes=2560-", "bytes=9999-10000", "bytes=-0"):
        answer = api.get(url, headers={"range": given})
        expect_problem(answer, 416, "range_not_satisfiable")
        assert answer.headers["content-range"] == "bytes */2560"


def test_ranges_that_are_not_understood_give_the_whole_file(api: Api, bundle: str):
    url = f"/v1/bundles/{bundle}/files/models/weights.bin"
    for given in ("bytes=5-4", "bytes=0-1,3-4", "lines=1-2", "bytes=-", "bytes=a-b"):
        assert api.get(url, headers={"range": given}).content == WEIGHTS


def test_a_client_that_has_the_file_is_told_so(api: Api, bundle: str):
    url = f"/v1/bundles/{bundle}/files/models/weights.bin"
    etag = f'"{sha256(WEIGHTS)}"'
    for given in (etag, f'"x", W/{etag}', "*"):
        answer = api.get(url, headers={"if-none-match": given})
        assert (answer.status_code, answer.content) == (304, b"")
    assert api.get(url, headers={"if-none-match": '"x"'}).status_code == 200
    # A part is only worth something if the rest is of the same file.
    assert api.get(url, headers={"range": "bytes=0-1", "if-range": etag}).status_code == 206
    assert api.get(url, headers={"range": "bytes=0-1", "if-range": '"x"'}).status_code == 200


def test_what_a_run_made_is_never_a_page_of_this_site(api: Api, bundle: str):
    answer = api.get(f"/v1/bundles/{bundle}/files/page.html")
    assert "sandbox" in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_missing_bundles_and_files_are_404(api: Api, bundle: str):
    expect_problem(api.get("/v1/bundles/bundle_y/manifest"), 404, "bundle_not_found")
    expect_problem(api.get(f"/v1/bundles/{bundle}/files/models/none.bin"), 404, "file_not_found")
    expect_problem(api.get(f"/v1/bundles/{bundle}/files/../../../etc/passwd"), 404, "route_not_found")
    expect_problem(api.get(f"/v1/bundles/{bundle}/files/..%2f..%2fetc/passwd"), 404, "file_not_found")
    expect_problem(api.get(f"/v1/blobs/{'0' * 64}"), 404, "blob_not_found")
    stranger = api.other(STRANGER_KEY)
    expect_problem(stranger.get(f"/v1/bundles/{bundle}/manifest"), 404, "bundle_not_found")
    expect_problem(stranger.get(f"/v1/blobs/{sha256(WEIGHTS)}"), 404, "blob_not_found")


@pytest.mark.parametrize("left", [None, b"", b"will va", b"will vanish, or grow"])
def test_bytes_that_are_not_whole_any_more_are_an_error_until_they_are_sent_again(
    api: Api, tmp_path: Path, left: bytes | None
):
    data = b"will vanish"
    path = tmp_path / "x"
    path.write_bytes(data)
    put = partial(api.services.store.put_file, api.services.database.write, TENANT)
    put(path, sha256(data), "text/plain")
    stored = damage(api, data, left)
    for headers in ({}, {"range": "bytes=8-9"}, {"range": "bytes=0-1"}):
        answer = api.get(f"/v1/blobs/{sha256(data)}", headers=headers)
        assert "send the file again" in expect_problem(answer, 410, "blob_damaged")["detail"]
        assert answer.headers["cache-control"] == "no-store"
    assert not put(path, sha256(data), "text/plain")
    assert stored.read_bytes() == data
    assert api.get(f"/v1/blobs/{sha256(data)}").content == data


def test_an_upload_plan_asks_for_what_is_damaged_and_the_upload_repairs_it(api: Api):
    files = {name: name.encode() * 3 for name in ("a.json", "b.json", "c.json")}
    api.scene(files)
    damage(api, files["a.json"], None)
    damage(api, files["b.json"], b"a.j")
    scene = expect(api.post("/v1/scenes", json={"name": "again"}), 201)["id"]
    plan = [{"path": path, "size": len(data), "sha256": sha256(data)} for path, data in files.items()]
    missing = expect(api.post(f"/v1/scenes/{scene}/files:plan", json=plan), 200)["missing"]
    assert missing == sorted(sha256(files[name]) for name in ("a.json", "b.json"))
    # What has the right size is looked into when it is sent again.
    stored = damage(api, files["c.json"], b"x" * len(files["c.json"]))
    for data in files.values():
        expect(api.put(f"/v1/scenes/{scene}/files/{sha256(data)}", content=data), 204)
    assert expect(api.post(f"/v1/scenes/{scene}/files:plan", json=plan), 200)["missing"] == []
    assert stored.read_bytes() == files["c.json"]


def damage(api: Api, data: bytes, left: bytes | None) -> Path:
    """Leave something else of a blob in the store, or nothing, and return where it is."""
    path = next((api.services.settings.data / "store").rglob(sha256(data)))
    path.unlink()
    if left is not None:
        path.write_bytes(left)
    return path


def exr(width: int, height: int, channels: tuple[str, ...] = ("B", "G", "R"), flags: int = 0) -> bytes:
    """Return the head of an OpenEXR file."""

    def attribute(name: str, kind: str, data: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data

    listed = b"".join(name.encode() + b"\0" + struct.pack("<iiii", 1, 0, 1, 1) for name in channels) + b"\0"
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = b"\x76\x2f\x31\x01" + struct.pack("<i", 2 | flags)
    head += attribute("channels", "chlist", listed) + attribute("dataWindow", "box2i", window)
    return head + b"\0" + b"\0" * 100


HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n" + b"\0" * 100


def test_environments_are_kept_and_listed(api: Api):
    sent = {"sky.exr": exr(64, 32), "sun.hdr": HDR}
    made = [
        expect(api.post("/v1/environments", params={"name": name}, content=data), 201)
        for name, data in sent.items()
    ]
    heads = [(each["format"], each["width"], each["height"]) for each in made]
    assert heads == [("exr", 64, 32), ("hdr", 32, 16)]
    assert expect(api.get("/v1/environments"), 200)["items"] == made[::-1]
    assert api.get(made[1]["url"]).content == HDR
    assert api.get(made[1]["url"]).headers["content-type"] == "image/vnd.radiance"


def test_maps_that_relighting_reads_are_taken(api: Api, tmp_path: Path):
    """One pixel, and colour in the second of two parts, are as good here as on the user's own machine."""
    write_environment(tmp_path / "dot.exr", np.ones((1, 1, 3), np.float32))
    depth = OpenEXR.Part({}, {"Z": np.zeros((4, 8), np.float32)}, "depth")
    colour = OpenEXR.Part({}, {name: np.ones((4, 8), np.float32) for name in "RGB"}, "colour")
    OpenEXR.File([depth, colour]).write(str(tmp_path / "parts.exr"))
    for name, size in {"dot.exr": (1, 1), "parts.exr": (8, 4)}.items():
        assert load_environment(tmp_path / name).radiance.shape == (*size[::-1], 3)
        content = (tmp_path / name).read_bytes()
        made = expect(api.post("/v1/environments", params={"name": name}, content=content), 201)
        assert (made["width"], made["height"]) == size


def test_parts_without_colour_and_deep_parts_are_refused(api: Api, tmp_path: Path):
    depth = {"Z": np.zeros((4, 8), np.float32)}
    flat = [OpenEXR.Part({}, depth, name) for name in ("near", "far")]
    OpenEXR.File(flat).write(str(tmp_path / "flat.exr"))
    samples = np.empty((4, 8), dtype=object)
    for place in np.ndindex(4, 8):
        samples[place] = np.ones(2, np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    deep = OpenEXR.Part(header, {name: samples.copy() for name in "RGB"}, "deep")
    OpenEXR.File([flat[0], deep]).write(str(tmp_path / "deep.exr"))
    for name, word in (("flat", "in one part"), ("deep", "deep pictures")):
        content = (tmp_path / f"{name}.exr").read_bytes()
        answer = api.post("/v1/environments", params={"name": name}, content=content)
        assert word in expect_problem(answer, 422, "environment_invalid")["detail"]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x89PNG\r\n",
        exr(0, 0),
        exr(2**30, 2**30),
        exr(-5, 10),
        exr(64, 32, channels=("Y",)),
        exr(16384, 4096, channels=("B", "G", "R", *map(str, range(9)))),
        exr(64, 32, flags=0x800),
        exr(64, 32, flags=0x1000)[:-101] + b"\xff" * 9,
        exr(64, 32, channels=("Z",), flags=0x1000),
        exr(64, 32)[:40],
        b"\x76\x2f\x31\x01" + b"\xff" * 1000,
        b"#?RADIANCE\n\n-Y 99999999 +X 99999999\n",
        b"#?RADIANCE\n\n+X 32 -X 16\n",
        b"#?RADIANCE\nno size",
    ],
)
def test_what_is_no_environment_is_refused_by_its_head(api: Api, data: bytes):
    answer = api.post("/v1/environments", params={"name": "x"}, content=data)
    expect_problem(answer, 422, "environment_invalid")


def test_a_radiance_file_stored_by_columns_has_its_width_and_height(api: Api):
    data = b"#?RADIANCE\n\n+X 32 -Y 16\n" + b"\0" * 2048
    sent = api.post("/v1/environments", params={"name": "turned"}, content=data)
    assert sent.status_code == 201
    assert (sent.json()["width"], sent.json()["height"]) == (32, 16)

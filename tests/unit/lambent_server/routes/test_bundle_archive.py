"""A bundle as one download."""

import asyncio
import io
import shutil
import subprocess
import zipfile
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from fastapi.responses import StreamingResponse
from lambent_relight import load_bundle
from lambent_server.bundles.file_routes import get_bundle_archive
from lambent_server.database.schema import bundle_files, scenes
from lambent_server.database.tenancy import change
from support.api import STRANGER_KEY, TENANT, Api, expect_problem, served, sha256
from support.baked_bundle import write_baked_bundle
from support.server_rows import add_bundle

api = served(scope="module")


@pytest.fixture(scope="module")
def bundle(api: Api, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = write_baked_bundle(tmp_path_factory.mktemp("b") / "boxes")
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*")}
    scene_id = api.scene()
    with api.services.database.write() as connection:
        connection.execute(change(TENANT, scenes).where(scenes.c.id == scene_id).values(name="Ein Bär: 1/2"))
    return add_bundle(api, tmp_path_factory.mktemp("files"), files, scene_id=scene_id)


def test_the_client_opens_the_archive_as_it_is(api: Api, bundle: str, tmp_path: Path):
    answer = api.get(f"/v1/bundles/{bundle}/archive")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/zip"
    assert answer.headers["content-length"] == str(len(answer.content))
    assert answer.headers["content-disposition"].endswith("''Ein%20B%C3%A4r_%201_2.relight.zip")
    path = tmp_path / "a.relight.zip"
    path.write_bytes(answer.content)
    assert load_bundle(path).manifest.HasField("transport")
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None


def test_an_archive_is_asked_for_again_by_its_etag(api: Api, bundle: str):
    etag = api.get(f"/v1/bundles/{bundle}/archive").headers["etag"]
    answer = api.get(f"/v1/bundles/{bundle}/archive", headers={"if-none-match": etag})
    assert (answer.status_code, answer.content) == (304, b"")


def test_an_archive_is_not_for_strangers_nor_behind_a_link(api: Api, bundle: str):
    answer = api.other(STRANGER_KEY).get(f"/v1/bundles/{bundle}/archive")
    expect_problem(answer, 404, "bundle_not_found")
    expect_problem(api.other(None).get(f"/v1/bundles/{bundle}/archive"), 401, "not_authenticated")


def test_lost_bytes_are_a_problem_before_the_download(api: Api, tmp_path: Path):
    broken = add_bundle(api, tmp_path, {"manifest.json": b"lost"}, bundle_id="bundle_lost")
    api.services.store.delete_bytes(sha256(b"lost"))
    expect_problem(api.get(f"/v1/bundles/{broken}/archive"), 410, "blob_damaged")


class Told:
    """A store that yields zeros, and what was read of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, api: Api, sizes: dict[str, int], piece: int) -> None:
        self.opened: list[str] = []
        self.num_read = 0
        self._piece = bytes(piece)
        self._sizes = {sha256(name.encode()): size for name, size in sizes.items()}
        monkeypatch.setattr(api.services.store, "damaged", lambda _: [])
        monkeypatch.setattr(api.services.store, "read", self._open)

    def _open(self, digest: str, _size: int) -> Iterator[bytes]:
        self.opened.append(digest)
        return self._pieces(self._sizes[digest] // len(self._piece))

    def _pieces(self, count: int) -> Iterator[bytes]:
        for _ in range(count):
            self.num_read += 1
            yield self._piece


def stream(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sizes: dict[str, int], piece: int
) -> tuple[StreamingResponse, Told]:
    """Return the response of the archive of a bundle with files of so many zeros, and what is read for it."""
    bundle = add_bundle(
        api, tmp_path, {name: name.encode() for name in sizes}, bundle_id=f"bundle_{len(sizes)}{piece}"
    )
    with api.services.database.write() as connection:
        for name, size in sizes.items():
            mine = (bundle_files.c.bundle_id == bundle) & (bundle_files.c.path == name)
            connection.execute(change(TENANT, bundle_files).where(mine).values(size_bytes=float(size)))
    told = Told(monkeypatch, api, sizes, piece)
    answer = get_bundle_archive(api.services, TENANT, bundle)
    assert isinstance(answer, StreamingResponse)
    return answer, told


async def pieces_of(answer: StreamingResponse) -> AsyncIterator[bytes]:
    async for piece in answer.body_iterator:
        assert isinstance(piece, bytes)
        yield piece


def test_no_more_than_a_piece_is_held_and_files_are_opened_in_turn(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    answer, told = stream(api, tmp_path, monkeypatch, {"a": 10**6, "b": 10**6}, 1000)

    async def first_half() -> None:
        total = 0
        async for piece in pieces_of(answer):
            assert len(piece) <= 1000
            total += len(piece)
            # What was read has been sent, but for the piece that is on its way.
            assert told.num_read * 1000 <= total + 1000
            if total >= 10**6:
                break

    asyncio.run(first_half())
    assert told.opened == [sha256(b"a")]


def test_the_length_is_announced_exactly_also_above_4_gib(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    sizes = {"models/ä.bin": 5 << 30, "b": 1 << 26, "empty": 0}
    answer, _ = stream(api, tmp_path, monkeypatch, sizes, 1 << 26)

    async def received() -> tuple[int, bytes]:
        total, tail = 0, b""
        async for piece in pieces_of(answer):
            total += len(piece)
            tail = (tail + piece)[-100_000:] if len(piece) < 1 << 26 else b""
        return total, tail

    # The checksum of 5 GiB would take longer than everything else.
    monkeypatch.setattr("zipstream.ng.crc32", lambda *_: 0)
    total, tail = asyncio.run(received())
    assert answer.headers["content-length"] == str(total)
    # The last entry and the directory behind it.
    with zipfile.ZipFile(Padded(tail, total)) as archive:
        assert {each.filename: each.file_size for each in archive.infolist()} == sizes
        assert {each.compress_type for each in archive.infolist()} == {zipfile.ZIP_STORED}


class Padded(io.RawIOBase):
    """A file of which only the end is known."""

    def __init__(self, tail: bytes, size: int) -> None:
        self._tail, self._before, self._place = tail, size - len(tail), 0

    def seekable(self) -> bool:
        return True

    def seek(self, place: int, whence: int = 0) -> int:
        self._place = place + (0, self._place, self._before + len(self._tail))[whence]
        return self._place

    def tell(self) -> int:
        return self._place

    def read(self, size: int = -1) -> bytes:
        assert self._place >= self._before
        begin = self._place - self._before
        found = self._tail[begin:] if size < 0 else self._tail[begin : begin + size]
        self._place += len(found)
        return found


def test_a_file_that_has_lost_bytes_ends_the_download(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    answer, told = stream(api, tmp_path, monkeypatch, {"a": 3000}, 1000)
    told._sizes[sha256(b"a")] = 2000

    async def received() -> None:
        async for _ in pieces_of(answer):
            pass

    with pytest.raises(RuntimeError, match="did not match the computed size"):
        asyncio.run(received())


@pytest.mark.skipif(shutil.which("unzip") is None, reason="unzip is not installed")
def test_unzip_finds_no_fault(api: Api, bundle: str, tmp_path: Path):
    path = tmp_path / "a.zip"
    path.write_bytes(api.get(f"/v1/bundles/{bundle}/archive").content)
    subprocess.run(["unzip", "-tqq", path], check=True)


def test_an_empty_name_gives_a_file_name_all_the_same(api: Api, tmp_path: Path):
    bundle = add_bundle(api, tmp_path, {"manifest.json": b"{}"}, bundle_id="bundle_nameless", scene_id="gone")
    answer = api.get(f"/v1/bundles/{bundle}/archive")
    assert answer.headers["content-disposition"].endswith("''bundle_nameless.relight.zip")
    assert zipfile.ZipFile(io.BytesIO(answer.content)).read("manifest.json") == b"{}"

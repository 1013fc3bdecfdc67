"""Bodies and archives are counted while they arrive: against the disk, the quota, and a tenant's share."""

import asyncio
import contextlib
import shutil
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from fastapi import Request
from lambent_server.accounts import organisations
from lambent_server.api.problems import Problem
from lambent_server.database.tenancy import Tenant
from lambent_server.receiving.uploads import allowance_of, received
from lambent_server.services import Services
from lambent_server.storage import archives
from support.api import STRANGER, STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, served, sha256
from support.archives import make_zip
from support.databases import postgresql

MB = 1_000_000


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Return the setting of each database."""
    with contextlib.ExitStack() as stack:
        yield {} if request.param == "sqlite" else {"database": stack.enter_context(postgresql())}


class Usage(NamedTuple):
    """What a disk says of itself."""

    free: int


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """Give the data folder a disk of 30 MB, and return what says how much of it is free."""

    def free() -> int:
        used = 0
        for folder in ("scratch", "store"):
            for path in (tmp_path / "data" / folder).rglob("*"):
                with contextlib.suppress(FileNotFoundError):
                    used += path.stat().st_size if path.is_file() else 0
        return 30 * MB - used

    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(free()))
    return free


def request(pieces: AsyncIterator[bytes], length: int | None = None) -> Request:
    """Return a request with a body that comes in pieces."""

    async def receive() -> dict[str, Any]:
        piece = await anext(pieces, None)
        return {"type": "http.request", "body": piece or b"", "more_body": piece is not None}

    headers = [] if length is None else [(b"content-length", str(length).encode())]
    return Request({"type": "http", "method": "PUT", "headers": headers}, receive)


async def slowly(size: int, log: Callable[[], object] = lambda: None) -> AsyncIterator[bytes]:
    """Yield so many bytes in pieces, between which others have their turn."""
    for _ in range(0, size, 100_000):
        yield bytes(100_000)
        log()
        await asyncio.sleep(0)


async def sent(services: Services, tenant: Tenant, size: int, **more: Any) -> str:
    """Return "stored" or the code of the problem, for a body that is gone afterwards."""
    try:
        async with received(
            services, request(slowly(size, more.pop("log", lambda: None)), **more), tenant, size
        ):
            await asyncio.sleep(0.01)
    except Problem as problem:
        return problem.code
    return "stored"


def test_bodies_that_arrive_together_never_pass_the_floor_and_leave_room_to_others(
    tmp_path: Path, disk: Callable[[], int]
):
    least: list[int] = []
    with opened(tmp_path / "data", disk_floor_bytes=10 * MB) as api:

        async def act() -> tuple[list[str], list[str]]:
            log = lambda: least.append(disk())  # noqa: E731
            big = asyncio.gather(*(sent(api.services, TENANT, 9 * MB, log=log) for _ in range(6)))
            small = []
            while not big.done():
                small.append(await sent(api.services, STRANGER, 200_000))
            return await big, small

        big, small = asyncio.run(act())
    assert min(least) >= 10 * MB
    assert "uploads_share" in big
    assert set(small) == {"stored"}
    assert len(small) > 3


def test_a_body_whose_length_has_no_room_is_refused_before_its_first_byte(
    tmp_path: Path, disk: Callable[[], int]
):
    began: list[object] = []
    with opened(tmp_path / "data", disk_floor_bytes=10 * MB) as api:
        given = {"length": 25 * MB, "log": lambda: began.append(1)}
        assert asyncio.run(sent(api.services, TENANT, 25 * MB, **given)) == "disk_floor"
    assert began == []


def test_bodies_that_arrive_together_never_pass_the_quota(tmp_path: Path, database: dict[str, str]):
    most = 0
    with opened(tmp_path / "data", max_organisation_bytes=MB, **database) as api:
        api.scene({"transforms_train.json": bytes(300_000)})
        with api.services.database.read() as connection:
            allowance = allowance_of(connection, api.services, TENANT, sha256(b"new"))
        scratch = api.services.settings.scratch

        def log() -> None:
            nonlocal most
            most = max(most, sum(path.stat().st_size for path in scratch.iterdir()))

        async def one() -> str:
            try:
                async with received(api.services, request(slowly(400_000, log)), TENANT, MB, allowance):
                    await asyncio.sleep(0.01)
            except Problem as problem:
                return problem.code
            return "stored"

        async def act() -> list[str]:
            return await asyncio.gather(*(one() for _ in range(5)))

        codes = asyncio.run(act())
    assert most <= 700_000
    assert set(codes) <= {"stored", "quota_bytes"}
    assert "quota_bytes" in codes


def test_a_file_that_is_stored_already_takes_nothing_of_a_quota_that_is_used_up(tmp_path: Path):
    data = b"x" * 900
    with opened(tmp_path / "data", max_organisation_bytes=1000) as api:
        api.scene({"transforms_train.json": data})
        again = api.scene({"transforms_train.json": data})
        assert expect(api.get(f"/v1/scenes/{again}"), 200)["state"] == "uploaded"
        archive = make_zip({"transforms_train.json": data})
        scene = expect(api.post("/v1/scenes", json={"name": "a"}), 201)["id"]
        assert expect(api.put(f"/v1/scenes/{scene}/archive", content=archive), 200)["state"] == "uploaded"


def test_unpacking_stops_at_the_first_entry_for_which_the_quota_has_no_room(
    tmp_path: Path, database: dict[str, str], monkeypatch: pytest.MonkeyPatch
):
    written: list[int] = []
    plain = archives.write_all

    def counted(descriptor: int, data: bytes) -> None:
        written.append(len(data))
        plain(descriptor, data)

    monkeypatch.setattr(archives, "write_all", counted)
    files = {f"images/{number:02d}.png": bytes([number]) * MB for number in range(40)}
    archive = make_zip({"transforms_train.json": b"{}", **files})
    with opened(tmp_path / "data", max_organisation_bytes=3 * MB, max_archive_ratio=1e6, **database) as api:
        scene = expect(api.post("/v1/scenes", json={"name": "a"}), 201)["id"]
        answer = api.put(f"/v1/scenes/{scene}/archive", content=archive)
        quota = expect_problem(answer, 507, "quota_bytes")["quota"]
        assert quota == {"name": "max_bytes", "limit": 3 * MB, "used": 0.0}
        # The scene takes another archive: nothing is wrong with it.
        assert expect(api.get(f"/v1/scenes/{scene}"), 200)["state"] == "open"
        assert list(api.services.settings.scratch.iterdir()) == []
    assert sum(written) < 3 * MB


def test_an_archive_that_is_unpacked_never_passes_the_floor(tmp_path: Path, disk: Callable[[], int]):
    files = {f"images/{number:02d}.png": bytes([number]) * MB for number in range(15)}
    archive = make_zip({"transforms_train.json": b"{}", **files})
    with opened(tmp_path / "data", disk_floor_bytes=10 * MB, max_archive_ratio=1e6) as api:
        scene = expect(api.post("/v1/scenes", json={"name": "a"}), 201)["id"]
        answer = api.put(f"/v1/scenes/{scene}/archive", content=archive)
        expect_problem(answer, 507, "uploads_share")
        assert disk() > 29 * MB


@pytest.mark.slow
def test_a_small_archive_does_not_wait_for_the_many_large_ones_of_another_tenant(tmp_path: Path):
    large = make_zip({"transforms_train.json": b"{}", "images/0.png": bytes(60 * MB)})
    small = make_zip({"transforms_train.json": b"{}"})
    done: list[str] = []
    with opened(tmp_path / "data", max_archive_ratio=1e9) as api:

        def send(client: Any, name: str, data: bytes) -> None:
            scene = expect(client.post("/v1/scenes", json={"name": name}), 201)["id"]
            expect(client.put(f"/v1/scenes/{scene}/archive", content=data), 200)
            done.append(name)

        many = [threading.Thread(target=send, args=(api.client, "large", large)) for _ in range(12)]
        for each in many:
            each.start()
        time.sleep(0.5)
        send(api.other(STRANGER_KEY), "small", small)
        place = len(done)
        for each in many:
            each.join()
    assert done.count("large") == 12
    assert place <= 5


def test_a_key_has_one_decoder_and_a_tenant_two_of_four(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        decoders, most = api.services.decoders, {"key": 0, "tenant": 0}

        async def act() -> None:
            busy: list[str] = []

            async def one(client: str) -> None:
                async with decoders.place("a", client):
                    busy.append(client)
                    most["key"] = max(most["key"], busy.count("key 1"))
                    most["tenant"] = max(most["tenant"], len(busy))
                    await asyncio.sleep(0.01)
                    busy.remove(client)

            await asyncio.gather(*(one(f"key {number % 3}") for number in range(12)))

        asyncio.run(act())
    assert most == {"key": 1, "tenant": 2}


def test_quotas_of_organisations_count_and_not_only_those_of_the_settings(api_of: Api):
    with api_of.services.database.write() as connection:
        organisations.update(connection, STRANGER, max_bytes=100)
    other = api_of.other(STRANGER_KEY)
    scene = expect(other.post("/v1/scenes", json={"name": "a"}), 201)["id"]
    sky = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes(80)
    for path, method in ((f"/v1/scenes/{scene}/archive", "PUT"), ("/v1/environments?name=x", "POST")):
        expect_problem(other.request(method, path, content=sky), 507, "quota_bytes")
    plan = [{"path": "transforms_train.json", "size": 101, "sha256": sha256(bytes(101))}]
    expect_problem(other.post(f"/v1/scenes/{scene}/files:plan", json=plan), 507, "quota_bytes")


api_of = served(databases=("sqlite", "postgresql"))

"""Files of scenes go directly to a real S3 server, and are read from there."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx2
import pytest
from lambent_server.accounts import organisations
from lambent_server.maintenance.housekeeping import sweep
from lambent_server.running.reconciler import examine, reconcile
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, sha256
from support.s3_server import S3Server, with_credentials

pytestmark = [pytest.mark.services, pytest.mark.slow]
MIB = 1024 * 1024
LARGE = bytes(range(256)) * (11 * MIB // 256) + b"the end"
PHOTO = b"a photograph"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with with_credentials(), S3Server(tmp_path_factory.mktemp("s3")) as server:
        server.client().create_bucket(Bucket="bucket")
        yield server


@pytest.fixture
def settings(server: S3Server) -> dict[str, Any]:
    where = {"store": "s3://bucket/lambent", "store_endpoint": server.url, "store_region": "us-east-1"}
    return {**where, "store_whole_bytes": MIB, "store_part_bytes": 5 * MIB}


@pytest.fixture
def api(settings: dict[str, Any], server: S3Server, tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data", **settings) as api:
        yield api
    for key in server.keys("bucket"):
        server.client().delete_object(Bucket="bucket", Key=key)


def planned(api: Any, files: Mapping[str, bytes]) -> tuple[str, dict[str, Any]]:
    """Return a scene with planned files, and the plan."""
    scene_id = expect(api.post("/v1/scenes", json={"name": "x"}), 201)["id"]
    plan = [{"path": path, "size": len(data), "sha256": sha256(data)} for path, data in files.items()]
    return scene_id, expect(api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan), 200)


def send(part: Mapping[str, Any], data: bytes) -> int:
    """PUT a part of a file to the store and return the status."""
    start = int(part["offset"])
    piece = data[start : start + int(part["size_bytes"])]
    return httpx2.put(part["url"], content=piece, headers=part["headers"], timeout=30).status_code


def complete(api: Any, scene_id: str, *files: bytes) -> dict[str, Any]:
    body = {"sha256": [sha256(data) for data in files]}
    return dict(expect(api.post(f"/v1/scenes/{scene_id}/files:complete", json=body), 200))


def renewed(api: Any, scene_id: str, data: bytes) -> list[dict[str, Any]]:
    """Return the parts that are still to be sent."""
    answer = api.post(f"/v1/scenes/{scene_id}/files:uploads", json={"sha256": [sha256(data)]})
    return list(expect(answer, 200)["items"][0]["parts"])


def stored(api: Api, data: bytes) -> bool:
    return api.services.store.size(sha256(data)) == len(data)


def test_files_go_to_the_store_and_the_scene_is_committed(api: Api, server: S3Server):
    scene_id, plan = planned(api, {"a.png": PHOTO, "b.png": LARGE})
    uploads = {upload["sha256"]: upload for upload in plan["uploads"]}
    assert [part["number"] for part in uploads[sha256(PHOTO)]["parts"]] == [0]
    assert [part["number"] for part in uploads[sha256(LARGE)]["parts"]] == [1, 2, 3]
    for data in (PHOTO, LARGE):
        assert [send(part, data) for part in uploads[sha256(data)]["parts"]] == [200] * len(
            uploads[sha256(data)]["parts"]
        )
    assert not stored(api, PHOTO)
    for _ in range(2):
        assert complete(api, scene_id, PHOTO, LARGE) == {
            "stored": [sha256(PHOTO), sha256(LARGE)],
            "refused": [],
        }
    expect(api.post(f"/v1/scenes/{scene_id}:commit"), 200)
    assert api.get(f"/v1/blobs/{sha256(LARGE)}").content == LARGE
    # Nothing is left where they were sent.
    assert [key for key in server.keys("bucket") if "/uploads/" in key] == []


def test_a_file_that_was_not_sent_is_not_taken_over(api: Api):
    scene_id, _ = planned(api, {"a.png": PHOTO})
    found = complete(api, scene_id, PHOTO)
    assert found["stored"] == []
    assert found["refused"][0]["code"] == "upload_missing"
    expect_problem(api.post(f"/v1/scenes/{scene_id}:commit"), 409, "files_missing")


def test_other_bytes_in_parts_are_refused_and_removed(api: Api, server: S3Server):
    scene_id, plan = planned(api, {"b.png": LARGE})
    wrong = bytes(len(LARGE))
    assert [send(part, wrong) for part in plan["uploads"][0]["parts"]] == [200] * 3
    assert complete(api, scene_id, LARGE)["refused"][0]["code"] == "digest_mismatch"
    assert not stored(api, LARGE)
    assert server.keys("bucket") == []
    assert [send(part, LARGE) for part in renewed(api, scene_id, LARGE)] == [200] * 3
    assert complete(api, scene_id, LARGE)["refused"] == []


def test_an_upload_in_parts_goes_on_where_it_was_broken_off(api: Api):
    scene_id, plan = planned(api, {"b.png": LARGE})
    assert send(plan["uploads"][0]["parts"][1], LARGE) == 200
    assert complete(api, scene_id, LARGE)["refused"][0]["code"] == "upload_missing"
    _, again = planned(api, {"b.png": LARGE})
    parts = again["uploads"][0]["parts"]
    assert [part["number"] for part in parts] == [1, 3]
    assert [send(part, LARGE) for part in parts] == [200, 200]
    assert renewed(api, scene_id, LARGE) == []
    assert complete(api, scene_id, LARGE)["refused"] == []
    assert stored(api, LARGE)


def test_a_hash_alone_does_not_open_another_tenants_file(api: Api):
    scene_id, plan = planned(api, {"a.png": PHOTO})
    send(plan["uploads"][0]["parts"][0], PHOTO)
    assert complete(api, scene_id, PHOTO)["refused"] == []
    stranger = api.other(STRANGER_KEY)
    theirs, _ = planned(stranger, {"a.png": PHOTO})
    assert complete(stranger, theirs, PHOTO)["refused"][0]["code"] == "upload_missing"
    assert stranger.get(f"/v1/blobs/{sha256(PHOTO)}").status_code == 404


def test_an_address_that_expired_is_replaced(settings: dict[str, Any], server: S3Server, tmp_path: Path):
    # Signatures count whole seconds from the start of one: the new address is good for at least three.
    with opened(tmp_path / "data", **{**settings, "store_url_s": 4.0}) as api:
        scene_id, plan = planned(api, {"c.png": b"expired"})
        time.sleep(5.1)
        assert send(plan["uploads"][0]["parts"][0], b"expired") == 403
        assert send(renewed(api, scene_id, b"expired")[0], b"expired") == 200


def test_a_store_that_does_not_verify_is_read_before_a_row_names_the_file(api: Api):
    assert api.services.store.bucket is not None
    api.services.store.bucket.verifies = False
    scene_id, plan = planned(api, {"a.png": PHOTO})
    part = plan["uploads"][0]["parts"][0]
    assert part["headers"] == {}
    assert send(part, b"A photograph") == 200
    assert complete(api, scene_id, PHOTO)["refused"][0]["code"] == "digest_mismatch"
    assert send(renewed(api, scene_id, PHOTO)[0], PHOTO) == 200
    assert complete(api, scene_id, PHOTO)["refused"] == []
    assert api.get(f"/v1/blobs/{sha256(PHOTO)}").content == PHOTO


def test_programs_that_ask_are_sent_to_the_store_and_others_get_the_bytes(api: Api):
    api.scene({"a.png": PHOTO})
    path = f"/v1/blobs/{sha256(PHOTO)}"
    assert api.get(path).content == PHOTO
    answer = api.get(path, headers={"x-lambent-redirect": "1", "range": "bytes=2-"}, follow_redirects=False)
    assert answer.status_code == 307
    assert answer.headers["cache-control"] == "no-store"
    there = httpx2.get(answer.headers["location"], headers={"range": "bytes=2-6"}, timeout=20)
    assert (there.status_code, there.content) == (206, PHOTO[2:7])
    current = {"x-lambent-redirect": "1", "if-none-match": f'"{sha256(PHOTO)}"'}
    assert api.get(path, headers=current, follow_redirects=False).status_code == 304


def test_everybody_is_sent_to_the_store_where_that_is_set(settings: dict[str, Any], tmp_path: Path):
    with opened(tmp_path / "data", **settings, store_redirect="always") as api:
        api.scene({"a.png": PHOTO})
        assert api.get(f"/v1/blobs/{sha256(PHOTO)}", follow_redirects=False).status_code == 307


def test_pages_may_reach_the_store_and_nothing_else(api: Api, server: S3Server):
    policy = api.get("/healthz").headers["content-security-policy"]
    assert f"connect-src 'self' {server.url};" in policy
    assert f"img-src 'self' {server.url} blob:" in policy


def test_without_direct_transfers_the_server_takes_and_sends_the_bytes(
    settings: dict[str, Any], tmp_path: Path
):
    with opened(tmp_path / "data", **settings, store_direct=False) as api:
        scene_id, plan = planned(api, {"a.png": PHOTO})
        assert plan["uploads"] == []
        body = {"sha256": [sha256(PHOTO)]}
        expect_problem(api.post(f"/v1/scenes/{scene_id}/files:complete", json=body), 409, "not_direct")
        expect(api.put(f"/v1/scenes/{scene_id}/files/{sha256(PHOTO)}", content=PHOTO), 204)
        headers = {"x-lambent-redirect": "1"}
        assert api.get(f"/v1/blobs/{sha256(PHOTO)}", headers=headers).content == PHOTO
        assert "http" not in api.get("/healthz").headers["content-security-policy"]


def test_a_folder_offers_no_addresses(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        assert planned(api, {"a.png": PHOTO})[1]["uploads"] == []


def test_a_store_that_is_away_is_told_and_nothing_is_lost(api: Api, server: S3Server):
    scene_id, _ = planned(api, {"a.png": PHOTO})
    server.kill()
    try:
        put = api.put(f"/v1/scenes/{scene_id}/files/{sha256(PHOTO)}", content=PHOTO)
        assert expect_problem(put, 503, "store_unavailable")["retryable"]
        body = {"sha256": [sha256(PHOTO)]}
        answer = api.post(f"/v1/scenes/{scene_id}/files:complete", json=body)
        expect_problem(answer, 503, "store_unavailable")
        sweep(api.services)
    finally:
        server.start()
    expect(api.put(f"/v1/scenes/{scene_id}/files/{sha256(PHOTO)}", content=PHOTO), 204)
    expect(api.post(f"/v1/scenes/{scene_id}:commit"), 200)


def test_what_was_sent_and_never_taken_over_is_removed_when_it_is_old(
    settings: dict[str, Any], server: S3Server, tmp_path: Path
):
    with opened(tmp_path / "data", **settings, orphan_after_s=1.0) as api:
        _, plan = planned(api, {"a.png": PHOTO, "b.png": LARGE})
        for upload in plan["uploads"]:
            assert send(upload["parts"][0], LARGE if upload["sha256"] == sha256(LARGE) else PHOTO) == 200
        bucket = api.services.store.bucket
        assert bucket is not None
        assert examine(api.services).num_orphans == 0
        time.sleep(2.1)
        found = examine(api.services)
        assert (len(found.staged), len(found.parts), len(list(bucket.uploads("uploads/")))) == (1, 1, 1)
        reconcile(api.services)
        assert examine(api.services).num_orphans == 0
        assert list(bucket.uploads("uploads/")) == []
        assert [key for key in server.keys("bucket") if "/uploads/" in key] == []


def in_bucket(server: S3Server) -> int:
    """Return how many bytes lie where files are sent."""
    found = server.client().list_objects_v2(Bucket="bucket", Prefix="lambent/uploads/").get("Contents", ())
    return sum(each["Size"] for each in found)


def test_files_that_are_sent_and_never_taken_over_count_for_the_quota_until_they_are_deleted(
    settings: dict[str, Any], server: S3Server, tmp_path: Path
):
    given = {"max_organisation_bytes": MIB, "store_reserved_s": 1.0, "store_url_s": 4.0}
    with opened(tmp_path / "data", **settings, **given) as api:
        refused = 0
        for number in range(8):
            data = bytes([number]) * 900_000
            scene_id = expect(api.post("/v1/scenes", json={"name": "x"}), 201)["id"]
            plan = [{"path": "a.png", "size": len(data), "sha256": sha256(data)}]
            answer = api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan)
            if answer.status_code == 200:
                assert send(answer.json()["uploads"][0]["parts"][0], data) == 200
                first, sent = scene_id, data
            else:
                expect_problem(answer, 507, "quota_bytes")
                refused += 1
        assert refused == 7
        assert in_bucket(server) == 900_000
        # The same plan again adds no use, and the file that was reserved can be stored in either way.
        again = [{"path": "a.png", "size": len(sent), "sha256": sha256(sent)}]
        expect(api.post(f"/v1/scenes/{first}/files:plan", json=again), 200)
        time.sleep(4.5)
        sweep(api.services)
        assert in_bucket(server) == 0
        _, plan = planned(api, {"b.png": b"b" * 1_000_000})
        assert len(plan["uploads"]) == 1


def test_a_file_that_is_refused_in_the_end_does_not_stay_where_it_was_sent(
    settings: dict[str, Any], server: S3Server, tmp_path: Path
):
    with opened(tmp_path / "data", **settings, max_organisation_bytes=MIB) as api:
        scene_id, plan = planned(api, {"a.png": bytes(900_000)})
        assert send(plan["uploads"][0]["parts"][0], bytes(900_000)) == 200
        with api.services.database.write() as connection:
            organisations.update(connection, TENANT, max_bytes=100)
        assert complete(api, scene_id, bytes(900_000))["refused"][0]["code"] == "quota_bytes"
        assert in_bucket(server) == 0


def test_a_file_that_was_planned_for_the_store_may_be_sent_to_the_server_instead(
    settings: dict[str, Any], tmp_path: Path
):
    with opened(tmp_path / "data", **settings, max_organisation_bytes=MIB) as api:
        data = bytes(900_000)
        scene_id, _ = planned(api, {"a.png": data})
        expect(api.put(f"/v1/scenes/{scene_id}/files/{sha256(data)}", content=data), 204)
        expect(api.post(f"/v1/scenes/{scene_id}:commit"), 200)
        planned(api, {"b.png": b"b" * 100_000})


def test_bytes_without_a_row_and_rows_without_bytes_are_found_in_a_bucket(
    settings: dict[str, Any], tmp_path: Path
):
    with opened(tmp_path / "data", **settings, orphan_after_s=1.0) as api:
        api.scene({"a.png": PHOTO, "b.png": b"kept"})
        source = tmp_path / "orphan"
        source.write_bytes(b"orphan")
        api.services.store._put(sha256(b"orphan"), source)
        api.services.store.delete_bytes(sha256(PHOTO))
        time.sleep(2.1)
        assert reconcile(api.services) == 1
        assert api.services.store.size(sha256(b"orphan")) is None
        assert api.services.store.read_all(sha256(b"kept")) == b"kept"

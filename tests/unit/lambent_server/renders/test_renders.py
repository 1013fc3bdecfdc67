"""Orders of pictures over REST: what is queued, how it is split, what is refused; without rendering."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lambent_core.pictures import RenderSpec
from lambent_proto.v1 import worker_pb2
from lambent_relight import cameras_json, turntable, write_environment
from support.api import STRANGER, STRANGER_KEY, Api, expect, expect_problem, opened
from support.runs import Stage, staged
from support.server_rows import add_bundle

CAMERAS = cameras_json(turntable(3, radius=4.0, width=8, height=8)).encode()
FILES = {"manifest.json": b"{}", "cameras.json": CAMERAS, "models/weights.bin": b"weights"}


def add_environment(api: Api, folder: Path, name: str = "bright sky.exr") -> str:
    """Upload a map and return its id."""
    write_environment(folder / "sky.exr", np.ones((4, 8, 3), np.float32))
    content = (folder / "sky.exr").read_bytes()
    answer = api.post("/v1/environments", params={"name": name}, content=content)
    return str(expect(answer, 201)["id"])


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    folder = tmp_path_factory.mktemp("api")
    with opened(folder / "data", local_slots=3) as api:
        add_bundle(api, folder, FILES)
        add_bundle(api, folder, FILES, bundle_id="bundle_foreign", tenant=STRANGER)
        yield api


@pytest.fixture(scope="module")
def sky(api: Api, tmp_path_factory: pytest.TempPathFactory) -> str:
    return add_environment(api, tmp_path_factory.mktemp("sky"))


def batch_body(sky: str, **changes: Any) -> dict[str, Any]:
    """Return a small batch of 2 x 2 x 3 x 1 pictures."""
    body = {
        "name": "spring",
        "assets": [{"bundle_id": "bundle_x"}, {"name": "red", "bundle_id": "bundle_x"}],
        "environments": [
            {"environment_id": sky},
            {"name": "turned", "environment_id": sky, "rotate_deg": 90},
        ],
        "cameras": [{"all_views": True}],
    }
    return body | changes


def test_a_batch_is_split_over_the_slots(api: Api, sky: str):
    batch = expect(api.post("/v1/batches", json=batch_body(sky)), 202)
    assert (batch["state"], batch["num_pictures"], batch["num_done"], batch["num_failed"]) == (
        "queued",
        12,
        0,
        0,
    )
    assert len(batch["job_ids"]) == 4, "three parts, and the table and sheet of all"
    assert expect(api.get(f"/v1/batches/{batch['id']}"), 200) == batch
    assert batch in expect(api.get("/v1/batches"), 200)["items"]
    jobs = [expect(api.get(f"/v1/jobs/{job_id}"), 200) for job_id in batch["job_ids"]]
    assert {(job["kind"], job["batch_id"], job["gpus"]) for job in jobs} == {("batch", batch["id"], 0)}
    assert expect(api.get(f"/v1/batches/{batch['id']}/artifacts"), 200) == {"items": [], "next_cursor": None}
    one = expect(api.post("/v1/batches", json=batch_body(sky, shards=1)), 202)
    assert len(one["job_ids"]) == 1
    few = batch_body(sky, shards=64, cameras=[{"turntable": 1}], assets=[{"bundle_id": "bundle_x"}])
    assert len(expect(api.post("/v1/batches", json=few), 202)["job_ids"]) == 2 + 1, (
        "never more parts than pictures"
    )


def test_a_render_is_one_job(api: Api, sky: str):
    body = {
        "bundle_id": "bundle_x",
        "environments": [{"environment_id": sky}],
        "cameras": {"turntable": 8, "size": 64},
        "quality": {"quality": "preview"},
        "labels": {"shop": "spring"},
    }
    job = expect(api.post("/v1/renders", json=body), 202)
    assert (job["kind"], job["state"], job["batch_id"]) == ("render", "queued", None)
    found = expect(api.get("/v1/jobs", params={"label": "shop=spring"}), 200)["items"]
    assert [each["id"] for each in found] == [job["id"]]
    assert expect(api.get(f"/v1/jobs/{job['id']}/artifacts"), 200) == {"items": [], "next_cursor": None}
    expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)
    again = expect(api.post(f"/v1/jobs/{job['id']}:retry"), 202)
    assert (again["kind"], again["state"]) == ("render", "queued")
    assert again["id"] != job["id"]
    assert again["labels"] == {"shop": "spring"}


@pytest.mark.parametrize("path", ["/v1/batches", "/v1/renders"])
def test_the_same_key_gives_the_same_order_and_another_body_is_refused(api: Api, sky: str, path: str):
    headers = {"Idempotency-Key": f"key-of-{path.rpartition('/')[2]}"}
    body = batch_body(sky)
    if path == "/v1/renders":
        body = {"bundle_id": "bundle_x", "environments": body["environments"], "cameras": {"turntable": 2}}
    first = expect(api.post(path, json=body, headers=headers), 202)
    assert expect(api.post(path, json=body, headers=headers), 202)["id"] == first["id"]
    answer = api.post(path, json={**body, "priority": 1}, headers=headers)
    expect_problem(answer, 422, "idempotency_key_reused")


def test_a_cancelled_batch_can_be_tried_again_and_keeps_its_id(api: Api, sky: str):
    batch = expect(api.post("/v1/batches", json=batch_body(sky)), 202)
    expect_problem(api.post(f"/v1/batches/{batch['id']}:retry"), 409, "batch_not_ended")
    cancelled = expect(api.post(f"/v1/batches/{batch['id']}:cancel"), 202)
    assert (cancelled["state"], cancelled["job_ids"]) == ("cancelled", batch["job_ids"])
    assert expect(api.post(f"/v1/batches/{batch['id']}:cancel"), 202)["state"] == "cancelled"
    again = expect(api.post(f"/v1/batches/{batch['id']}:retry"), 202)
    assert (again["id"], again["state"]) == (batch["id"], "queued")
    assert not set(again["job_ids"]) & set(batch["job_ids"])
    one = again["job_ids"][0]
    expect(api.post(f"/v1/jobs/{one}:cancel"), 202)
    assert expect(api.get(f"/v1/batches/{batch['id']}"), 200)["state"] == "running"
    expect(api.post(f"/v1/batches/{batch['id']}:retry"), 202)
    assert one not in expect(api.get(f"/v1/batches/{batch['id']}"), 200)["job_ids"]


@pytest.mark.parametrize(
    ("change", "status", "code", "pointer"),
    [
        ({"assets": []}, 422, "invalid_request", "#/assets"),
        ({"assets": [{"bundle_id": "bundle_x", "colour": 1}]}, 422, "invalid_request", "#/assets/0/colour"),
        ({"cameras": [{"turntable": -1}]}, 422, "invalid_request", "#/cameras/0/turntable"),
        ({"qualities": [{"spp": 1}]}, 422, "invalid_request", "#/qualities/0/spp"),
        ({"output": {"passes": ["shadow"]}}, 422, "invalid_request", "#/output/passes/0"),
        ({"assets": [{"bundle_id": "gone"}]}, 404, "bundle_not_found", "#/assets/0/bundle_id"),
        ({"assets": [{"bundle_id": "bundle_foreign"}]}, 404, "bundle_not_found", "#/assets/0/bundle_id"),
        (
            {"environments": [{"environment_id": "env_gone"}]},
            404,
            "environment_not_found",
            "#/environments/0/environment_id",
        ),
        ({"cameras": [{}]}, 422, "cameras_unclear", "#/cameras/0"),
        ({"cameras": [{"turntable": 2, "all_views": True}]}, 422, "cameras_unclear", "#/cameras/0"),
        ({"cameras": [{"all_views": True, "radius": 3.0}]}, 422, "cameras_unclear", "#/cameras/0/radius"),
        (
            {"cameras": [{"all_views": True, "elevation_deg": 0.0}]},
            422,
            "cameras_unclear",
            "#/cameras/0/elevation_deg",
        ),
        ({"cameras": [{"views": ["turntable_000", "no"]}]}, 422, "camera_unknown", "#/cameras/0/views/1"),
        ({"assets": [{"bundle_id": "bundle_x"}] * 2}, 422, "name_clash", "#/assets/1/name"),
        ({"qualities": [{}, {}]}, 422, "name_clash", "#/qualities/1/name"),
        ({"cameras": [{"turntable": 1000}]}, 422, "too_many_pictures", "#/cameras"),
        ({"output": {"path": "../{camera}"}}, 422, "invalid_request", "#/output/path"),
        ({"output": {"path": "{camera}/{light}"}}, 422, "invalid_request", "#/output/path"),
        ({"output": {"path": "{asset}/{camera}"}}, 422, "name_clash", "#/output/path"),
    ],
)
def test_what_cannot_be_used_is_pointed_at(
    api: Api, sky: str, change: dict[str, Any], status: int, code: str, pointer: str
):
    problem = expect_problem(api.post("/v1/batches", json=batch_body(sky, **change)), status, code)
    assert pointer in [each["pointer"] for each in problem["errors"]]


def test_a_quota_counts_every_job_of_a_batch(tmp_path: Path):
    with opened(tmp_path / "data", local_slots=3, max_queued_jobs=3) as api:
        add_bundle(api, tmp_path, FILES)
        body = batch_body(add_environment(api, tmp_path))
        expect_problem(api.post("/v1/batches", json=body), 429, "quota_jobs")
        expect(api.post("/v1/batches", json=body | {"shards": 2}), 202)


def test_another_tenants_batch_does_not_exist(api: Api, sky: str):
    batch = expect(api.post("/v1/batches", json=batch_body(sky)), 202)
    stranger = api.other(STRANGER_KEY)
    for verb, path in (("get", ""), ("get", "/artifacts"), ("post", ":cancel"), ("post", ":retry")):
        answer = getattr(stranger, verb)(f"/v1/batches/{batch['id']}{path}")
        expect_problem(answer, 404, "batch_not_found")
    assert stranger.get("/v1/batches").json()["items"] == []
    job = expect(api.post("/v1/renders", json=render_body(sky)), 202)
    expect_problem(stranger.get(f"/v1/jobs/{job['id']}"), 404, "job_not_found")


def render_body(sky: str) -> dict[str, Any]:
    """Return one picture."""
    return {
        "bundle_id": "bundle_x",
        "environments": [{"environment_id": sky}],
        "cameras": {"views": ["turntable_001"]},
    }


def test_an_order_of_pictures_is_no_batch(api: Api, sky: str):
    job = expect(api.post("/v1/renders", json=render_body(sky)), 202)
    assert job["id"] not in str(expect(api.get("/v1/batches"), 200))
    expect_problem(api.get("/v1/batches/render_x"), 404, "batch_not_found")
    answer = api.post("/v1/jobs", json={"scene_id": "scene_x", "preset": "tiny", "kind": "batch"})
    expect_problem(answer, 422, "invalid_request")


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path, local_slots=2) as stage:
        add_bundle(stage.api, tmp_path, FILES)
        yield stage


def test_a_run_is_told_its_part_and_the_files_that_it_needs(stage: Stage, tmp_path: Path):
    sky = add_environment(stage.api, tmp_path)
    batch = expect(stage.api.post("/v1/batches", json=batch_body(sky)), 202)
    stage.controller.turn()
    for shard, job_id in enumerate(batch["job_ids"][:2]):
        start = stage.call("Start", job_id)
        assert start.kind == "batch"
        assert not start.check_scene
        assert [file.path for file in start.files] == [
            "bundles/bundle_x/cameras.json",
            "bundles/bundle_x/manifest.json",
            "bundles/bundle_x/models/weights.bin",
            f"environments/{sky}.exr",
        ]
        assert (start.render.shard, start.render.num_shards) == (shard, 2)
        spec = RenderSpec.model_validate_json(start.render.spec)
        assert [asset.called for asset in spec.assets] == ["bundle_x", "red"]
        assert [light.name for light in spec.environments] == ["bright_sky", "turned"]
        assert spec.environments[1].rotate_deg == 90.0
        assert spec.assets[0].material.albedo is None
        request = worker_pb2.GetBlobRequest(fence={"job_id": job_id, "run": 1}, sha256=start.files[0].sha256)
        from support.runs import metadata

        pieces = stage.stub.GetBlob(request, metadata=metadata(job_id, 1, None))
        assert b"".join(piece.data for piece in pieces) == CAMERAS


def test_what_runs_report_is_in_the_batch(stage: Stage, tmp_path: Path):
    sky = add_environment(stage.api, tmp_path)
    batch = expect(stage.api.post("/v1/batches", json=batch_body(sky)), 202)
    stage.controller.turn()
    first, second, last = batch["job_ids"]

    def show() -> dict[str, Any]:
        return dict(stage.api.get(f"/v1/batches/{batch['id']}").json())

    progress = {"stage": "render", "step": 4, "num_steps": 6, "fraction": 0.66}
    finding = {"type": "finding", "name": "red/x", "message": "environment.x: broken"}
    stage.call("Report", first, sequence=1, progress=progress, events=[finding])
    assert (show()["state"], show()["num_done"], show()["num_failed"]) == ("running", 4, 1)
    data = stage.put(first, b"picture")
    made = {"path": "red/x.png", "sha256": data, "size_bytes": 7, "media_type": "image/png"}
    stage.call("Publish", first, artifacts=[made])
    (artifact,) = expect(stage.api.get(f"/v1/batches/{batch['id']}/artifacts"), 200)["items"]
    assert (artifact["name"], artifact["job_id"]) == ("red/x.png", first)
    assert stage.api.get(artifact["url"]).content == b"picture"
    assert show()["state"] == "running"
    stage.call("Fail", second, cause=worker_pb2.FAIL_CAUSE_BAD_CONFIG, code="render.all_failed", message="no")
    assert show()["state"] == "running", "the table and the sheet are still to be made"
    stage.end(0)
    table = {"path": "pictures.csv", "sha256": stage.put(last, b"table"), "size_bytes": 5}
    cause = worker_pb2.FAIL_CAUSE_BAD_CONFIG
    failed = {"cause": cause, "code": "render.parts_failed", "message": "1 of 2", "artifacts": [table]}
    stage.call("Fail", last, **failed)
    assert show()["state"] == stage.job(last)["state"] == "failed"
    listed = expect(stage.api.get(f"/v1/batches/{batch['id']}/artifacts"), 200)["items"]
    assert [each["name"] for each in listed] == ["pictures.csv", "red/x.png"], "what was made can be had"
    again = expect(stage.api.post(f"/v1/batches/{batch['id']}:retry"), 202)
    assert again["job_ids"][0] == first
    assert again["job_ids"][1] != second
    assert again["job_ids"][2] != last, "what sums up the parts is made again with them"


def test_the_last_job_waits_for_the_parts_and_gets_what_they_leave(stage: Stage, tmp_path: Path):
    sky = add_environment(stage.api, tmp_path)
    batch = expect(stage.api.post("/v1/batches", json=batch_body(sky)), 202)
    first, second, last = batch["job_ids"]
    stage.controller.turn()
    published = []
    for name in ("pictures.jsonl", "tiles.zip", "red/x.png"):
        data = stage.put(first, name.encode())
        made = {"path": name, "sha256": data, "size_bytes": len(name), "media_type": "image/png"}
        published.append(made)
    finding = {"type": "finding", "name": "red/y", "message": "environment.x: broken: a map"}
    stage.call("Report", first, sequence=1, events=[finding, finding])
    stage.call("Publish", first, artifacts=published)
    stage.executor.gone[1] = 0
    stage.controller.turn()
    assert stage.job(last)["state"] == "queued", "one part is not made yet"
    stage.call("Fail", second, cause=worker_pb2.FAIL_CAUSE_BAD_CONFIG, code="render.all_failed", message="no")
    stage.end(0)
    start = stage.call("Start", last)
    assert [file.path for file in start.files] == [
        "parts/000/pictures.jsonl",
        "parts/000/tiles.zip",
        f"environments/{sky}.exr",
    ]
    assert (start.render.shard, start.render.num_shards) == (2, 2)
    told = [(each.path, each.code, each.message) for each in start.render.failures]
    assert told == [("red/y", "environment.x", "broken: a map"), (f"{second}/*", "render.all_failed", "no")]
    progress = {"stage": "contact_sheet", "step": 5, "num_steps": 5, "fraction": 1.0}
    stage.call("Report", last, sequence=1, progress=progress)
    assert stage.api.get(f"/v1/batches/{batch['id']}").json()["num_done"] == 0, "sheets are not pictures"


def test_a_part_that_is_tried_again_alone_brings_a_new_table_with_it(stage: Stage, tmp_path: Path):
    sky = add_environment(stage.api, tmp_path)
    batch = expect(stage.api.post("/v1/batches", json=batch_body(sky)), 202)
    first, _, last = batch["job_ids"]
    expect(stage.api.post(f"/v1/jobs/{first}:cancel"), 202)
    expect(stage.api.post(f"/v1/jobs/{first}:retry"), 202)
    again = stage.api.get(f"/v1/batches/{batch['id']}").json()["job_ids"]
    assert again[2] == last, "the old one has not begun"
    expect(stage.api.post(f"/v1/batches/{batch['id']}:cancel"), 202)
    fresh = expect(stage.api.post(f"/v1/jobs/{again[0]}:retry"), 202)
    newest = stage.api.get(f"/v1/batches/{batch['id']}").json()["job_ids"]
    assert newest[0] == fresh["id"]
    assert newest[1] == again[1]
    assert newest[2] != last


def test_every_field_of_an_order_reaches_the_run(stage: Stage, tmp_path: Path):
    sky = add_environment(stage.api, tmp_path)
    asset = {
        "name": "a",
        "bundle_id": "bundle_x",
        "material": {"albedo_gain": [2.0, 1.0, 1.0], "albedo": [0.1, 0.0, 0.3], "roughness_scale": 0.0},
        "object_rotate_deg": 10.0,
    }
    light = {
        "name": "e",
        "environment_id": sky,
        "axes": "mitsuba",
        "layout": "mirror-ball",
        "mend": True,
        "sun_clamp": 9.0,
        "rotate_deg": 8.0,
    }
    body = {
        "name": "all",
        "assets": [asset],
        "environments": [light],
        "cameras": [
            {"name": "c", "turntable": 3, "elevation_deg": 0.0, "radius": 2.0, "start_deg": 5.0, "size": 6},
            {"poses": json.loads(CAMERAS)["cameras"][:1]},
        ],
        "qualities": [{"name": "q", "indirect": False, "seed": 3, "exposure_ev": -1.0}],
        "output": {"files": ["exr"], "passes": [], "half": False, "path": "p/{camera}"},
    }
    batch = expect(stage.api.post("/v1/batches", json={**body, "shards": 1}), 202)
    stage.controller.turn()
    start = stage.call("Start", batch["job_ids"][0])
    assert RenderSpec.model_validate_json(start.render.spec) == RenderSpec.model_validate(body)

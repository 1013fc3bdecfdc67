"""`lambent admin` in the database of a server that may be running."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.admin.commands import app
from support.admin import admin, administered, listed
from support.api import STRANGER, TENANT, Api, expect
from typer.testing import CliRunner


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with administered(tmp_path / "data") as api:
        yield api


def test_drain_and_maintenance_are_told_and_taken_back(api: Api):
    api.job()
    admin(api, "drain", "--message", "new disks")
    admin(api, "maintenance", "on", "--message", "back at noon", "--retry-after", "90")
    notices = expect(api.get("/v1/notices"), 200)
    assert {name: each["message"] for name, each in notices.items()} == {
        "drain": "new disks",
        "maintenance": "back at noon",
    }
    (status,) = listed(api, "status")
    assert (status["jobs"], status["processes"], status["webhooks_waiting"]) == ({"queued": 1}, 0, 0)
    assert status["drain"]["message"] == "new disks"
    assert "back at noon" in admin(api, "status").stdout
    admin(api, "drain", "off")
    admin(api, "maintenance", "off")
    assert expect(api.get("/v1/notices"), 200) == {"drain": None, "maintenance": None}


def test_drain_waits_until_no_run_is_left(api: Api, monkeypatch: pytest.MonkeyPatch):
    from lambent_server.admin import commands
    from lambent_server.jobs.queries import require_job
    from lambent_server.jobs.rows import RUNNING, SUCCEEDED, move

    job = api.job()["id"]

    def step(state: str) -> None:
        with api.services.database.write() as connection:
            assert move(connection, require_job(connection, TENANT, job), state)

    step(RUNNING)
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 3:
            step(SUCCEEDED)

    monkeypatch.setattr(commands.time, "sleep", sleep)
    admin(api, "drain", "--wait")
    assert len(slept) == 3


def test_jobs_are_cancelled_by_filter_and_only_when_asked_twice(api: Api):
    wanted = [api.job(labels={"show": "a"})["id"] for _ in range(2)]
    kept = api.job(labels={"show": "b"})["id"]
    result = admin(api, "jobs", "cancel", "--label", "show=a")
    assert "nothing was changed" in result.stderr
    assert [each["state"] for each in listed(api, "jobs", "list")] == ["queued"] * 3
    admin(api, "jobs", "cancel", "--label", "show=a", "--yes")
    cancelled = [each["id"] for each in listed(api, "jobs", "list", "--state", "cancelled")]
    assert cancelled == wanted
    assert api.get(f"/v1/jobs/{kept}").json()["state"] == "queued"


def test_failed_jobs_are_queued_again_as_new_ones(api: Api):
    from lambent_server.jobs.queries import require_job
    from lambent_server.jobs.rows import FAILED, move

    jobs = [api.job(labels={"show": "a"}, priority=3)["id"] for _ in range(2)]
    with api.services.database.write() as connection:
        for job, code in zip(jobs, ("run_crashed", "bad_scene"), strict=True):
            error = {"code": code, "message": "", "cause": "internal", "run": 1}
            assert move(connection, require_job(connection, TENANT, job), FAILED, error=error)
    admin(api, "jobs", "requeue", "--error", "run_crashed", "--yes")
    queued = expect(api.get("/v1/jobs", params={"state": "queued"}), 200)["items"]
    assert [(each["labels"], each["priority"], each["id"] in jobs) for each in queued] == [
        ({"show": "a"}, 3, False)
    ]


def test_filters_of_jobs(api: Api):
    job = api.job()["id"]
    assert [each["id"] for each in listed(api, "jobs", "list", job)] == [job]
    assert listed(api, "jobs", "list", "--older-than", "1h") == []
    assert listed(api, "jobs", "list", "--tenant", STRANGER.id) == []
    assert listed(api, "jobs", "list", "--kind", "render") == []
    assert job in admin(api, "jobs", "list", "--kind", "train").stdout
    admin(api, "jobs", "list", "--older-than", "soon", code=2)
    admin(api, "jobs", "list", "--label", "show", code=2)
    admin(api, "jobs", "list", "--yes", code=2)


def test_webhooks_of_all_tenants_are_listed_disabled_and_enabled(api: Api):
    webhook = expect(api.post("/v1/webhooks", json={"url": "https://example.com/hook?secret"}), 201)["id"]
    text = admin(api, "webhooks", "list").stdout
    assert webhook in text
    assert "https://example.com" in text
    assert "secret" not in text
    delivery = expect(api.post(f"/v1/webhooks/{webhook}:ping"), 202)["id"]
    admin(api, "webhooks", "disable", webhook)
    assert expect(api.get(f"/v1/webhooks/{webhook}"), 200)["disabled_reason"] == "asked"
    (failed,) = listed(api, "webhooks", "deliveries", "--state", "failed")
    assert (failed["id"], failed["url"]) == (delivery, "https://example.com")
    assert "webhook_disabled" in admin(api, "webhooks", "redeliver").stderr
    admin(api, "webhooks", "enable", webhook)
    assert admin(api, "webhooks", "redeliver").stdout.split() == [delivery]
    assert expect(api.get(f"/v1/deliveries/{delivery}"), 200)["state"] == "pending"
    assert "webhook_not_found" in admin(api, "webhooks", "disable", "webhook_x", code=4).stderr


def test_reconcile_removes_what_no_row_names_and_counts_what_is_missing(api: Api):
    assert "0 blobs are missing" in admin(api, "reconcile").stdout
    scene = api.scene({"a.json": b"{}"})
    assert scene
    for file in (api.services.settings.data / "store" / "blobs").glob("*/*"):
        file.unlink()
    assert "1 blobs are missing" in admin(api, "reconcile", code=1).stdout
    assert recorded(api, "-")[-1] == ("reconcile", "")


def test_reconcile_leaves_the_folder_of_a_running_server_alone(api: Api):
    from lambent_server.serving import sole_user

    with sole_user(api.services.settings.data):
        assert "serve.data_in_use" in admin(api, "reconcile", code=2).stderr


def test_keys_are_among_the_commands(api: Api):
    data = str(api.services.settings.data)
    result = CliRunner().invoke(app, ["keys", "list", "--data", data])
    assert result.exit_code == 0
    assert "key_test" in result.stdout


def test_a_folder_without_a_server_is_said(tmp_path: Path):
    result = CliRunner().invoke(app, ["status", "--data", str(tmp_path)])
    assert (result.exit_code, "admin.no_server" in result.stderr) == (2, True)


def recorded(api: Api, org: str) -> list[tuple[str, str]]:
    """Return action and target of the entries that operators have made in the log of an organisation."""
    lines = admin(api, "audit", "export", "--org", org).stdout.splitlines()
    found = [json.loads(line) for line in lines]
    return [(each["action"], each["target"]) for each in found if each["actor_kind"] == "operator"]


def test_whatever_an_operator_changes_is_in_the_audit_log(api: Api):
    job = api.job()["id"]
    # What only shows something, or is refused, is not a change.
    admin(api, "jobs", "cancel", job)
    assert recorded(api, "default") == []
    admin(api, "jobs", "cancel", job, "--yes")
    admin(api, "jobs", "requeue", job, "--yes")
    webhook = expect(api.post("/v1/webhooks", json={"url": "https://example.com/"}), 201)["id"]
    delivery = expect(api.post(f"/v1/webhooks/{webhook}:ping"), 202)["id"]
    admin(api, "webhooks", "disable", webhook)
    admin(api, "webhooks", "redeliver")
    admin(api, "webhooks", "enable", webhook)
    admin(api, "webhooks", "redeliver")
    assert recorded(api, "default") == [
        ("jobs cancel", job),
        ("jobs requeue", job),
        ("webhooks disable", webhook),
        ("webhooks enable", webhook),
        ("webhooks redeliver", delivery),
    ]
    admin(api, "drain", "--message", "new disks")
    admin(api, "maintenance", "on")
    admin(api, "maintenance", "off")
    assert recorded(api, "-") == [("drain", ""), ("maintenance", ""), ("maintenance", "")]
    entries = [json.loads(line) for line in admin(api, "audit", "export", "--org", "-").stdout.splitlines()]
    assert entries[0]["details"] == {"switch": "on", "message": "new disks"}
    assert [each["details"]["switch"] for each in entries[1:]] == ["on", "off"]

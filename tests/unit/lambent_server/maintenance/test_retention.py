"""Retention: what is old goes, what is labelled or needed stays, and nothing goes before it was shown."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts import audit
from lambent_server.accounts.who import operator
from lambent_server.core.clock import now
from lambent_server.database.cluster_schema import run_logs
from lambent_server.database.schema import bundles, jobs, scenes
from lambent_server.database.tenancy import add, change, rows
from lambent_server.maintenance import retention
from support.admin import admin, administered
from support.api import STRANGER_KEY, TENANT, Api, expect
from support.server_rows import add_bundle

DAY = 86400.0


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with administered(tmp_path / "data") as api:
        yield api


def due(api: Api, *arguments: str) -> dict[str, set[str]]:
    """Return what the command lists or deletes, by kind."""
    found: dict[str, set[str]] = {}
    for line in admin(api, "retention", "run", "default", "--json", *arguments).stdout.splitlines():
        row = json.loads(line)
        assert row["deleted"] is bool(arguments)
        found.setdefault(row["kind"], set()).add(row["id"])
    return found


def grow_old(api: Api, table: Any, *identifiers: str, days: float = 31.0) -> None:
    at = now() - days * DAY
    values = {"finished_at": at} if table is jobs else {"created_at": at}
    with api.services.database.write() as connection:
        for identifier in identifiers:
            connection.execute(change(TENANT, table).where(table.c.id == identifier).values(**values))


def ended_job(api: Api, **order: Any) -> str:
    job = api.job(**order)["id"]
    expect(api.post(f"/v1/jobs/{job}:cancel"), 202)
    log = api.services.settings.runs / job / "run-1.log"
    log.parent.mkdir(parents=True)
    log.write_text("it ran")
    return str(job)


def test_what_is_old_enough_is_listed_first_and_then_deleted(api: Api):
    old, young, kept = ended_job(api), ended_job(api), ended_job(api, labels={"keep": "for the show"})
    scene, used = api.scene(), api.scene()
    api.job(used)
    bundle = add_bundle(api, api.services.settings.data, {"manifest.json": b"{}"})
    grow_old(api, jobs, old, kept)
    grow_old(api, scenes, scene, used)
    grow_old(api, bundles, bundle)
    assert due(api) == {}
    ages = ("--jobs", "30d", "--scenes", "30d", "--bundles", "30d")
    assert "30 days" in admin(api, "retention", "set", "default", *ages).stdout
    assert due(api) == {"jobs": {old}, "scenes": {scene, used}, "bundles": {bundle}}
    # It was only listed.
    expect(api.get(f"/v1/jobs/{old}"), 200)
    with api.services.database.read() as connection:
        assert not [each for each in audit.entries(connection, TENANT) if each.action == "retention"]
    rows_shown = admin(api, "retention", "run", "default", "--yes", "--json").stdout.splitlines()
    deleted = {row["id"] for row in map(json.loads, rows_shown) if row["deleted"]}
    # A job that waits needs its scene.
    assert deleted == {old, scene, bundle}
    assert not (api.services.settings.runs / old).exists()
    for path, status in ((f"jobs/{young}", 200), (f"jobs/{kept}", 200), (f"jobs/{old}", 404)):
        expect_status(api, path, status)
    for path, status in ((f"scenes/{used}", 200), (f"scenes/{scene}", 404), (f"bundles/{bundle}", 404)):
        expect_status(api, path, status)
    with api.services.database.read() as connection:
        entries = [each for each in audit.entries(connection, TENANT) if each.action == "retention"]
    assert {each.target for each in entries} == deleted


def expect_status(api: Api, path: str, status: int) -> None:
    assert api.get(f"/v1/{path}").status_code == status, path


def test_logs_go_before_their_jobs(api: Api):
    old = ended_job(api)
    grow_old(api, jobs, old)
    admin(api, "retention", "set", "default", "--logs", "7d")
    assert due(api) == {"logs": {old}}
    assert due(api, "--yes") == {"logs": {old}}
    assert due(api) == {}
    expect_status(api, f"jobs/{old}", 200)
    assert not (api.services.settings.runs / old).exists()


def test_only_the_logs_go_where_the_leader_does_the_rest(api: Api):
    old, young, kept = ended_job(api), ended_job(api), ended_job(api, labels={"keep": ""})
    scene = api.scene()
    grow_old(api, jobs, old, kept)
    grow_old(api, scenes, scene)
    (api.services.settings.runs / old / "work").mkdir()
    admin(api, "retention", "set", "default", "--logs", "7d", "--jobs", "8d", "--scenes", "7d", "--enforce")
    assert retention.enforce(api.services, only_logs=True) == 1
    assert retention.enforce(api.services, only_logs=True) == 0
    expect_status(api, f"jobs/{old}", 200)
    expect_status(api, f"scenes/{scene}", 200)
    runs = api.services.settings.runs
    assert [path.name for path in (runs / old).iterdir()] == ["work"]
    assert (runs / young / "run-1.log").exists()
    assert (runs / kept / "run-1.log").exists()


def test_what_is_due_is_found_a_part_at_a_time(api: Api, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(retention, "AT_ONCE", 2)
    kept = [ended_job(api, labels={"keep": "x"}) for _ in range(3)]
    old = [ended_job(api) for _ in range(5)]
    for number, job in enumerate(kept + old):
        grow_old(api, jobs, job, days=40.0 - number)
    rules: dict[retention.Kind, float] = {"jobs": 30 * DAY, "logs": 30 * DAY}
    first = retention.due(api.services, TENANT, rules, 3)
    assert [each.id for each in first if each.kind == "jobs"] == old[:3]
    assert {each.id for each in first if each.kind == "logs"} <= set(old)
    assert len(first) == 6
    everything = retention.due(api.services, TENANT, rules, 100)
    assert {(each.kind, each.id) for each in everything} == {
        (kind, job) for kind in ("jobs", "logs") for job in old
    }


def test_a_copy_of_a_log_is_found_without_a_file(api: Api):
    old = ended_job(api)
    grow_old(api, jobs, old)
    (api.services.settings.runs / old / "run-1.log").unlink()
    rules: dict[retention.Kind, float] = {"logs": 7 * DAY}
    assert retention.due(api.services, TENANT, rules) == []
    with api.services.database.write() as connection:
        values = {"job_id": old, "run": 1, "sha256": "0" * 64, "size_bytes": 6, "created_at": now()}
        known = {name: value for name, value in values.items() if name in run_logs.c}
        connection.execute(add(TENANT, run_logs, **known))
    (found,) = retention.due(api.services, TENANT, rules)
    assert retention.delete(api.services, operator(TENANT), found)
    with api.services.database.read() as connection:
        assert connection.execute(rows(TENANT, run_logs)).all() == []


def test_a_file_stays_until_its_deletion_is_certain(api: Api, monkeypatch: pytest.MonkeyPatch):
    old = ended_job(api)
    grow_old(api, jobs, old)
    found = retention.due(api.services, TENANT, {"jobs": 30 * DAY, "logs": 30 * DAY})

    def fail(*_: Any, **__: Any) -> None:
        raise OSError("the disk of the database is full")

    monkeypatch.setattr(audit, "record", fail)
    for each in found:
        with pytest.raises(OSError, match="full"):
            retention.delete(api.services, operator(TENANT), each)
    assert {each.kind for each in found} == {"jobs", "logs"}
    assert (api.services.settings.runs / old / "run-1.log").read_text() == "it ran"
    expect_status(api, f"jobs/{old}", 200)


def test_the_server_applies_rules_only_when_told_to(api: Api):
    old = ended_job(api)
    grow_old(api, jobs, old)
    admin(api, "retention", "set", "default", "--jobs", "30d")
    assert retention.enforce(api.services) == 0
    admin(api, "retention", "set", "default", "--enforce")
    assert retention.enforce(api.services) == 1
    assert retention.enforce(api.services) == 0
    expect_status(api, f"jobs/{old}", 404)


def test_a_rule_is_taken_back_and_others_stay(api: Api):
    admin(api, "retention", "set", "default", "--jobs", "30d", "--scenes", "90d", "--enforce")
    shown = json.loads(admin(api, "retention", "set", "default", "--jobs", "never", "--json").stdout)
    assert shown == {"seconds": {"scenes": 90 * DAY}, "enforced": True}
    admin(api, "retention", "set", "default", "--jobs", "soon", code=2)
    admin(api, "retention", "set", "nobody", "--jobs", "1d", code=4)


def test_rules_of_one_organisation_are_not_those_of_another(api: Api):
    other = expect(api.other(STRANGER_KEY).post("/v1/scenes", json={"name": "s"}), 201)["id"]
    admin(api, "retention", "set", "default", "--scenes", "0s", "--enforce")
    mine = expect(api.post("/v1/scenes", json={"name": "s"}), 201)["id"]
    retention.enforce(api.services)
    expect_status(api, f"scenes/{mine}", 404)
    assert api.other(STRANGER_KEY).get(f"/v1/scenes/{other}").status_code == 200


def test_what_is_labelled_meanwhile_is_kept(api: Api):
    job = ended_job(api)
    scene = api.scene()
    grow_old(api, scenes, scene)
    grow_old(api, jobs, job)
    days: dict[retention.Kind, float] = {"scenes": 30 * DAY, "jobs": 30 * DAY, "logs": 30 * DAY}
    found = retention.due(api.services, TENANT, days)
    for path in (f"scenes/{scene}", f"jobs/{job}"):
        expect(api.patch(f"/v1/{path}", json={"labels": {"keep": "yes"}}), 200)
    labelled = [each for each in found if each.id in (scene, job)]
    assert sorted(each.kind for each in labelled) == ["jobs", "logs", "scenes"]
    assert not any(retention.delete(api.services, operator(TENANT), each) for each in labelled)
    assert (api.services.settings.runs / job / "run-1.log").exists()
    expect_status(api, f"scenes/{scene}", 200)
    expect_status(api, f"jobs/{job}", 200)

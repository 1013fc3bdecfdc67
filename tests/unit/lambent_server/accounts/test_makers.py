"""Keys, links, shares and subscriptions end with their maker, and have at most their maker's rights."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts import keys, makers
from lambent_server.accounts.scopes import ALL
from lambent_server.accounts.who import Who
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.database.cluster_schema import login_codes
from lambent_server.database.schema import api_keys, jobs, sessions, shares
from lambent_server.database.service_schema import webhooks
from lambent_server.database.tenancy import change, rows
from lambent_server.webhooks.claims import claim
from lambent_server.webhooks.places import Places
from starlette.testclient import TestClient
from support.api import TENANT, Api, expect, expect_problem
from support.eve import (
    DEMOTED,
    HOOK,
    LEAVES,
    PROMOTED,
    browser_of_eve,
    hers,
    id_of,
    make,
    opens,
    operate,
    robot,
    share,
    subscribe,
    told,
    with_eve,
    works,
)


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def api(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Api]:
    with with_eve(request.param, tmp_path) as api:
        yield api


@pytest.mark.parametrize("how", LEAVES)
def test_keys_that_a_person_made_end_with_them_however_many_keys_are_between(api: Api, how: str):
    first = hers(api)
    second = api.other(make(first)["key"])
    third = api.other(make(second, scopes=["read"])["key"])
    assert [works(each) for each in (first, second, third)] == [True] * 3
    operate(api, *LEAVES[how])
    assert [works(each) for each in (first, second, third)] == [False] * 3
    expect_problem(second.post("/v1/keys", json={"name": "more"}), 401, "not_authenticated")


def test_a_key_that_a_persons_key_made_may_do_what_the_person_may_now(api: Api):
    made = make(hers(api))
    client = api.other(made["key"])
    assert made["user_id"].startswith("user_")
    expect(client.post("/v1/scenes", json={"name": "s"}), 201)
    operate(api, *DEMOTED)
    assert works(client)
    expect_problem(client.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    expect_problem(client.post("/v1/keys", json={"name": "k"}), 403, "scope_missing")


def test_a_key_says_which_key_made_it(api: Api):
    maker = robot(api)
    assert make(maker)["made_by"] == id_of(api, maker)
    assert make(maker)["user_id"] is None


def test_no_key_hands_out_scopes_that_it_does_not_have(api: Api):
    narrow = robot(api, "--scope", "admin")
    assert make(narrow)["scopes"] == ["admin"]
    for wanted in (["read"], ["admin", "submit"], sorted(ALL)):
        problem = expect_problem(
            narrow.post("/v1/keys", json={"name": "k", "scopes": wanted}), 403, "scope_exceeded"
        )
        assert next(scope for scope in wanted if scope != "admin") in problem["detail"]
    assert make(robot(api), scopes=["read"])["scopes"] == ["read"]


def test_no_key_hands_out_more_time_than_it_has(api: Api):
    brief = robot(api, "--expires", "2h")
    made = make(brief)
    own = next(each for each in expect(api.get("/v1/keys"), 200)["items"] if each["name"] == "robot")
    assert made["expires_at"] == own["expires_at"]
    longer = brief.post("/v1/keys", json={"name": "k", "expires_in_s": 3 * 3600})
    problem = expect_problem(longer, 422, "expiry_exceeded")
    assert problem["errors"][0]["pointer"] == "#/expires_in_s"
    assert make(brief, expires_in_s=3600)["expires_at"] < own["expires_at"]
    assert make(robot(api))["expires_at"] is None


def test_revoking_a_key_ends_what_it_made_and_what_that_made_and_nothing_else(api: Api):
    first, other = robot(api), robot(api)
    second_key = make(first)
    second = api.other(second_key["key"])
    third = api.other(make(second)["key"])
    link, kept = share(third), share(first)
    subscription = subscribe(third)["id"]
    expect(api.delete(f"/v1/keys/{second_key['id']}"), 204)
    assert [works(each) for each in (first, second, third, other)] == [True, False, False, True]
    assert (opens(api, link), opens(api, kept)) == (False, True)
    shown = expect(api.get(f"/v1/webhooks/{subscription}"), 200)
    assert (shown["enabled"], shown["disabled_reason"]) == (False, makers.LEFT)


def test_a_key_that_was_revoked_a_moment_ago_makes_and_replaces_nothing(api: Api):
    """It was valid when its request came in."""
    client = robot(api)
    who = Who(tenant=TENANT, kind="key", id=id_of(api, client), scopes=ALL)
    made = make(client)
    expect(api.delete(f"/v1/keys/{who.id}"), 204)
    with api.services.database.write() as connection:
        with pytest.raises(Problem) as created:
            keys.create(connection, TENANT, keys.NewKey(name="late"), maker=who)
        with pytest.raises(Problem) as replaced:
            keys.rotate(connection, TENANT, made["id"], who)
    assert {created.value.code, replaced.value.code} == {"not_authenticated"}


@pytest.mark.parametrize("ends", ["revoked", "removed", "disabled", "deleted"])
@pytest.mark.parametrize("makes", ["create", "rotate"])
def test_a_key_that_is_being_made_while_an_earlier_one_ends_ends_too(api: Api, ends: str, makes: str):
    """Its maker's maker ends in the moment in which it is made, and is not its maker."""
    first = robot(api) if ends == "revoked" else hers(api)
    first_id, second = id_of(api, first), api.other(make(first)["key"])
    who = Who(tenant=TENANT, kind="key", id=id_of(api, second), scopes=ALL)
    began = threading.Event()

    def end() -> None:
        began.set()
        if ends == "revoked":
            with api.services.database.write() as connection:
                keys.revoke(connection, TENANT, first_id)
        else:
            operate(api, *LEAVES[ends])

    with ThreadPoolExecutor(1) as pool:
        with api.services.database.write() as connection:
            if makes == "create":
                made = keys.create(connection, TENANT, keys.NewKey(name="late"), maker=who)
            else:
                made = keys.rotate(connection, TENANT, who.id, who)
            ending = pool.submit(end)
            began.wait(5.0)
            time.sleep(0.5)
        ending.result(30.0)
    if ends == "removed":
        operate(api, *PROMOTED)
    assert not works(api.other(made.key))


def rotate(client: TestClient, key_id: str) -> Any:
    return client.post(f"/v1/keys/{key_id}:rotate")


def test_nobody_gets_the_secret_of_a_key_that_would_not_end_with_their_own(api: Api):
    eve, mate, machine = hers(api), robot(api), robot(api)
    child = api.other(make(machine)["key"])
    for client, key_id in (
        (mate, id_of(api, eve)),
        (eve, id_of(api, machine)),
        (mate, id_of(api, child)),
        (child, id_of(api, machine)),
        (hers(api), id_of(api, eve)),
    ):
        expect_problem(rotate(client, key_id), 403, "key_of_another")
    assert [works(each) for each in (eve, mate, machine, child)] == [True] * 4
    # The remedy that the message names.
    expect(mate.delete(f"/v1/keys/{id_of(api, eve)}"), 204)
    assert not works(eve)


def test_a_key_replaces_itself_and_those_that_it_made_however_many_are_between(api: Api):
    first = robot(api)
    second = api.other(make(first)["key"])
    third = make(second, scopes=["read"])
    fresh = expect(rotate(first, third["id"]), 201)
    assert (fresh["scopes"], fresh["made_by"]) == (["read"], id_of(api, second))
    again = api.other(expect(rotate(first, id_of(api, first)), 201)["key"])
    # It took over what others rely on, and no key.
    assert [works(each) for each in (first, second, api.other(fresh["key"]), again)] == [
        False,
        False,
        False,
        True,
    ]


def test_what_a_key_made_for_others_outlives_its_replacement_and_not_the_replacements_end(api: Api):
    old = robot(api)
    link, subscription = share(old), subscribe(old)["id"]
    job = expect(old.post("/v1/jobs", json={"scene_id": api.scene(), "preset": "tiny", "webhook": HOOK}), 202)
    fresh = api.other(expect(rotate(old, id_of(api, old)), 201)["key"])
    assert opens(api, link)
    # To the subscription, and to the webhook of the job.
    assert told(api, job) == 2
    expect(api.delete(f"/v1/keys/{id_of(api, fresh)}"), 204)
    assert not opens(api, link)
    assert told(api) == 0
    assert expect(api.get(f"/v1/webhooks/{subscription}"), 200)["disabled_reason"] == makers.LEFT


def test_an_operator_replaces_any_key(api: Api):
    client = hers(api)
    fresh = operate(api, "keys", "rotate", id_of(api, client))
    assert works(api.other(fresh))
    assert not works(client)


@pytest.mark.parametrize("how", [*LEAVES, "demoted"])
@pytest.mark.parametrize("by", ["key", "browser"])
def test_share_links_end_with_whoever_made_them(api: Api, how: str, by: str):
    link = share(hers(api) if by == "key" else browser_of_eve(api))
    kept = share(api.client)
    operate(api, *{**LEAVES, "demoted": DEMOTED}[how])
    assert (opens(api, link), opens(api, kept)) == (False, True)
    if how == "demoted":
        operate(api, *PROMOTED)
        assert opens(api, link), "a role counts as it is now"


def test_a_share_link_lasts_no_longer_than_the_key_that_made_it(api: Api):
    brief = robot(api, "--expires", "2h")
    share(brief, expires_in_s=7 * 86400)
    with api.services.database.read() as connection:
        (until,) = connection.execute(rows(TENANT, shares, shares.c.expires_at)).scalars()
    assert until <= now() + 2 * 3600
    link = share(robot(api))
    with api.services.database.write() as connection:
        ended = change(TENANT, api_keys).where(api_keys.c.name == "robot")
        connection.execute(ended.values(expires_at=now() - 1))
    assert not opens(api, link)


@pytest.mark.parametrize("how", [*LEAVES, "demoted"])
def test_subscriptions_and_webhooks_of_jobs_end_with_whoever_made_them(api: Api, how: str):
    eve = hers(api)
    subscription = subscribe(eve)["id"]
    order = {"scene_id": api.scene(), "preset": "tiny", "webhook": HOOK}
    before, after = (expect(eve.post("/v1/jobs", json=order), 202) for _ in range(2))
    assert told(api, before) == 2
    operate(api, *{**LEAVES, "demoted": DEMOTED}[how])
    assert told(api, after) == 0
    # A job that someone else queues again tells its end to nobody either.
    again = expect(api.post(f"/v1/jobs/{after['id']}:retry"), 202)
    assert told(api, again) == 0
    shown = expect(api.get(f"/v1/webhooks/{subscription}"), 200)
    assert shown["disabled_reason"] == ("" if how == "demoted" else makers.LEFT)
    # What waited from before is not sent any more.
    waiting = claim(api.services.database, api.services.settings, Places(api.services.settings))
    assert [row.secrets for row in waiting] == [()] * len(waiting)
    assert {row.webhook_id for row in waiting} == ({None, subscription} if how == "demoted" else {None})


def test_a_subscription_is_of_whoever_last_chose_its_address_or_enabled_it(api: Api):
    eve = hers(api)
    moved, renamed = subscribe(api.client)["id"], subscribe(api.client)["id"]
    taken, kept = subscribe(eve)["id"], subscribe(eve)["id"]
    expect(eve.patch(f"/v1/webhooks/{moved}", json={"url": f"{HOOK}/eve"}), 200)
    expect(eve.patch(f"/v1/webhooks/{renamed}", json={"name": "jobs"}), 200)
    expect(api.patch(f"/v1/webhooks/{kept}", json={"name": "jobs"}), 200)
    operate(api, *LEAVES["removed"])
    expect(api.patch(f"/v1/webhooks/{taken}", json={"enabled": True}), 200)
    found = {each["id"]: each["enabled"] for each in expect(api.get("/v1/webhooks"), 200)["items"]}
    assert found == {moved: False, renamed: True, taken: True, kept: False}
    assert told(api) == 2


def test_only_a_key_gives_a_job_a_webhook(api: Api):
    order = {"scene_id": api.scene(), "preset": "tiny"}
    browser = browser_of_eve(api)
    expect_problem(browser.post("/v1/jobs", json={**order, "webhook": HOOK}), 403, "key_needed")
    expect(browser.post("/v1/jobs", json=order), 202)
    expect(hers(api).post("/v1/jobs", json={**order, "webhook": HOOK}), 202)


def test_every_table_of_what_gives_access_or_tells_others_stores_a_maker():
    for table in (api_keys, sessions, shares, jobs, login_codes, webhooks):
        assert {"maker_user_id", "maker_key_id"} <= set(table.c.keys()), table.name

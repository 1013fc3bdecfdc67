"""Webhooks of a whole server: nothing is lost when it is killed, and two leaders deliver nothing at once."""

import contextlib
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from lambent import Client
from lambent.cli.app import run
from lambent.webhooks import verify
from lambent_server.cluster.wakeups import Wakeups
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.services import Services
from lambent_server.webhooks.claims import Claimed, Outcome, claim, lease_s, settle
from lambent_server.webhooks.places import Places
from lambent_server.webhooks.sender import Sender
from support.api import Api, expect, opened
from support.databases import postgresql
from support.live_server import LiveServer, wait_until
from support.webhook_receiver import Receiver, receiving

pytestmark = pytest.mark.slow
NEVER_S = 3600.0


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as receiver:
        yield receiver


@pytest.fixture(
    params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)],
)
def database(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Return the setting of each database."""
    if request.param == "sqlite":
        yield {}
        return
    with postgresql() as url:
        yield {"database": url}


def in_environment(receiver: Receiver, **more: Any) -> dict[str, Any]:
    """Return the receiver's settings as a server's environment has them."""
    values = {**receiver.settings, **more}
    return {
        name: ",".join(map(str, value)) if isinstance(value, tuple) else value
        for name, value in values.items()
    }


def test_what_was_committed_before_a_kill_is_delivered_after_it(
    tmp_path: Path, receiver: Receiver, database: dict[str, str]
):
    # Looks at the outbox once, when it starts, and never again.
    silent = in_environment(receiver, webhook_poll_s=NEVER_S, **database)
    with LiveServer(tmp_path / "data", **silent) as server:
        time.sleep(1.0)
        with Client(server.url, server.key) as client:
            webhook = client.webhooks.create(receiver.url, labels={"show": "a"})
            job = client.submit(
                server.scene(), preset="tiny", params={"num_steps": "2"}, labels={"show": "a"}
            )
        assert server.wait(job.id)["state"] == "succeeded"
        server.kill()
        assert receiver.got == []
        server.settings = {**server.settings, **in_environment(receiver)}
        server.start()
        wait_until(lambda: receiver.got)
        with Client(server.url, server.key) as client:
            (delivery,) = wait_until(
                lambda: [each for each in client.webhooks.deliveries() if each.state == "delivered"]
            )
    message = verify(webhook.secret, *receiver.got[0])
    assert (message["data"]["id"], message["type"]) == (job.id, "job.succeeded")
    assert receiver.ids == [delivery.id]


def test_an_attempt_that_a_kill_cut_off_is_made_again_with_the_same_id(tmp_path: Path, receiver: Receiver):
    receiver.answers = ["hang"]
    with LiveServer(tmp_path / "data", **in_environment(receiver)) as server:
        with Client(server.url, server.key) as client:
            delivery = client.webhooks.ping(client.webhooks.create(receiver.url).id)
        wait_until(lambda: receiver.got)
        server.kill()
        server.start()
        with Client(server.url, server.key) as client:
            wait_until(lambda: client.webhooks.delivery(delivery.id).state == "delivered")
    assert len(receiver.ids) >= 2
    assert set(receiver.ids) == {delivery.id}
    assert len({body for _, body in receiver.got}) == 1


def many(api: Api, receiver: Receiver, count: int) -> list[str]:
    """Return the ids of deliveries that are due."""
    webhook = expect(api.post("/v1/webhooks", json={"url": receiver.url}), 201)["id"]
    return [expect(api.post(f"/v1/webhooks/{webhook}:ping"), 202)["id"] for _ in range(count)]


def test_two_servers_that_both_believe_to_lead_make_no_attempt_twice(
    tmp_path: Path, receiver: Receiver, database: dict[str, str]
):
    receiver.slow_s = 0.02
    given = {**receiver.settings, "webhook_timeout_s": 20.0, **database}
    with opened(tmp_path / "data", **given) as api:
        ids = many(api, receiver, 40)
        settings = api.services.settings
        databases = [Database(settings.database_url) for _ in range(2)]
        senders = [
            Sender(
                Services(settings, each, api.services.store, Wakeups(), api.services.capacity), lambda: True
            )
            for each in databases
        ]
        for sender in senders:
            sender.start()
        wait_until(lambda: not expect(api.get("/v1/deliveries?state=pending"), 200)["items"])
        for sender in senders:
            sender.close()
        for each in databases:
            each.close()
    assert Counter(receiver.ids) == dict.fromkeys(ids, 1)


def test_a_claim_is_given_to_one_and_again_only_when_it_has_ended(
    tmp_path: Path, receiver: Receiver, database: dict[str, str], monkeypatch: pytest.MonkeyPatch
):
    with opened(tmp_path / "data", webhook_per_host=50, **receiver.settings, **database) as api:
        ids = many(api, receiver, 12)
        settings: Settings = api.services.settings
        four = settings.model_copy(update={"webhook_concurrency": 4, "tenant_share": 1.0})

        def take(_: int) -> list[Claimed]:
            with contextlib.closing(Database(settings.database_url)) as own:
                return claim(own, settings, Places(four))

        with ThreadPoolExecutor(6) as pool:
            claimed = [row for rows in pool.map(take, range(6)) for row in rows]
        while rows := take(0):
            claimed += rows
        assert sorted(row.id for row in claimed) == ids
        late = time.time() + lease_s(settings) + 1.0
        monkeypatch.setattr("lambent_server.webhooks.claims.now", lambda: late)
        (again, *_) = claim(api.services.database, settings, Places(four))
        first = next(row for row in claimed if row.id == again.id)
        # The first one comes back after all: what it says no longer counts.
        assert settle(api.services.database, settings, first, Outcome(status=410, error="status")) is None
        assert settle(api.services.database, settings, again, Outcome(status=200)) == "delivered"


def test_the_command_line_subscribes_pings_and_lists(
    tmp_path: Path, receiver: Receiver, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    with LiveServer(tmp_path / "data", **in_environment(receiver)) as server:
        monkeypatch.setenv("LAMBENT_URL", server.url)
        monkeypatch.setenv("LAMBENT_API_KEY", server.key)

        def lambent(*arguments: str, code: int = 0) -> list[list[str]]:
            assert run(arguments) == code
            return [line.split("\t") for line in capsys.readouterr().out.splitlines()]

        ((webhook, secret),) = lambent("webhooks", "create", receiver.url, "--event", "job.queued")
        ((delivery,),) = lambent("webhooks", "ping", webhook)
        verify(secret, *wait_until(lambda: receiver.got)[0])
        wait_until(lambda: lambent("webhooks", "deliveries")[0][1] == "delivered")
        assert lambent("webhooks", "deliveries", "--webhook", webhook)[0][:3] == [
            delivery,
            "delivered",
            "ping",
        ]
        scene = server.scene()
        ((job,),) = lambent("submit", scene, "--preset", "tiny", "--webhook", receiver.url)
        server.wait(job)
        assert lambent("change", job, scene, "--label", "shot=7") == [
            [f"{job} changed"],
            [f"{scene} changed"],
        ]
        with Client() as client:
            assert [each.id for each in client.jobs(label="shot=7")] == [job]
            wait_until(
                lambda: {each.event for each in client.webhooks.deliveries(job_id=job)} != {"job.queued"}
            )
            own = client.webhooks.job_secret()
        wait_until(lambda: any(b"job.succeeded" in body for _, body in receiver.got))
        verify(own, *next(each for each in receiver.got if b"job.succeeded" in each[1]))
        ((fresh,),) = lambent("webhooks", "rotate", webhook)
        assert fresh != secret
        assert lambent("webhooks", "disable", webhook)[0][1] == "disabled (asked)"
        assert lambent("webhooks", "enable", webhook)[0][1] == "enabled"
        lambent("webhooks", "redeliver", delivery)
        lambent("webhooks", "delete", webhook)
        assert lambent("webhooks", "list") == []

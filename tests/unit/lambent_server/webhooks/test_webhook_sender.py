"""Deliveries to a receiver on this machine: signed, repeated, limited, and never inside."""

import contextlib
import json
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent.webhooks import verify
from lambent_server.jobs.rows import SUCCEEDED, move
from lambent_server.webhooks.sender import Sender, look_up
from support.api import STRANGER_KEY, TENANT, Api, expect, opened
from support.databases import postgresql
from support.live_server import wait_until
from support.webhook_receiver import Receiver, receiving

FINAL_STATES = {"delivered", "failed"}


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as receiver:
        yield receiver


@contextlib.contextmanager
def delivering(
    folder: Path, receiver: Receiver, resolver: Callable[[str, int], list[str]] = look_up, **settings: Any
) -> Iterator[Api]:
    """Yield the interface of a server that delivers."""
    with opened(folder / "data", **{**receiver.settings, **settings}) as api:
        sender = Sender(api.services, lambda: True, resolver=resolver)
        sender.start()
        try:
            yield api
        finally:
            sender.close()


def subscribed(api: Api, receiver: Receiver, **more: Any) -> dict[str, Any]:
    """Return a subscription to what the receiver gets."""
    return expect(api.post("/v1/webhooks", json={"url": receiver.url, **more}), 201)


def pinged(api: Api, webhook: dict[str, Any]) -> str:
    """Return the id of a delivery."""
    return expect(api.post(f"/v1/webhooks/{webhook['id']}:ping"), 202)["id"]


def ended(api: Api, delivery_id: str) -> dict[str, Any]:
    """Return the delivery once there are no more attempts."""
    path = f"/v1/deliveries/{delivery_id}"
    return wait_until(lambda: (found := api.get(path).json())["state"] in FINAL_STATES and found, 20)


def finish(api: Api, job_id: str, **values: Any) -> None:
    """End a queued job as a run would."""
    from lambent_server.jobs.queries import require_job

    with api.services.database.write() as connection:
        assert move(connection, require_job(connection, TENANT, job_id), SUCCEEDED, **values)


def test_a_subscriber_is_told_of_the_end_of_a_job_in_a_signed_message(tmp_path: Path, receiver: Receiver):
    with delivering(tmp_path, receiver) as api:
        webhook = subscribed(api, receiver)
        job = api.job(labels={"shot": "12"})
        finish(api, job["id"], bundle_id="bundle_1")
        listed = wait_until(lambda: api.get("/v1/deliveries", params={"job": job["id"]}).json()["items"])
        found = ended(api, listed[0]["id"])
    (headers, body) = receiver.got[0]
    message = verify(webhook["secret"], headers, body)
    assert message["type"] == "job.succeeded"
    told = message["data"]
    assert (told["id"], told["bundle_id"], told["labels"], told["seq"]) == (
        job["id"],
        "bundle_1",
        {"shot": "12"},
        2,
    )
    assert headers["webhook-id"] == found["id"]
    assert headers[":path"] == "/hook?token=x"
    assert headers["host"] == f"127.0.0.1:{receiver.port}"
    assert (found["state"], found["num_attempts"], found["attempts"][0]["status"]) == ("delivered", 1, 204)
    assert len(receiver.got) == 1


def test_a_job_tells_its_own_webhook_of_its_end_only(tmp_path: Path, receiver: Receiver):
    with delivering(tmp_path, receiver) as api:
        job = api.job(webhook=receiver.url)
        assert job["webhook"] == receiver.url
        expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)
        wait_until(lambda: receiver.got, 20)
        found = api.get("/v1/deliveries").json()["items"]
        # The secret was made with the first delivery, if nobody had asked for it.
        secret = expect(api.get("/v1/webhook-secret"), 200)["secret"]
    assert [each["event"] for each in found] == ["job.cancelled"]
    assert verify(secret, *receiver.got[0])["data"]["state"] == "cancelled"


def test_only_the_asked_events_and_labels_are_told(tmp_path: Path, receiver: Receiver):
    with delivering(tmp_path, receiver) as api:
        subscribed(api, receiver, events=["job.queued"], labels={"show": "a"})
        api.job(labels={"show": "b"})
        expected = api.job(labels={"show": "a", "shot": "1"})["id"]
        wait_until(lambda: receiver.got, 20)
        items = api.get("/v1/deliveries").json()["items"]
        other = api.other("lk_of_a_stranger")
        assert expect(other.get("/v1/deliveries"), 200)["items"] == []
        assert other.get(f"/v1/deliveries/{items[0]['id']}").status_code == 404
    assert [(each["event"], each["job_id"]) for each in items] == [("job.queued", expected)]


def test_failures_are_repeated_with_the_same_id_and_body_until_one_is_accepted(
    tmp_path: Path, receiver: Receiver
):
    receiver.answers = [500, 301, "close", "hang", 429, 200]
    with delivering(tmp_path, receiver) as api:
        found = ended(api, pinged(api, subscribed(api, receiver)))
    assert len(set(receiver.ids)) == 1
    assert len({body for _, body in receiver.got}) == 1
    assert [(each["status"], each["error"]) for each in found["attempts"]] == [
        (500, "status"),
        (301, "redirected"),
        (None, "connection_failed"),
        (None, "timeout"),
        (429, "status"),
        (200, ""),
    ]
    assert {headers[":path"] for headers, _ in receiver.got} == {"/hook?token=x"}


@pytest.mark.parametrize(("answer", "error"), [("drip", "timeout"), ("flood", "")])
def test_neither_a_slow_answer_nor_an_endless_one_holds_an_attempt(
    tmp_path: Path, receiver: Receiver, answer: str, error: str
):
    receiver.answers = [answer]
    with delivering(tmp_path, receiver) as api:
        delivery = pinged(api, subscribed(api, receiver))
        path = f"/v1/deliveries/{delivery}"
        attempt = wait_until(lambda: api.get(path).json()["attempts"], 20)[0]
    assert attempt["error"] == error
    # The bad receiver continues for nine seconds.
    assert attempt["seconds"] < 6


def test_410_ends_a_subscription_and_all_that_waits(tmp_path: Path, receiver: Receiver):
    receiver.answers = [503, 410]
    with delivering(tmp_path, receiver, webhook_retry_s=1000.0, webhook_longest_retry_s=1000.0) as api:
        webhook = subscribed(api, receiver)
        first = pinged(api, webhook)
        wait_until(lambda: api.get(f"/v1/deliveries/{first}").json()["attempts"], 20)
        second = pinged(api, webhook)
        assert [ended(api, each)["state"] for each in (first, second)] == ["failed", "failed"]
        shown = expect(api.get(f"/v1/webhooks/{webhook['id']}"), 200)
        assert (shown["enabled"], shown["disabled_reason"]) == (False, "gone")
        assert api.post(f"/v1/webhooks/{webhook['id']}:ping").json()["code"] == "webhook_disabled"
        assert api.post(f"/v1/deliveries/{first}:redeliver").json()["code"] == "webhook_disabled"
        expect(api.patch(f"/v1/webhooks/{webhook['id']}", json={"enabled": True}), 200)
        expect(api.post(f"/v1/deliveries/{first}:redeliver"), 202)
        assert ended(api, first)["state"] == "delivered"
    assert receiver.ids == [first, second, first]


def test_after_a_day_a_delivery_has_failed(tmp_path: Path, receiver: Receiver):
    receiver.answers = [500] * 50
    with delivering(tmp_path, receiver, webhook_give_up_s=3.0) as api:
        found = ended(api, pinged(api, subscribed(api, receiver)))
    assert found["state"] == "failed"
    assert 2 <= found["num_attempts"] < 50


def test_a_replaced_secret_signs_for_a_while(tmp_path: Path, receiver: Receiver):
    with delivering(tmp_path, receiver, webhook_rotation_s=3.0) as api:
        old = subscribed(api, receiver)
        new = expect(api.post(f"/v1/webhooks/{old['id']}:rotate"), 200)
        ended(api, pinged(api, old))
        for secret in (old["secret"], new["secret"]):
            verify(secret, *receiver.got[0])
        time.sleep(3.0)
        ended(api, pinged(api, old))
    headers, body = receiver.got[1]
    verify(new["secret"], headers, body)
    assert len(headers["webhook-signature"].split()) == 1


def test_one_receiver_gets_few_at_once_and_does_not_hold_up_another(tmp_path: Path, receiver: Receiver):
    receiver.slow_s = 0.5
    with receiving() as quick:
        ports = (receiver.port, quick.port)
        with delivering(tmp_path, receiver, webhook_ports=ports, webhook_per_host=2) as api:
            slow, other = subscribed(api, receiver), subscribed(api, quick)
            many = [pinged(api, slow) for _ in range(8)]
            began = time.monotonic()
            ended(api, pinged(api, other))
            assert time.monotonic() - began < 1.5
            for each in many:
                assert ended(api, each)["state"] == "delivered"
    assert receiver.most_at_once == 2


@pytest.fixture
def hanging() -> Iterator[int]:
    """Yield a port that accepts connections and never answers."""
    with socket.create_server(("127.0.0.1", 0), backlog=256) as server:
        yield server.getsockname()[1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def test_a_tenant_whose_receivers_all_hang_delays_nobody_else(
    tmp_path: Path, receiver: Receiver, hanging: int, kind: str
):
    with contextlib.ExitStack() as stack:
        given: dict[str, Any] = {"webhook_ports": (receiver.port, hanging), "webhook_timeout_s": 6.0}
        if kind == "postgresql":
            given["database"] = stack.enter_context(postgresql())
        resolver = lambda *_: ["127.0.0.1"]  # noqa: E731
        api = stack.enter_context(delivering(tmp_path, receiver, resolver, **given))
        scene = api.scene()
        for number in range(100):
            api.job(scene, webhook=f"http://h{number}.example:{hanging}/hook")
        for job in api.get("/v1/jobs?limit=100").json()["items"]:
            expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)
        other = api.other(STRANGER_KEY)
        webhook = expect(other.post("/v1/webhooks", json={"url": receiver.url}), 201)
        for _ in range(3):
            time.sleep(1.0)
            began = time.monotonic()
            delivery = expect(other.post(f"/v1/webhooks/{webhook['id']}:ping"), 202)["id"]
            path = f"/v1/deliveries/{delivery}"
            wait_until(lambda path=path: other.get(path).json()["state"] == "delivered", 20)
            assert time.monotonic() - began < 2.0
        waiting = api.get("/v1/deliveries?state=pending&limit=100").json()["items"]
        assert len(waiting) > 80


def test_a_name_that_leads_inside_later_is_looked_up_again_and_refused(tmp_path: Path, receiver: Receiver):
    asked: list[str] = []

    def rebinding(host: str, _port: int) -> list[str]:
        asked.append(host)
        # The first attempt fails after its look-up, the second must not use that of the first.
        return ["127.0.0.1"] if len(asked) == 1 else ["10.0.0.1"] if len(asked) == 2 else ["127.0.0.1"]

    receiver.answers = [500]
    url = f"http://hook.example:{receiver.port}/hook"
    with delivering(tmp_path, receiver, rebinding) as api:
        webhook = expect(api.post("/v1/webhooks", json={"url": url}), 201)
        found = ended(api, pinged(api, webhook))
    assert [each["error"] for each in found["attempts"]] == ["status", "address_refused", ""]
    # One look-up for each attempt: what was checked is what was connected to.
    assert asked == ["hook.example"] * 3
    assert [headers["host"] for headers, _ in receiver.got] == [f"hook.example:{receiver.port}"] * 2


def test_a_name_with_a_private_address_among_public_ones_is_not_connected_to(
    tmp_path: Path, receiver: Receiver
):
    url = f"http://hook.example:{receiver.port}/hook"
    answers = ["127.0.0.1", "192.168.0.1"]
    with delivering(tmp_path, receiver, lambda *_: answers, webhook_give_up_s=0.01) as api:
        webhook = expect(api.post("/v1/webhooks", json={"url": url}), 201)
        found = ended(api, pinged(api, webhook))
    assert [each["error"] for each in found["attempts"]] == ["address_refused"]
    assert receiver.got == []


def test_the_next_address_is_tried_where_nobody_listens(tmp_path: Path, receiver: Receiver):
    url = f"http://hook.example:{receiver.port}/hook"
    answers = ["127.0.0.2", "127.0.0.1"]
    with delivering(tmp_path, receiver, lambda *_: answers, webhook_allowed=("127.0.0.0/8",)) as api:
        webhook = expect(api.post("/v1/webhooks", json={"url": url}), 201)
        assert ended(api, pinged(api, webhook))["num_attempts"] == 1


def test_a_look_up_that_hangs_is_a_timeout_and_holds_nobody_up(tmp_path: Path, receiver: Receiver):
    def slow(_host: str, _port: int) -> list[str]:
        time.sleep(3.0)
        return ["127.0.0.1"]

    url = f"http://hook.example:{receiver.port}/hook"
    with delivering(tmp_path, receiver, slow, webhook_give_up_s=0.01) as api:
        webhook = expect(api.post("/v1/webhooks", json={"url": url}), 201)
        found = ended(api, pinged(api, webhook))
    assert [each["error"] for each in found["attempts"]] == ["timeout"]
    assert receiver.got == []


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the certificate of hook.example, which signs itself, and its key."""
    folder = tmp_path_factory.mktemp("tls")
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
    ]
    command += ["-days", "2", "-subj", "/CN=hook.example", "-addext", "subjectAltName=DNS:hook.example"]
    command += ["-keyout", str(folder / "key.pem"), "-out", str(folder / "certificate.pem")]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "certificate.pem", folder / "key.pem"


def test_the_certificate_is_checked_against_the_name_and_not_the_address(
    tmp_path: Path, certificate: tuple[Path, Path]
):
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(*certificate)
    names: list[str] = []
    tls.sni_callback = lambda _socket, name, _context: names.append(name)
    with receiving(tls) as receiver:
        given = {"webhook_ca_file": certificate[0], "webhook_allow_http": False, "webhook_give_up_s": 0.01}
        with delivering(tmp_path, receiver, lambda *_: ["127.0.0.1"], **given) as api:
            states = {}
            for host in ("hook.example", "other.example"):
                order = {"url": f"https://{host}:{receiver.port}/"}
                webhook = expect(api.post("/v1/webhooks", json=order), 201)
                found = ended(api, pinged(api, webhook))
                states[host] = (found["state"], found["attempts"][0]["error"])
        assert states == {"hook.example": ("delivered", ""), "other.example": ("failed", "tls_failed")}
    assert names == ["hook.example", "other.example"]
    assert [headers["host"] for headers, _ in receiver.got] == [f"hook.example:{receiver.port}"]


def test_a_server_that_is_not_the_leader_delivers_nothing(tmp_path: Path, receiver: Receiver):
    leads = False
    with opened(tmp_path / "data", **receiver.settings) as api:
        sender = Sender(api.services, lambda: leads)
        sender.start()
        delivery = pinged(api, subscribed(api, receiver))
        time.sleep(0.3)
        assert expect(api.get(f"/v1/deliveries/{delivery}"), 200)["num_attempts"] == 0
        leads = True
        assert ended(api, delivery)["state"] == "delivered"
        sender.close()


def test_an_attempt_under_way_is_given_back_when_the_server_stops(tmp_path: Path, receiver: Receiver):
    receiver.answers = ["hang"]
    with opened(tmp_path / "data", **{**receiver.settings, "webhook_timeout_s": 30.0}) as api:
        sender = Sender(api.services, lambda: True)
        sender.start()
        delivery = pinged(api, subscribed(api, receiver))
        wait_until(lambda: receiver.got, 20)
        began = time.monotonic()
        sender.close()
        assert time.monotonic() - began < 3
        following = Sender(api.services, lambda: True)
        following.start()
        found = ended(api, delivery)
        following.close()
    assert (found["state"], found["num_attempts"]) == ("delivered", 1)
    assert receiver.ids == [delivery] * 2


def test_metrics_count_attempts_and_what_waits(tmp_path: Path, receiver: Receiver):
    receiver.answers = [500]
    with delivering(tmp_path, receiver, webhook_retry_s=1000.0, webhook_longest_retry_s=1000.0) as api:
        delivery = pinged(api, subscribed(api, receiver))
        wait_until(lambda: api.get(f"/v1/deliveries/{delivery}").json()["attempts"], 20)
        text = api.get("/metrics").text
    assert 'lambent_webhook_attempts_total{outcome="status"}' in text
    assert "lambent_webhooks_waiting 1.0" in text


def test_bodies_are_json_of_the_described_form(tmp_path: Path, receiver: Receiver):
    from lambent_server.webhooks.messages import DeliveredBody

    with delivering(tmp_path, receiver) as api:
        subscribed(api, receiver, events=["job.queued"])
        api.job()
        wait_until(lambda: receiver.got, 20)
    body = json.loads(receiver.got[0][1])
    assert DeliveredBody(**body).model_dump() == body

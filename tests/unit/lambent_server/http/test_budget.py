"""Limits of the requests of a kind that one client, one tenant and all together have in progress."""

from pathlib import Path

import pytest
from lambent_server.api.problems import Problem
from lambent_server.core.settings import Settings
from lambent_server.http.budget import (
    BODIES,
    REQUESTS,
    SIGN_INS,
    STREAMS,
    Budget,
    Place,
    client_of_address,
    kind_of,
)
from starlette.datastructures import Headers


@pytest.fixture
def budget(tmp_path: Path) -> Budget:
    """Return 16 places of each kind: 8 for a tenant, 4 for a client."""
    return Budget(
        Settings(data=tmp_path, max_connections=1024, max_streams=16, max_bodies=16, max_requests=16)
    )


def taken(budget: Budget, kind: str, *clients: str) -> Place:
    place = Place(budget, kind)
    place.take(*clients)
    return place


def refused(budget: Budget, kind: str, *clients: str) -> Problem:
    with pytest.raises(Problem) as caught:
        taken(budget, kind, *clients)
    assert caught.value.retryable
    assert caught.value.headers["retry-after"]
    return caught.value


def test_a_client_has_its_share_and_leaves_the_rest_to_others(budget: Budget):
    for _ in range(4):
        taken(budget, STREAMS, "address 10.0.0.1")
    problem = refused(budget, STREAMS, "address 10.0.0.1")
    assert (problem.status, problem.code) == (429, "quota_streams")
    assert problem.members["quota"] == {"name": "max_streams", "of": "address", "limit": 4, "used": 4}
    taken(budget, STREAMS, "address 10.0.0.2")


def test_a_key_has_its_share_wherever_it_is_used(budget: Budget):
    for number in range(4):
        taken(budget, REQUESTS, f"address 10.0.0.{number}", "key a")
    assert refused(budget, REQUESTS, "address 10.0.0.9", "key a").members["quota"]["of"] == "key"
    taken(budget, REQUESTS, "address 10.0.0.9", "key b")


def test_a_tenant_has_its_share_with_all_its_keys(budget: Budget):
    for number in range(8):
        taken(budget, REQUESTS, f"address 10.0.0.{number}", "tenant a", f"key {number}")
    quota = refused(budget, REQUESTS, "address 10.0.1.1", "tenant a", "key 9").members["quota"]
    assert quota == {"name": "max_requests", "of": "tenant", "limit": 8, "used": 8}
    taken(budget, REQUESTS, "address 10.0.1.1", "tenant b", "key 10")


def test_all_clients_together_have_so_many_places_of_one_kind_and_others_of_another(budget: Budget):
    for number in range(16):
        taken(budget, BODIES, f"address 10.0.0.{number}")
    problem = refused(budget, BODIES, "address 10.0.1.1")
    assert (problem.status, problem.code) == (503, "server_full")
    assert problem.members["quota"] == {"name": "max_bodies", "of": "server", "limit": 16, "used": 16}
    for kind in (STREAMS, REQUESTS, SIGN_INS):
        taken(budget, kind, "address 10.0.1.1")


def test_a_place_is_free_again_when_its_request_ends_and_after_a_refusal(budget: Budget):
    with Place(budget, REQUESTS) as place:
        place.take("address 10.0.0.1")
        place.take("tenant a", "key a")
        assert budget.in_use(REQUESTS) == budget.in_use(REQUESTS, "key a") == 1
    for _ in range(4):
        taken(budget, REQUESTS, "address 10.0.0.1", "key a")
    with Place(budget, REQUESTS) as place:
        place.take("address 10.0.0.2")
        with pytest.raises(Problem):
            place.take("key a")
    assert budget.in_use(REQUESTS, "address 10.0.0.2") == 0
    assert budget.in_use(REQUESTS) == 4


def test_a_body_that_does_not_come_moves_to_another_kind_and_back(budget: Budget):
    with Place(budget, REQUESTS) as place:
        place.take("address 10.0.0.1")
        place.move(BODIES, check=True)
        assert (budget.in_use(REQUESTS), budget.in_use(BODIES)) == (0, 1)
        assert budget.in_use(BODIES, "address 10.0.0.1") == 1
        place.move(REQUESTS, check=False)
        assert (budget.in_use(REQUESTS), budget.in_use(BODIES)) == (1, 0)
        for _ in range(4):
            taken(budget, BODIES, "address 10.0.0.1")
        with pytest.raises(Problem, match="body is still being sent"):
            place.move(BODIES, check=True)
        assert budget.in_use(REQUESTS) == 1
    assert budget.in_use(REQUESTS) == 0
    assert not [key for key in budget.used if key[0] == REQUESTS]


def test_kinds_are_told_by_the_head_of_a_request():
    none, large = Headers({}), Headers({"content-length": "70000"})
    assert kind_of("GET", "/v1/events", none) == STREAMS
    assert kind_of("POST", "/v1/jobs", none) == REQUESTS
    assert kind_of("PUT", "/v1/scenes/x/archive", large) == BODIES
    assert kind_of("POST", "/v1/login", large) == SIGN_INS
    # More digits than Python converts.
    assert kind_of("POST", "/v1/scenes", Headers({"content-length": "0" * 5000})) == BODIES
    assert kind_of("POST", "/v1/scenes", Headers({"content-length": "\u00b2"})) == REQUESTS
    for path in ("/healthz", "/readyz"):
        assert kind_of("GET", path, none) is None


def test_what_is_always_answered_takes_no_place(budget: Budget):
    for _ in range(1000):
        Place(budget, None).take("address 10.0.0.1")
    assert not budget.used


def test_an_address_stands_for_its_client():
    assert client_of_address("10.0.0.1") == client_of_address("::ffff:10.0.0.1")
    assert client_of_address("2001:db8::1") == client_of_address("2001:db8::2:3:4:5")
    assert client_of_address("2001:db8::1") != client_of_address("2001:db8:0:1::1")
    assert client_of_address("testclient") == "address testclient"


def test_fewer_connections_are_fewer_places_of_every_kind(tmp_path: Path):
    settings = Settings(data=tmp_path)
    whole, half = Budget(settings), Budget(settings, settings.max_connections // 2)
    for kind in (STREAMS, BODIES, REQUESTS):
        assert whole.limits[kind].total == getattr(settings, f"max_{kind}")
        assert half.limits[kind].total == pytest.approx(whole.limits[kind].total * 0.512, abs=1)
    for budget, connections in ((whole, settings.max_connections), (half, settings.max_connections // 2)):
        reserved = budget.max_waiting + sum(limits.total for limits in budget.limits.values())
        assert reserved == connections
        assert budget.max_waiting > connections / 8

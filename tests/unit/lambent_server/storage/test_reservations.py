"""Room for files that may be sent to a bucket: it counts until they are stored or can no longer be sent."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from lambent_server.accounts import quotas
from lambent_server.api.problems import Problem
from lambent_server.database.schema import blobs
from lambent_server.database.tenancy import add
from lambent_server.maintenance.housekeeping import sweep
from lambent_server.services import Services
from lambent_server.storage import reservations
from support.api import STRANGER, TENANT, Api, served, sha256

LIMITS = {"max_organisation_bytes": 1000, "store_reserved_s": 100.0, "store_url_s": 50.0}
api = served(databases=("sqlite", "postgresql"), **LIMITS)


@pytest.fixture
def services(api: Api) -> Services:
    return api.services


def reserve(services: Services, name: str, size: int, *, refuse: bool = True) -> None:
    with services.database.write() as connection:
        wanted = {sha256(name.encode()): size}
        quotas.reserve_bytes(connection, TENANT, services.settings, wanted, refuse=refuse)


def reserved(services: Services) -> float:
    with services.database.read() as connection:
        assert reservations.amount(connection, STRANGER) == 0.0
        return reservations.amount(connection, TENANT)


def test_plans_in_sum_do_not_pass_the_quota(services: Services):
    reserve(services, "a", 600)
    with pytest.raises(Problem, match="1200 bytes"):
        reserve(services, "b", 600)
    reserve(services, "b", 400)
    # Asking again for the same file takes no more.
    reserve(services, "a", 600)
    assert reserved(services) == 1000.0


def test_plans_at_once_do_not_pass_it_together(services: Services):
    def attempt(number: int) -> bool:
        try:
            reserve(services, f"file {number}", 90)
        except Problem:
            return False
        return True

    with ThreadPoolExecutor(10) as pool:
        assert sum(pool.map(attempt, range(30))) == 11
    assert reserved(services) == 990.0


def test_a_smaller_size_gives_back_nothing_while_the_larger_may_be_sent(services: Services):
    reserve(services, "a", 900)
    reserve(services, "a", 1)
    assert reserved(services) == 900.0
    with pytest.raises(Problem):
        reserve(services, "b", 200)


def test_files_of_runs_are_counted_and_not_refused(services: Services):
    reserve(services, "a", 5000, refuse=False)
    with pytest.raises(Problem):
        reserve(services, "b", 1)


def test_what_is_reserved_leaves_no_room_to_files_that_are_stored_otherwise(services: Services):
    reserve(services, "a", 900)
    with services.database.write() as connection:
        quotas.check_bytes(connection, TENANT, services.settings, 100.0)
        quotas.check_bytes(connection, TENANT, services.settings, 900.0, of=(sha256(b"a"),))
        with pytest.raises(Problem):
            quotas.check_bytes(connection, TENANT, services.settings, 101.0)


def test_a_stored_file_counts_once_and_its_address_is_remembered_while_it_is_valid(
    services: Services, monkeypatch: pytest.MonkeyPatch
):
    reserve(services, "a", 900)
    with services.database.write() as connection:
        values = {"sha256": sha256(b"a"), "size_bytes": 900.0, "media_type": "x", "touched_at": 0.0}
        connection.execute(add(TENANT, blobs, **values))
        reservations.use(connection, TENANT, sha256(b"a"), services.settings)
        assert quotas.used_bytes(connection, TENANT) == 900.0
        assert reservations.ended(connection) == []
    later = reservations.now() + 51.0
    monkeypatch.setattr(reservations, "now", lambda: later)
    with services.database.read() as connection:
        assert len(reservations.ended(connection)) == 1


def test_a_reservation_ends_with_a_sweep_unless_it_was_made_again(
    services: Services, monkeypatch: pytest.MonkeyPatch
):
    reserve(services, "a", 900)
    sweep(services)
    assert reserved(services) == 900.0
    later = reservations.now() + 101.0
    with monkeypatch.context() as patch:
        patch.setattr(reservations, "now", lambda: later)
        with services.database.read() as connection:
            (row,) = reservations.ended(connection)
        reserve(services, "a", 900)
        with services.database.write() as connection:
            reservations.forget(connection, row)
        assert reserved(services) == 900.0
        patch.setattr(reservations, "now", lambda: later + 101.0)
        sweep(services)
    assert reserved(services) == 0.0

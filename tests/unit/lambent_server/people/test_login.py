"""Sessions of one-time links: they end with the sessions in which the links were made."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.database.schema import sessions
from lambent_server.database.tenancy import rows
from support.api import TENANT, Api, expect, expect_problem
from support.eve import (
    browser_of_eve,
    code_of,
    opened_by,
    robot,
    with_eve,
    works,
)


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def api(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Api]:
    with with_eve(request.param, tmp_path) as api:
        yield api


def test_browsers_that_opened_links_of_each_other_log_out_together(api: Api):
    first = browser_of_eve(api)
    second = opened_by(api, first)
    third = opened_by(api, second)
    unused = [code_of(each) for each in (first, second, third)]
    assert [works(each) for each in (first, second, third)] == [True] * 3
    expect(first.post("/v1/logout"), 204)
    assert [works(each) for each in (first, second, third)] == [False] * 3
    for body in unused:
        expect_problem(api.other(None).post("/v1/login", json=body), 401, "login_code_invalid")


def test_a_browser_that_opened_a_link_of_another_logs_out_alone(api: Api):
    first = browser_of_eve(api)
    second = opened_by(api, first)
    expect(second.post("/v1/logout"), 204)
    assert (works(first), works(second)) == (True, False)


def test_a_session_lasts_no_longer_than_the_one_in_which_its_link_was_made(api: Api):
    first = browser_of_eve(api, 3600.0)
    opened_by(api, opened_by(api, first))
    with api.services.database.read() as connection:
        ends = list(connection.execute(rows(TENANT, sessions, sessions.c.expires_at)).scalars())
    assert len(ends) == 3
    assert max(ends) <= min(ends) + 0.1


def test_a_link_made_with_a_key_opens_a_session_with_the_scopes_of_that_key(api: Api):
    browser = opened_by(api, robot(api, "--scope", "admin", "--scope", "read"))
    assert expect(browser.get("/v1/me"), 200)["scopes"] == ["admin", "read"]
    expect_problem(browser.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")

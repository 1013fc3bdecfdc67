"""Sign-ins, and the organisations they lead into, follow the last word of the provider or the proxy."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts import organisations, users
from lambent_server.accounts.sign_in import (
    RefusedError,
    Vouched,
    admit,
    of_claims,
    of_proxy,
    role_of,
    roles_of,
)
from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.tenancy import Tenant

GROUPS = "X-Groups"


def settings_of(folder: Path, **given: Any) -> Settings:
    values = {"login_header": "X-Name", "trusted_proxies": "10.0.0.1", "login_create": "everybody"}
    return Settings(data=folder, **{**values, **given})


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    with closing(Database(f"sqlite:///{tmp_path / 'x.sqlite'}")) as database:
        database.migrate()
        with database.write() as connection:
            for name in ("studio", "annex"):
                organisations.create(connection, Tenant(name), name)
        yield database


def enter(database: Database, groups: str | None, settings: Settings, name: str = "fay") -> dict[str, str]:
    """Return the roles of someone after a sign-in by the header of a proxy; {}: refused."""
    with database.write() as connection:
        try:
            user_id, _ = admit(connection, of_proxy(name, groups, settings), settings)
        except RefusedError:
            return {}
    with database.read() as connection:
        return {row.tenant_id: row.role for row in users.memberships(connection, user_id)}


def close(database: Database, name: str, at: float | None) -> None:
    with database.write() as connection:
        organisations.update(connection, Tenant(name), closed_at=at)


@pytest.mark.parametrize("groups", [None, "", " , "])
def test_who_has_lost_the_last_group_is_out(database: Database, tmp_path: Path, groups: str | None):
    settings = settings_of(tmp_path, login_organisations_header=GROUPS)
    assert enter(database, "studio:admin, annex", settings) == {"studio": "admin", "annex": "viewer"}
    assert enter(database, groups, settings) == {}


@pytest.mark.parametrize("groups", [None, "", ":admin"])
def test_a_stranger_without_groups_belongs_nowhere(database: Database, tmp_path: Path, groups: str | None):
    assert enter(database, groups, settings_of(tmp_path, login_organisations_header=GROUPS)) == {}
    claimed = settings_of(tmp_path, login_organisations_header=GROUPS, login_create="claimed")
    assert enter(database, groups, claimed, "gus") == {}
    with database.read() as connection:
        assert users.by_subject(connection, "proxy", "gus") is None


def test_without_a_header_for_organisations_nothing_is_said_about_them(database: Database, tmp_path: Path):
    settings = settings_of(tmp_path, login_role="editor")
    assert of_proxy("fay", "studio", settings).roles is None
    assert enter(database, None, settings) == {"default": "editor"}
    with database.write() as connection:
        user = users.by_subject(connection, "proxy", "fay")
        assert user is not None
        users.join(connection, Tenant("studio"), user.id, "admin", users.CLAIM)
    assert enter(database, None, settings) == {"default": "editor", "studio": "admin"}


def test_of_several_roles_in_one_organisation_the_most_holds(tmp_path: Path):
    most = {"studio": "admin"}
    for values in (["studio:admin", "studio:viewer"], ["studio:viewer", "studio", "studio:admin"]):
        assert roles_of(values, "editor") == most
    assert roles_of(["studio:viewer", "studio"], "editor") == {"studio": "editor"}
    assert roles_of(["studio:root", "studio:viewer", "annex"], "editor") == {
        "studio": "viewer",
        "annex": "editor",
    }
    assert role_of(["viewer", "admin", "editor"], settings_of(tmp_path)) == "admin"


def test_a_closed_organisation_keeps_its_members(database: Database, tmp_path: Path):
    settings = settings_of(tmp_path, login_organisations_header=GROUPS, login_create="claimed")
    both = {"studio": "admin", "annex": "viewer"}
    assert enter(database, "studio:admin,annex", settings) == both
    close(database, "studio", now())
    assert enter(database, "studio:admin,annex", settings) == {"annex": "viewer"}
    # Nobody becomes a user by a claim to what is closed.
    assert enter(database, "studio", settings, "gus") == {}
    with database.read() as connection:
        assert users.by_subject(connection, "proxy", "gus") is None
    close(database, "studio", None)
    with database.read() as connection:
        user = users.by_subject(connection, "proxy", "fay")
        assert user is not None
        assert {row.tenant_id: row.role for row in users.memberships(connection, user.id)} == both


def test_what_an_operator_has_given_stays(database: Database, tmp_path: Path):
    settings = settings_of(tmp_path, login_organisations_header=GROUPS)
    assert enter(database, "studio", settings) == {"studio": "viewer"}
    with database.write() as connection:
        user = users.by_subject(connection, "proxy", "fay")
        assert user is not None
        users.join(connection, Tenant("studio"), user.id, "admin")
    assert enter(database, "", settings) == {"studio": "admin"}
    assert enter(database, "studio:viewer", settings) == {"studio": "admin"}


def test_claims_without_the_claim_of_organisations_give_none(tmp_path: Path):
    settings = settings_of(tmp_path, oidc_issuer="https://id.example", oidc_client_id="l")
    claims = {"iss": "https://id.example", "sub": "a", "email": "a@example.com", "email_verified": "true"}
    found = of_claims(claims, settings)
    assert (found.roles, found.email, found.name) == (None, None, "a@example.com")
    with_claim = settings.model_copy(update={"oidc_organisation_claim": "groups"})
    assert of_claims(claims, with_claim).roles == {}


def test_nobody_gets_in_where_the_organisation_of_strangers_does_not_exist(
    database: Database, tmp_path: Path
):
    settings = settings_of(tmp_path, login_organisation="nowhere")
    with (
        pytest.raises(RefusedError, match="there is no organisation 'nowhere'"),
        database.write() as connection,
    ):
        admit(connection, of_proxy("fay", None, settings), settings)
    with database.read() as connection:
        assert users.by_subject(connection, "proxy", "fay") is None


@pytest.mark.parametrize("disabled", [False, True])
def test_an_address_is_bound_to_the_first_who_signs_in_with_it(
    database: Database, tmp_path: Path, disabled: bool
):
    settings = settings_of(tmp_path, login_create="nobody")
    with database.write() as connection:
        user = users.create(connection, name="Fay", email="fay@example.com")
        users.join(connection, Tenant("studio"), user.id, "editor")
        if disabled:
            users.change_user(connection, user.id, disabled_at=1.0)
    # A proxy vouches for a name that is an address, and any other name is not an one's.
    assert enter(database, None, settings, "fay") == {}
    found = enter(database, None, settings, "fay@example.com")
    assert found == ({} if disabled else {"studio": "editor"})
    vouched = Vouched(issuer="https://id.example", subject="2", name="F", email="fay@example.com", roles=None)
    words = "is disabled" if disabled else "belongs to another user"
    with pytest.raises(RefusedError, match=words), database.write() as connection:
        admit(connection, vouched, settings)


def test_without_a_name_a_person_is_called_by_what_the_provider_does_say(tmp_path: Path):
    settings = settings_of(tmp_path, oidc_issuer="https://id.example", oidc_client_id="l")
    claims = {"iss": "https://id.example", "sub": "1234", "name": "", "email_verified": True}
    assert of_claims(claims, settings).name == "1234"
    assert of_claims({**claims, "preferred_username": "fay"}, settings).name == "fay"
    assert len(of_claims({**claims, "name": "f" * 300}, settings).name) == 200

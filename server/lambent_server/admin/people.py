"""`lambent admin user` and `lambent admin key`: people, and keys of programs, of all organisations."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from pydantic import ValidationError
from sqlalchemy import Connection

from lambent_server.accounts import audit, keys, organisations, users
from lambent_server.accounts.who import operator
from lambent_server.admin.opened import JsonOption, YesOption, age, opened, print_rows
from lambent_server.api.problems import Problem, not_found
from lambent_server.cli import DatabaseOption, DataOption
from lambent_server.core.clock import now, rfc3339
from lambent_server.database.model import KeyRow
from lambent_server.database.rows import many
from lambent_server.database.schema import api_keys
from lambent_server.database.tenancy import Tenant, across_tenants

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    help="People who sign in, and the organisations they belong to.",
)
keys_app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Keys of programs, of all organisations."
)
UserArgument = Annotated[str, typer.Argument(metavar="USER", help="Id or e-mail address.")]
OrgOption = Annotated[str, typer.Option("--org", metavar="ORG", help="Id of the organisation.")]
RoleOption = Annotated[str, typer.Option("--role", help="viewer, editor or admin.")]
ScopeOption = Annotated[
    list[str], typer.Option("--scope", help="read, submit, render or admin; repeatable; all by default.")
]


@app.command()
def add(
    email: Annotated[
        str, typer.Argument(metavar="USER", help="E-mail address that the identity provider confirms, or id.")
    ],
    org: OrgOption = "default",
    role: RoleOption = "editor",
    name: Annotated[str, typer.Option(help="Name to show until the first sign-in.")] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Add a user, or give one another role or a further organisation."""
    tenant = Tenant(org)
    with opened(data, database) as services, services.database.write() as connection:
        organisations.require(connection, tenant)
        user = users.by_email(connection, email) or users.find(connection, email)
        if user is None:
            if "@" not in email:
                detail = f"there is no user {email!r}, and a new one needs an e-mail address"
                raise Problem(404, "user_not_found", detail)
            user = users.create(connection, name=name, email=email)
        users.join(connection, tenant, user.id, role)
        audit.record(connection, operator(tenant), "user add", user.id, details={"role": role})
    typer.echo(f"{user.id} is {role} of {org}")


@app.command()
def remove(
    user: UserArgument, org: OrgOption = "default", data: DataOption = None, database: DatabaseOption = None
) -> None:
    """Remove a user from an organisation; sessions and keys there end at once."""
    tenant = Tenant(org)
    with opened(data, database) as services, services.database.write() as connection:
        member = users.require(connection, user)
        if not users.leave(connection, tenant, member.id):
            raise not_found("member", user)
        audit.record(connection, operator(tenant), "user remove", member.id)
    typer.echo(f"{member.id} is no longer a member of {org}")


@app.command("list")
def list_users(
    org: Annotated[str, typer.Option("--org", metavar="ORG", help="Only members of this one.")] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List users with their role in each organisation."""
    with opened(data, database) as services, services.database.read() as connection:
        shown = []
        for row in users.everybody(connection):
            roles = {each.tenant_id: each.role for each in users.memberships(connection, row.id)}
            if org and org not in roles:
                continue
            seen = row.last_seen_at
            shown.append(
                {
                    **{name: getattr(row, name) for name in ("id", "name", "email", "issuer")},
                    "roles": roles,
                    "last_seen_at": rfc3339(seen),
                    "disabled": row.disabled_at is not None,
                }
            )
    print_rows(shown, ("id", "email", "name", "roles", "last_seen_at", "disabled"), as_json)


def _change(
    done: str, user: str, data: Path | None, database: str | None, act: Callable[[Connection, str], None]
) -> None:
    """Do something to a user, and record it in the log of each organisation, or of the server."""
    with opened(data, database) as services, services.database.write() as connection:
        user_id = users.require(connection, user).id
        member_of = sorted(row.tenant_id for row in users.memberships(connection, user_id))
        act(connection, user_id)
        for tenant_id in member_of or [audit.SERVER.id]:
            audit.record(connection, operator(Tenant(tenant_id)), f"user {done.removesuffix('d')}", user_id)
    typer.echo(f"{user_id} {done}")


@app.command()
def disable(user: UserArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Sign a user out everywhere and refuse further sign-ins; the user's keys stop working."""

    def end(connection: Connection, user_id: str) -> None:
        users.change_user(connection, user_id, disabled_at=now())
        users.end_sessions(connection, user_id)
        users.revoke_keys(connection, user_id)

    _change("disabled", user, data, database, end)


@app.command()
def enable(user: UserArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Let a disabled user sign in again; keys stay revoked."""
    _change("enabled", user, data, database, partial(users.change_user, disabled_at=None))


@app.command()
def delete(
    user: UserArgument, yes: YesOption = False, data: DataOption = None, database: DatabaseOption = None
) -> None:
    """Delete a user: name, address, sessions and keys. What the user made stays with the organisation.

    The audit log keeps the id, which then identifies no one.
    """
    if yes:
        _change("deleted", user, data, database, users.forget)
        return
    with opened(data, database) as services, services.database.read() as connection:
        row = users.require(connection, user)
        member_of = sorted(each.tenant_id for each in users.memberships(connection, row.id))
    typer.echo(f"{row.id} {row.name} {row.email or ''} of {', '.join(member_of)}")
    typer.echo("nothing was changed: add --yes", err=True)


@keys_app.command("create")
def create_key(
    name: Annotated[str, typer.Argument(help="What the key is for.")],
    org: OrgOption = "default",
    scope: ScopeOption = [],  # noqa: B006 - typer reads it once
    expires: Annotated[str, typer.Option(metavar="AGE", help="Valid for so long: 12h, 90d.")] = "",
    user: Annotated[str, typer.Option(help="Owner of the key: id or address of a member.")] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Create a key and print it; it is shown only this once."""
    tenant = Tenant(org)
    try:
        order = keys.NewKey.model_validate(
            {"name": name, "scopes": scope or None, "expires_in_s": age(expires) if expires else None}
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise typer.BadParameter(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    with opened(data, database) as services, services.database.write() as connection:
        organisations.require(connection, tenant)
        user_id = users.require_member(connection, tenant, user) if user else None
        made = keys.create(connection, tenant, order, user_id=user_id)
        audit.record(
            connection, operator(tenant), "key create", made.id, details={"scopes": list(made.scopes)}
        )
    typer.echo(made.key)


@keys_app.command("list")
def list_keys(
    org: Annotated[str, typer.Option("--org", metavar="ORG", help="Only of this one.")] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List keys, without the keys themselves."""
    statement = across_tenants(api_keys).order_by(api_keys.c.tenant_id, api_keys.c.id.desc())
    if org:
        statement = statement.where(api_keys.c.tenant_id == org)
    with opened(data, database) as services, services.database.read() as connection:
        shown = [
            {"org": row.tenant_id, **keys.show(row).model_dump()}
            for row in many(connection, statement, KeyRow)
        ]
    names = ("id", "org", "name", "scopes", "last_used_at", "expires_at", "revoked_at")
    print_rows(shown, names, as_json)


@keys_app.command()
def revoke(
    key: Annotated[str, typer.Argument(metavar="KEY", help="Id of the key.")],
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Revoke a key for good."""
    with opened(data, database) as services, services.database.write() as connection:
        statement = across_tenants(api_keys, api_keys.c.tenant_id).where(api_keys.c.id == key)
        tenant_id = connection.execute(statement).scalar_one_or_none()
        if tenant_id is None:
            raise not_found("key", key)
        keys.revoke(connection, Tenant(tenant_id), key)
        audit.record(connection, operator(Tenant(tenant_id)), "key revoke", key)
    typer.echo(f"{key} revoked")

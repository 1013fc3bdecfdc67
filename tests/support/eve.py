"""Eve, an admin of an organisation, her keys and browsers, and what she and others make."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lambent_server.accounts import users
from lambent_server.admin.commands import app
from lambent_server.core.secrets import read_or_create, sha256_text
from lambent_server.database.engine import Database
from lambent_server.database.schema import api_keys
from lambent_server.database.tenancy import rows
from lambent_server.http.identity import COOKIE, open_session
from starlette.testclient import TestClient
from support.api import TENANT, Api, expect, opened
from support.databases import postgresql
from support.server_rows import add_bundle
from typer.testing import CliRunner

EVE = "eve@example.com"
CSRF = {"x-lambent-csrf": "1"}
HOOK = "https://hooks.example/hook"
LEAVES = {
    "removed": ("user", "remove", EVE, "--org", "default"),
    "disabled": ("user", "disable", EVE),
    "deleted": ("user", "delete", EVE, "--yes"),
}
DEMOTED = ("user", "add", EVE, "--org", "default", "--role", "viewer")
PROMOTED = ("user", "add", EVE, "--org", "default", "--role", "admin")


@contextlib.contextmanager
def with_eve(kind: str, folder: Path) -> Iterator[Api]:
    """Yield an interface on a database of a kind, with Eve, an admin, and a bundle."""
    with contextlib.ExitStack() as stack:
        given: dict[str, Any] = {}
        if kind == "postgresql":
            given["database"] = stack.enter_context(postgresql())
            database = Database(given["database"].replace("postgresql:", "postgresql+psycopg:"))
            stack.enter_context(contextlib.closing(database)).migrate()
        api = stack.enter_context(opened(folder / "data", **given))
        read_or_create(folder / "data" / "worker.secret")
        operate(api, *PROMOTED)
        add_bundle(api, folder, {"manifest.json": b"{}"})
        yield api


def operate(api: Api, *arguments: str) -> str:
    """Return what a command of an operator prints."""
    settings = api.services.settings
    where = ["--data", str(settings.data)]
    where += [] if settings.database is None else ["--database", settings.database]
    result = CliRunner().invoke(app, [*arguments, *where])
    assert result.exit_code == 0, result.output
    return result.stdout.strip()


def hers(api: Api, *arguments: str) -> TestClient:
    """Return a client with a key that an operator has made for Eve."""
    return api.other(operate(api, "key", "create", "hers", "--org", "default", "--user", EVE, *arguments))


def robot(api: Api, *arguments: str) -> TestClient:
    """Return a client with a key that an operator has made for nobody in particular."""
    return api.other(operate(api, "key", "create", "robot", "--org", "default", *arguments))


def make(client: TestClient, **order: Any) -> dict[str, Any]:
    """Return a key that the key of a client makes."""
    return expect(client.post("/v1/keys", json={"name": "made", **order}), 201)


def id_of(api: Api, client: TestClient) -> str:
    """Return the id of the key of a client."""
    digest = sha256_text(client.headers["authorization"].partition(" ")[2])
    with api.services.database.read() as connection:
        mine = rows(TENANT, api_keys, api_keys.c.id).where(api_keys.c.key_sha256 == digest)
        return str(connection.execute(mine).scalar_one())


def works(client: TestClient) -> bool:
    return client.get("/v1/scenes").status_code == 200


def browser_of_eve(api: Api, lifetime_s: float = 60.0) -> TestClient:
    with api.services.database.write() as connection:
        token = open_session(connection, TENANT, lifetime_s, users.require(connection, EVE).id)
    return with_cookie(api, token)


def with_cookie(api: Api, token: str) -> TestClient:
    browser = api.other(None)
    browser.cookies.set(COOKIE, token, domain="localhost.local")
    browser.headers |= CSRF
    return browser


def code_of(client: TestClient) -> dict[str, str]:
    """Return the body that redeems a new one-time link of this client."""
    link = expect(client.post("/v1/login-links"), 201)["url"]
    return {"code": link.partition("#code=")[2]}


def opened_by(api: Api, client: TestClient) -> TestClient:
    """Return a browser that has opened a one-time link of this client."""
    browser = api.other(None)
    expect(browser.post("/v1/login", json=code_of(client)), 204)
    browser.headers |= CSRF
    return browser


def share(client: TestClient, **body: Any) -> str:
    """Return the token of a share link."""
    made = expect(client.post("/v1/bundles/bundle_x/shares", json=body), 201)
    return str(made["url"].partition("#")[2])


def opens(api: Api, token: str) -> bool:
    return api.other(token).get("/v1/bundles/bundle_x/manifest").status_code == 200


def subscribe(client: TestClient) -> dict[str, Any]:
    order = {"url": HOOK, "events": ["job.cancelled"]}
    return expect(client.post("/v1/webhooks", json=order), 201)


def told(api: Api, job: dict[str, Any] | None = None) -> int:
    """Return how many deliveries there are once a job was cancelled: this one, or one without a webhook."""
    job = job or api.job()
    expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)
    return len(expect(api.get(f"/v1/deliveries?job={job['id']}"), 200)["items"])

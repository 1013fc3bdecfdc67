"""The REST interface in memory: the whole application behind its gate, without sockets and without runs."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import structlog
from lambent_server.accounts import organisations
from lambent_server.app import make_app
from lambent_server.core.clock import now
from lambent_server.core.secrets import sha256_text
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.schema import api_keys
from lambent_server.database.tenancy import DEFAULT_TENANT_ID, Tenant, add_if_absent
from lambent_server.http.identity import issue_login_code
from lambent_server.services import Services, open_services
from starlette.testclient import TestClient
from support.databases import postgresql

KEY = "lk_of_the_test"
TENANT = Tenant(DEFAULT_TENANT_ID)
STRANGER_KEY = "lk_of_a_stranger"
STRANGER = Tenant("stranger")


def sha256(data: bytes) -> str:
    """Return the lower-case hexadecimal SHA-256."""
    return hashlib.sha256(data).hexdigest()


@dataclass
class Api:
    """One application and a client with a key."""

    services: Services
    client: TestClient
    app: Any

    def __getattr__(self, name: str) -> Any:
        return getattr(self.client, name)

    def other(self, key: str | None) -> TestClient:
        """Return a client with another key, or none."""
        headers = {} if key is None else {"Authorization": f"Bearer {key}"}
        return TestClient(self.client.app, base_url="http://localhost", headers=headers)

    def login_code(self) -> str:
        """Return the code of a one-time link that the server itself has made."""
        with self.services.database.write() as connection:
            return issue_login_code(connection, TENANT, 60.0)[0]

    def scene(self, files: dict[str, bytes] | None = None, *, commit: bool = True) -> str:
        """Return a scene with these files."""
        files = files or {"transforms_train.json": b"{}"}
        scene_id = str(self.post("/v1/scenes", json={"name": "a scene"}).json()["id"])
        plan = [{"path": path, "size": len(data), "sha256": sha256(data)} for path, data in files.items()]
        expect(self.post(f"/v1/scenes/{scene_id}/files:plan", json=plan), 200)
        for data in files.values():
            expect(self.put(f"/v1/scenes/{scene_id}/files/{sha256(data)}", content=data), 204)
        if commit:
            expect(self.post(f"/v1/scenes/{scene_id}:commit"), 200)
        return scene_id

    def job(self, scene_id: str | None = None, **order: Any) -> dict[str, Any]:
        """Return a queued job."""
        body = {"scene_id": scene_id or self.scene(), "preset": "tiny", **order}
        return expect(self.post("/v1/jobs", json=body), 202)


def drop_event(*_: object) -> Any:
    """Keep the tests quiet: rendering a traceback for the terminal takes seconds."""
    raise structlog.DropEvent


def expect(answer: Any, status: int) -> Any:
    """Return the JSON of an answer with this status ({} where there is none)."""
    assert answer.status_code == status, answer.text
    return answer.json() if answer.content else {}


def expect_problem(answer: Any, status: int, code: str) -> dict[str, Any]:
    """Return a problem document, having checked that it is a whole one."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    document = json.loads(answer.content)
    assert document["code"] == code, document
    assert document["status"] == status
    assert {"type", "title", "detail", "retryable", "errors", "request_id"} <= set(document)
    assert document["request_id"] == answer.headers["x-request-id"]
    return document


@cache
def empty_tables() -> bytes:
    """Return a database file with all tables and no rows, which takes a fifth of a second to make."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "lambent.sqlite"
        database = Database(f"sqlite:///{path}")
        database.migrate()
        database.close()
        return path.read_bytes()


@contextmanager
def opened(data: Path, **settings: Any) -> Iterator[Api]:
    """Yield the interface on an empty data folder."""
    structlog.configure(processors=[drop_event])
    values = {"data": data, "disk_floor_bytes": 0, "local_gpus": 0, **settings}
    if "database" not in settings and not (data / "lambent.sqlite").exists():
        data.mkdir(parents=True, exist_ok=True)
        (data / "lambent.sqlite").write_bytes(empty_tables())
    services = open_services(Settings(**values))
    with services.database.write() as connection:
        if organisations.find(connection, STRANGER) is None:
            organisations.create(connection, STRANGER, STRANGER.id)
        for tenant, key, name in ((TENANT, KEY, "test"), (STRANGER, STRANGER_KEY, "stranger")):
            values = {"id": f"key_{name}", "name": name, "key_sha256": sha256_text(key), "created_at": now()}
            add_if_absent(connection, tenant, api_keys, **values)
    app, gate = make_app(services)
    headers = {"Authorization": f"Bearer {KEY}"}
    try:
        with TestClient(gate, base_url="http://localhost", headers=headers) as client:
            yield Api(services, client, app)
    finally:
        services.database.close()


def served(*, scope: Any = "function", databases: Sequence[str] = (), **settings: Any) -> Any:
    """Return a fixture that yields the interface on an empty data folder, on each of these databases."""
    marked = [
        pytest.param(each, marks=pytest.mark.services if each == "postgresql" else ()) for each in databases
    ]

    @pytest.fixture(scope=scope, params=marked or None)
    def api(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
        with ExitStack() as stack:
            given = dict(settings)
            if getattr(request, "param", "sqlite") == "postgresql":
                given["database"] = stack.enter_context(postgresql())
            yield stack.enter_context(opened(tmp_path_factory.mktemp("api") / "data", **given))

    return api

"""Keys of programs: made, seen once, revoked, replaced; by REST and on the data folder."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from lambent_server.accounts import audit
from lambent_server.accounts.keys import FILE, accept_file
from lambent_server.cli import keys as command
from support.api import KEY, STRANGER_KEY, TENANT, Api, expect, expect_problem, opened
from typer.testing import CliRunner

cli = typer.Typer()
cli.command()(command)


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data") as api:
        yield api


def create(api: Api, **order: object) -> dict[str, str]:
    return expect(api.post("/v1/keys", json={"name": "laptop", **order}), 201)


def accept(api: Api) -> str:
    """Return the key in the file, after a start of the server."""
    accept_file(api.services.database, TENANT, api.services.settings.data)
    return (api.services.settings.data / FILE).read_text().strip()


def works(api: Api, key: str) -> bool:
    return api.other(key).get("/v1/jobs").status_code == 200


def test_a_key_is_shown_once_and_works_until_it_is_revoked(api: Api):
    made = create(api)
    assert works(api, made["key"])
    listed = expect(api.get("/v1/keys"), 200)["items"]
    assert [row["name"] for row in listed] == ["test", "laptop"]
    assert made["key"] not in str(listed)
    expect(api.delete(f"/v1/keys/{made['id']}"), 204)
    expect(api.delete(f"/v1/keys/{made['id']}"), 204)
    assert not works(api, made["key"])
    assert works(api, KEY)
    revoked = expect(api.get("/v1/keys"), 200)["items"][1]
    assert revoked["revoked_at"] is not None
    expect_problem(api.post(f"/v1/keys/{made['id']}:rotate"), 409, "key_revoked")


def test_a_key_ends_by_itself_where_that_was_ordered(api: Api, monkeypatch: pytest.MonkeyPatch):
    made = create(api, expires_in_s=60)
    assert works(api, made["key"])
    import time

    monkeypatch.setattr("lambent_server.accounts.makers.now", lambda: time.time() + 61)
    assert not works(api, made["key"])


def test_a_rotated_key_is_replaced_by_one_of_the_same_name(api: Api):
    old = create(api)
    fresh = expect(api.post(f"/v1/keys/{old['id']}:rotate"), 201)
    assert fresh["name"] == "laptop"
    assert works(api, fresh["key"])
    assert not works(api, old["key"])


def test_a_rotation_that_fails_leaves_the_key_that_works_in_its_file(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    secret, file = accept(api), api.services.settings.data / FILE
    owner = api.other(secret)
    (own,) = (key for key in expect(owner.get("/v1/keys"), 200)["items"] if key["name"].startswith(FILE))
    with monkeypatch.context() as patched:
        patched.setattr(audit, "record", failing)
        assert owner.post(f"/v1/keys/{own['id']}:rotate").status_code == 500
    assert file.read_text().strip() == secret
    assert works(api, secret)
    fresh = expect(owner.post(f"/v1/keys/{own['id']}:rotate"), 201)["key"]
    assert file.read_text().strip() == fresh


def failing(*_: object, **__: object) -> None:
    raise RuntimeError


def test_revoking_a_key_logs_out_the_browsers_and_ends_the_links_it_may_have_made(api: Api):
    made = create(api)
    link = expect(api.other(made["key"]).post("/v1/login-links"), 201)["url"]
    browser = api.other(None)
    first = api.login_code()
    expect(browser.post("/v1/login", json={"code": first}), 204)
    expect(api.delete(f"/v1/keys/{made['id']}"), 204)
    expect_problem(browser.get("/v1/jobs"), 401, "not_authenticated")
    code = {"code": link.partition("#code=")[2]}
    expect_problem(browser.post("/v1/login", json=code), 401, "login_code_invalid")


def test_a_browser_and_a_stranger_manage_no_keys(api: Api):
    made = create(api)
    browser, stranger = api.other(None), api.other(STRANGER_KEY)
    code = api.login_code()
    expect(browser.post("/v1/login", json={"code": code}), 204)
    csrf = {"x-lambent-csrf": "1"}
    expect_problem(browser.get("/v1/keys"), 403, "key_needed")
    expect_problem(browser.post("/v1/keys", json={"name": "x"}, headers=csrf), 403, "key_needed")
    expect_problem(browser.delete(f"/v1/keys/{made['id']}", headers=csrf), 403, "key_needed")
    expect_problem(stranger.delete(f"/v1/keys/{made['id']}"), 404, "key_not_found")
    expect_problem(stranger.post(f"/v1/keys/{made['id']}:rotate"), 404, "key_not_found")
    assert [row["name"] for row in expect(stranger.get("/v1/keys"), 200)["items"]] == ["stranger"]
    assert works(api, made["key"])


def test_a_key_whose_file_was_removed_ends_with_the_next_start(api: Api):
    old = accept(api)
    assert accept(api) == old
    assert works(api, old)
    (api.services.settings.data / FILE).unlink()
    new = accept(api)
    assert works(api, new)
    assert not works(api, old)


def test_what_a_start_does_with_keys_is_recorded(api: Api):
    def recorded() -> list[tuple[str, str, dict[str, object]]]:
        with api.services.database.read() as connection:
            entries = [each for each in audit.entries(connection, TENANT) if each.actor_kind == "operator"]
        return [(each.action, each.target, json.loads(each.details)) for each in entries]

    def newest() -> str:
        listed = expect(api.get("/v1/keys"), 200)["items"]
        return str(next(row["id"] for row in listed if row["name"].startswith(FILE)))

    before = len(recorded())
    (api.services.settings.data / FILE).unlink(missing_ok=True)
    accept(api)
    first = newest()
    accept(api)
    (api.services.settings.data / FILE).unlink()
    accept(api)
    made, replaced = recorded()[before:]
    assert made[:2] == ("serve key file", first)
    assert replaced == ("serve key file", newest(), {"revoked": [first]})


def test_rotating_the_key_of_the_file_writes_the_file(api: Api):
    old = accept(api)
    listed = expect(api.get("/v1/keys"), 200)["items"]
    (mine,) = (row for row in listed if row["name"].startswith(FILE))
    expect_problem(api.post(f"/v1/keys/{mine['id']}:rotate"), 403, "key_of_another")
    fresh = expect(api.other(old).post(f"/v1/keys/{mine['id']}:rotate"), 201)["key"]
    assert (api.services.settings.data / FILE).read_text().strip() == fresh
    assert (api.services.settings.data / FILE).stat().st_mode & 0o777 == 0o600
    assert works(api, fresh)
    assert not works(api, old)
    assert accept(api) == fresh


def test_a_file_whose_key_was_revoked_gets_another_one(api: Api):
    old = accept(api)
    listed = expect(api.get("/v1/keys"), 200)["items"]
    (mine,) = (row["id"] for row in listed if row["name"].startswith(FILE))
    expect(api.delete(f"/v1/keys/{mine}"), 204)
    new = accept(api)
    assert new != old
    assert works(api, new)
    assert not works(api, old)


def test_names_of_key_files_are_not_for_others(api: Api):
    expect_problem(api.post("/v1/keys", json={"name": "api.key"}), 422, "key_name_reserved")


def test_the_command_makes_lists_and_revokes_keys_of_a_running_server(api: Api):
    accept(api)

    def run(*arguments: str, code: int = 0) -> str:
        result = CliRunner().invoke(cli, [*arguments, "--data", str(api.services.settings.data)])
        assert result.exit_code == code, result.output
        return result.output.strip()

    made = run("create", "render farm")
    assert works(api, made)
    assert made not in run("list")
    line = next(line for line in run("list").splitlines() if "render farm" in line)
    fresh = run("rotate", line.split("\t")[0])
    assert works(api, fresh)
    assert not works(api, made)
    assert "keys.key_revoked" in run("rotate", line.split("\t")[0], code=4)
    newest = next(line for line in run("list").splitlines() if "render farm" in line)
    run("revoke", newest.split("\t")[0])
    assert not works(api, fresh)
    assert "keys.key_not_found" in run("revoke", "key_of_nobody", code=4)


def test_the_command_says_where_no_server_keeps_its_data(tmp_path: Path):
    result = CliRunner().invoke(cli, ["list", "--data", str(tmp_path)])
    assert result.exit_code == 2
    assert "keys.no_server" in result.output
    assert list(tmp_path.iterdir()) == []

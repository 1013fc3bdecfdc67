"""`lambent serve` says what is wrong instead of showing a traceback."""

import socket
from pathlib import Path

import pytest
import typer
from lambent_server.cli import serve
from lambent_server.core.settings import Settings
from typer.testing import CliRunner

app = typer.Typer()
app.command()(serve)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--database", "postgresql://me:secret@127.0.0.1:1/x"], "serve.database_unusable"),
        (["--database", "nonsense"], "serve.database_unusable"),
        (["--store", "nonsense://x"], "serve.store_unusable"),
        (["--host", "0.0.0.0"], "serve.insecure_address"),
        (["--executor", "dance"], "serve.setting_invalid"),
        (["--port", "70000"], "serve.setting_invalid"),
    ],
)
def test_a_setting_that_cannot_be_used_is_named(tmp_path: Path, arguments: list[str], code: str):
    result = CliRunner().invoke(app, ["--data", str(tmp_path / "data"), "--port", "0", *arguments])
    assert result.exit_code == 2
    assert result.output.startswith(code)
    assert "secret" not in result.output
    assert "Traceback" not in result.output


def test_a_folder_in_which_nobody_may_write_is_named():
    result = CliRunner().invoke(app, ["--data", "/sys", "--port", "0"])
    assert result.exit_code == 2
    assert result.output.startswith("serve.data_unusable: /sys/server.lock: ")
    assert "choose another folder with --data" in result.output


def test_a_data_folder_of_which_a_part_cannot_be_used_is_named(tmp_path: Path):
    (tmp_path / "scratch").write_text("no folder")
    result = CliRunner().invoke(app, ["--data", str(tmp_path), "--port", "0"])
    assert result.exit_code == 2
    assert result.output.startswith(f"serve.data_unusable: {tmp_path / 'scratch'}: ")


def test_an_empty_key_file_ends_the_start_with_what_to_do(tmp_path: Path):
    (tmp_path / "api.key").touch()
    result = CliRunner().invoke(app, ["--data", str(tmp_path), "--port", "0"])
    assert result.exit_code == 2
    assert result.output.startswith(f"serve.secret_invalid: {tmp_path / 'api.key'} ")


def test_a_port_in_use_is_named(tmp_path: Path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        result = CliRunner().invoke(app, ["--data", str(tmp_path / "data"), "--port", port])
    assert result.exit_code == 2
    assert result.output.startswith("serve.port_in_use")


def test_hosts_are_given_with_commas(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("LAMBENT_ALLOWED_HOSTS", "render.example, 10.0.0.7")
    assert Settings().allowed_hosts == ("render.example", "10.0.0.7")


def test_a_setting_that_is_no_json_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("LAMBENT_STAGE_STALL_AFTER_S", "joint")
    result = CliRunner().invoke(app, ["--data", str(tmp_path / "data")])
    assert result.exit_code == 2
    assert result.output.startswith("serve.setting_invalid")


def test_postgresql_urls_need_not_name_the_driver():
    assert Settings(database="postgresql://h/d").database_url == "postgresql+psycopg://h/d"

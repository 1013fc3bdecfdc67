"""`lambent serve` says what is wrong instead of showing a traceback."""

import socket
from pathlib import Path

import pytest
import typer
from lambent_server.cli import serve
from typer.testing import CliRunner

app = typer.Typer()
app.command()(serve)


def serving(*arguments: str) -> str:
    """Return what `lambent serve` says before it ends."""
    result = CliRunner().invoke(app, ["--port", "0", *arguments])
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    return result.output


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
    output = serving("--data", str(tmp_path / "data"), *arguments)
    assert output.startswith(code)
    assert "secret" not in output


def test_a_folder_in_which_nobody_may_write_is_named():
    output = serving("--data", "/sys")
    assert output.startswith("serve.data_unusable: /sys/server.lock: ")
    assert "choose another folder with --data" in output


@pytest.mark.parametrize(
    ("name", "text", "code"),
    [("scratch", "no folder", "data_unusable: {}: "), ("api.key", "", "secret_invalid: {} ")],
)
def test_a_part_of_the_data_folder_that_cannot_be_used_is_named(
    tmp_path: Path, name: str, text: str, code: str
):
    (tmp_path / name).write_text(text)
    assert serving("--data", str(tmp_path)).startswith(f"serve.{code.format(tmp_path / name)}")


def test_a_port_in_use_is_named(tmp_path: Path):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        output = serving("--data", str(tmp_path / "data"), "--port", str(other.getsockname()[1]))
    assert output.startswith("serve.port_in_use")


def test_a_setting_that_is_not_json_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("LAMBENT_STAGE_STALL_AFTER_S", "joint")
    assert serving("--data", str(tmp_path / "data")).startswith("serve.setting_invalid")

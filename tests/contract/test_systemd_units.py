"""The systemd unit: what systemd itself finds wrong with it, and what it starts."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from lambent.cli.app import build
from lambent_server.core.settings import Settings
from support.deployed import CACHES, END_S, SYSTEMD, rest_after_runs, unit, unit_command

UNIT = "lambent-server.service"
# Of systemd 254 and newer; older ones say that they ignore it.
NEWER = "Unknown key 'DelegateSubgroup'"
analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd here")


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """Return a folder with the unit, whose program exists."""
    text = (SYSTEMD / UNIT).read_text(encoding="utf-8")
    (tmp_path / UNIT).write_text(text.replace(unit_command(UNIT).words[0], "/bin/true"))
    return tmp_path


def verified(folder: Path) -> list[str]:
    """Return what systemd finds wrong with the unit in a folder."""
    command = ["systemd-analyze", "verify", "--man=no", str(folder / UNIT)]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line for line in found.stderr.splitlines() if line and NEWER not in line]
    return lines or ([f"exit code {found.returncode}"] if found.returncode else [])


@analyze
def test_systemd_finds_nothing_wrong(installed: Path):
    assert verified(installed) == []


@analyze
@pytest.mark.parametrize("wrong", ["NoNewPrivilege=yes", "SystemCallFilter=no_such_call", "KillMode=some"])
def test_a_mistake_would_be_noticed(installed: Path, wrong: str):
    path = installed / UNIT
    path.write_text(path.read_text().replace("[Service]\n", f"[Service]\n{wrong}\n"))
    assert verified(installed)


def test_the_server_is_not_killed_before_its_runs_have_had_their_time():
    service = unit(UNIT)["Service"]
    environment = unit_command(UNIT).environment
    assert environment["LAMBENT_STOP_RUNS_S"] == "240"
    assert rest_after_runs(float(service["TimeoutStopSec"][0]), environment) >= END_S
    # Runs get no signal from systemd, and no SIGKILL with their server.
    assert service["KillMode"] == ["process"]


def test_runs_inherit_a_working_directory_that_holds_nothing_but_the_program():
    lines = (SYSTEMD / UNIT).read_text(encoding="utf-8").splitlines()
    folders = [line.partition("=")[2] for line in lines if line.startswith("WorkingDirectory=")]
    assert folders == ["/opt/lambent"]
    assert Path(unit_command(UNIT).words[0]).is_relative_to(folders[0])


def test_compiled_kernels_are_kept_in_a_folder_that_systemd_makes():
    (folder,) = unit(UNIT)["Service"]["CacheDirectory"]
    environment = unit_command(UNIT).environment
    for name in CACHES:
        assert Path(environment[name]).is_relative_to(f"/var/cache/{folder}")


@analyze
def test_the_service_is_exposed_no_more_than_it_must_be(installed: Path):
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=30"]
    found = subprocess.run([*command, str(installed / UNIT)], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout[-2000:]


@pytest.mark.skipif(
    shutil.which("systemd-sysusers") is None or os.getuid() != 0,
    reason="needs systemd, and root to make users",
)
def test_user_and_folders_are_made(tmp_path: Path):
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc" / "passwd").write_text("root:x:0:0::/root:/bin/sh\n")
    (tmp_path / "etc" / "group").write_text("root:x:0:\n")
    for program, file in (("systemd-sysusers", "sysusers"), ("systemd-tmpfiles", "tmpfiles")):
        arguments = ["--create"] if file == "tmpfiles" else []
        command = [program, f"--root={tmp_path}", *arguments, str(SYSTEMD / f"lambent.{file}.conf")]
        subprocess.run(command, check=True, capture_output=True)
    assert "lambent:" in (tmp_path / "etc" / "passwd").read_text()
    assert (tmp_path / "var" / "lib" / "lambent").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "etc" / "lambent").stat().st_mode & 0o777 == 0o750


@pytest.mark.parametrize("commented", [False, True])
def test_command_and_variables_are_ones_that_lambent_understands(
    commented: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "database-password").write_text("word")
    command = unit_command(UNIT, commented=commented).replaced({"/etc/lambent": str(tmp_path)})
    root = build()
    context = root.make_context("lambent", command.words[1:])
    name, subcommand, rest = root.resolve_command(context, [*context._protected_args, *context.args])
    assert subcommand.make_context(name, rest, parent=context).params["data"] is None
    for key in [key for key in os.environ if key.startswith("LAMBENT_")]:
        monkeypatch.delenv(key)
    for key, value in command.environment.items():
        monkeypatch.setenv(key, value)
    names = {key for key in command.environment if key.startswith("LAMBENT_")}
    assert names <= {f"LAMBENT_{field.upper()}" for field in Settings.model_fields}
    settings = Settings()
    assert settings.data == Path("/var/lib/lambent")
    assert (settings.database is None) is not commented


def test_runs_outlive_their_server_and_their_files_too():
    service = unit(UNIT)["Service"]
    assert service["KillMode"] == ["process"]
    assert service["KillSignal"] == ["SIGTERM"]
    assert "PrivateTmp" not in service
    assert "memory pids" in service["Delegate"]

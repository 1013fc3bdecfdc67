"""docker-compose.yml and deploy/ against the command line and the files they name, without an engine."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from lambent.cli.app import build

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
DOCKERFILE = (ROOT / "deploy" / "lambent.Dockerfile").read_text(encoding="utf-8")


def parsed(command: list[str]) -> dict[str, Any]:
    """Return the values that `lambent` reads from `command`; raises what it would refuse it with."""
    root = build()
    context = root.make_context("lambent", list(command))
    name, subcommand, rest = root.resolve_command(context, [*context._protected_args, *context.args])
    return subcommand.make_context(name, rest, parent=context).params


@pytest.mark.parametrize("service", sorted(COMPOSE["services"]))
def test_the_command_of_a_service_is_one_that_lambent_understands(service: str):
    assert parsed(COMPOSE["services"][service]["command"])


def test_a_command_with_an_unknown_option_would_be_noticed():
    with pytest.raises(Exception, match="no-such-option"):
        parsed([*COMPOSE["services"]["server"]["command"], "--no-such-option"])


@pytest.mark.parametrize("service", sorted(COMPOSE["services"]))
def test_a_service_is_contained(service: str):
    settings = COMPOSE["services"][service]
    assert settings["init"] is True
    assert settings["user"].split(":")[0] != "0"
    assert settings["stop_grace_period"]
    assert all(port.startswith("127.0.0.1:") for port in settings.get("ports", []))


def test_every_file_that_the_image_copies_exists_and_is_sent_to_the_build():
    sent = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    for line in re.findall(r"^COPY (?!--from)(.+)$", DOCKERFILE, re.MULTILINE):
        for name in line.split()[:-1]:
            assert (ROOT / name).exists()
            assert f"!{name.split('/')[0]}" in sent


def test_the_user_of_the_image_is_the_user_of_the_services():
    (user,) = re.findall(r"^USER (\S+)$", DOCKERFILE, re.MULTILINE)
    assert {service["user"] for service in COMPOSE["services"].values()} == {user}


@pytest.mark.slow
def test_the_server_starts_with_its_command_and_passes_its_health_check(tmp_path: Path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    service = COMPOSE["services"]["server"]
    command = [part.replace("8420", port).replace("0.0.0.0", "127.0.0.1") for part in service["command"]]
    environment = os.environ | service["environment"] | {"LAMBENT_DATA": str(tmp_path)}
    check = [part.replace("8420", port) for part in service["healthcheck"]["test"][1:]]
    server = subprocess.Popen([sys.executable, "-m", "lambent", *command], env=environment)
    try:
        healthy = False
        deadline_s = time.monotonic() + 30.0
        while not healthy and server.poll() is None and time.monotonic() < deadline_s:
            result = subprocess.run([sys.executable, *check[1:]], capture_output=True, check=False)
            healthy = result.returncode == 0
        assert healthy
    finally:
        server.send_signal(getattr(signal, service["stop_signal"]))
        try:
            assert server.wait(timeout=20) == 0
        finally:
            server.kill()

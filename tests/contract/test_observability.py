"""Alert rules against the metrics of a server; with promtool and Prometheus, where they are installed.

Without them, names and labels in queries are found by a small reading of PromQL: a metric is a name of ours,
its labels are those in its braces and in `by (…)`.
"""

import contextlib
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families
from support.api import opened
from support.deployed import ROOT, compose
from support.live_server import LiveServer, wait_until

sys.path.insert(0, str(ROOT / "scripts"))
from check_docs import anchors

RULES_PATH = ROOT / "deploy" / "observability" / "rules.yml"
RULES = [rule for group in yaml.safe_load(RULES_PATH.read_text())["groups"] for rule in group["rules"]]
# Labels that Prometheus adds, and that of histograms.
ADDED = {"job", "instance", "le"}
_METRIC = re.compile(r"\b(lambent_\w+|up)\b(?:\{([^}]*)\})?")
_LABEL = re.compile(r"(\w+)\s*(?:=~|!~|!=|=)")
_BY = re.compile(r"\bby\s*\(([^)]*)\)")


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[str]]:
    """Return the labels of every series of /metrics by its name."""
    found: dict[str, set[str]] = {"up": set()}
    with opened(tmp_path_factory.mktemp("metrics") / "data") as api:
        families = list(text_string_to_metric_families(api.get("/metrics").text))
    # A labelled metric that has counted nothing yet has no series: its labels are in the code.
    from lambent_server.core import metrics

    labels = {each._name: set(each._labelnames) for each in metrics.OWN._collector_to_names}
    for family in families:
        own = labels.get(family.name, {name for sample in family.samples for name in sample.labels} - ADDED)
        if family.name.endswith("_created"):
            continue
        suffixes = {"counter": ("_total",), "histogram": ("_bucket", "_count", "_sum")}.get(
            family.type, ("",)
        )
        for suffix in suffixes:
            found[family.name + suffix] = own
    return found


@pytest.mark.parametrize("query", [rule["expr"] for rule in RULES])
def test_a_query_names_metrics_and_labels_that_there_are(query: str, known: dict[str, set[str]]):
    used = [(found[1], set(_LABEL.findall(found[2] or ""))) for found in _METRIC.finditer(query)]
    assert used
    grouped = {name.strip() for names in _BY.findall(query) for name in names.split(",")}
    for name, labels in used:
        assert name in known
        assert labels <= known[name] | ADDED
        assert grouped <= known[name] | ADDED


def test_a_metric_or_label_that_is_not_there_would_be_noticed(known: dict[str, set[str]]):
    for query in ("max(lambent_job)", 'lambent_jobs{stat="queued"}', "sum by (cause) (lambent_jobs)"):
        with pytest.raises(AssertionError):
            test_a_query_names_metrics_and_labels_that_there_are(query, known)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_an_alert_says_what_is_wrong_and_what_to_do(rule: dict[str, Any]):
    assert rule["labels"]["severity"] in ("warning", "critical")
    assert rule["annotations"]["summary"].endswith(".")
    page, _, fragment = rule["annotations"]["runbook_url"].partition("#")
    assert fragment in anchors((ROOT / page).read_text(encoding="utf-8"))


def test_prometheus_asks_services_that_there_are_by_names_that_they_know():
    text = (ROOT / "deploy" / "observability" / "prometheus.yml").read_text()
    (job,) = yaml.safe_load(text)["scrape_configs"]
    targets = {each.partition(":")[0] for each in job["static_configs"][0]["targets"]}
    services = compose()["services"]
    assert targets == {name for name in ("server", "controller", "worker-cpu") if name in services}
    for name in targets:
        assert targets <= set(services[name]["environment"]["LAMBENT_ALLOWED_HOSTS"].split(","))
    secret = job["authorization"]["credentials_file"].removeprefix("/run/secrets/")
    assert secret in services["prometheus"]["secrets"]


@pytest.mark.skipif(shutil.which("promtool") is None, reason="there is no promtool here: Debian's prometheus")
def test_promtool_accepts_the_rules():
    found = subprocess.run(["promtool", "check", "rules", str(RULES_PATH)], capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    assert f"{len(RULES)} rules found" in found.stdout + found.stderr


@pytest.fixture(scope="module")
def prometheus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, LiveServer]]:
    """Yield the address of a Prometheus with our configuration, and the server that it scrapes."""
    folder = tmp_path_factory.mktemp("prometheus")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with LiveServer(folder / "data") as server:
        scope = {"name": "prometheus", "scopes": ["read"]}
        key = server.client.post("/v1/keys", json=scope).raise_for_status().json()["key"]
        (folder / "metrics_key").write_text(key)
        text = (ROOT / "deploy" / "observability" / "prometheus.yml").read_text()
        config = yaml.safe_load(text.replace("/run/secrets", str(folder)))
        config["global"] = {
            "scrape_interval": "1s",
            "scrape_timeout": "1s",
            "evaluation_interval": "1s",
        }
        config["rule_files"] = [str(RULES_PATH)]
        config["scrape_configs"][0]["static_configs"] = [{"targets": [server.url.removeprefix("http://")]}]
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
        command = [
            "prometheus",
            f"--config.file={folder}/prometheus.yml",
            f"--storage.tsdb.path={folder}/tsdb",
        ]
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen([*command, f"--web.listen-address=127.0.0.1:{port}"], stderr=log)
        try:
            yield f"http://127.0.0.1:{port}", server
        finally:
            process.terminate()
            process.wait(timeout=30)


def asked(url: str, query: str) -> list[dict[str, Any]]:
    """Return what Prometheus answers to a query; AssertionError if it refuses it."""
    answer = httpx2.get(f"{url}/api/v1/query", params={"query": query}, timeout=20)
    assert answer.status_code == 200, f"{query}: {answer.text}"
    return list(answer.json()["data"]["result"])


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("prometheus") is None, reason="there is no Prometheus here")
def test_prometheus_scrapes_a_server_and_evaluates_every_rule(prometheus: tuple[str, LiveServer]):
    url, server = prometheus

    def is_up() -> bool:
        with contextlib.suppress(httpx2.TransportError, AssertionError):
            return any(each["value"][1] == "1" for each in asked(url, 'up{job="lambent"}'))
        return False

    wait_until(is_up, timeout_s=60)
    server.wait(server.submit(server.scene(), num_steps=2))
    # Rates need two scrapes.
    wait_until(lambda: asked(url, "sum(rate(lambent_runs_started_total[1m])) > 0"), timeout_s=60)
    time.sleep(1.5)
    rules = httpx2.get(f"{url}/api/v1/rules", timeout=20).json()["data"]["groups"][0]["rules"]
    assert {rule["name"] for rule in rules} == {rule["alert"] for rule in RULES}
    assert {rule["health"] for rule in rules} == {"ok"}, [rule.get("lastError") for rule in rules]
    assert {rule["name"] for rule in rules if rule["state"] == "firing"} == set()

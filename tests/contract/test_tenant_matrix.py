"""Another tenant's things answer like things that do not exist: every operation, every kind of id."""

import json
import os
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from lambent_server.app import describe
from scipy import stats
from support.api import STRANGER_KEY, Api, opened
from support.one_of_each import one_of_each

ROUNDS = int(os.environ.get("LAMBENT_TIMING_ROUNDS", "0"))
"""How often each pair is timed; a few hundred tell differences of a few per cent."""
OPERATIONS = [
    (path, method)
    for path, operations in describe()["paths"].items()
    for method in operations
    if path.startswith("/v1/")
]
# What these take besides ids that make them well-formed.
PATHS = {"path": "manifest.json"}
BODIES: dict[tuple[str, str], dict[str, Any]] = {
    ("post", "/v1/scenes/{scene_id}/files:plan"): {
        "json": [{"path": "a.png", "size": 1, "sha256": "0" * 64}]
    },
    ("put", "/v1/scenes/{scene_id}/files/{sha256}"): {"content": b"{}"},
    ("put", "/v1/scenes/{scene_id}/archive"): {"content": b"PK"},
    ("patch", "/v1/scenes/{scene_id}"): {"json": {"name": "mine"}},
    ("post", "/v1/scenes/{scene_id}/files:uploads"): {"json": {"sha256": ["0" * 64]}},
    ("post", "/v1/scenes/{scene_id}/files:complete"): {"json": {"sha256": ["0" * 64]}},
    ("patch", "/v1/jobs/{job_id}"): {"json": {"priority": 3}},
    ("patch", "/v1/bundles/{bundle_id}"): {"json": {"labels": {"a": "b"}}},
    ("post", "/v1/bundles/{bundle_id}/shares"): {"json": {"expires_in_s": 3600}},
    ("patch", "/v1/webhooks/{webhook_id}"): {"json": {"name": "mine"}},
}
# Ids in bodies and queries.
REFERRING: dict[str, tuple[str, str, dict[str, Any]]] = {
    "job of a scene": ("post", "/v1/jobs", {"json": {"scene_id": "{scene_id}", "preset": "tiny"}}),
    "estimate of a scene": ("post", "/v1/estimates", {"json": {"scene_id": "{scene_id}", "preset": "tiny"}}),
    "pictures of a bundle": (
        "post",
        "/v1/renders",
        {
            "json": {
                "bundle_id": "{bundle_id}",
                "environments": [{"environment_id": "env_none"}],
                "cameras": {"turntable": 1},
            }
        },
    ),
    "batch of a bundle": (
        "post",
        "/v1/batches",
        {
            "json": {
                "assets": [{"bundle_id": "{bundle_id}"}],
                "environments": [{"environment_id": "env_none"}],
                "cameras": [{"turntable": 1}],
            }
        },
    ),
    "events of a job": ("get", "/v1/events", {"params": {"job": "{job_id}"}}),
    "deliveries of a job": ("get", "/v1/deliveries", {"params": {"job": "{job_id}"}}),
    "jobs of a scene": ("get", "/v1/jobs", {"params": {"scene": "{scene_id}"}}),
}
CASES = {
    f"{method} {path}": (method, path, BODIES.get((method, path), {}))
    for method, path in ((method, path) for path, method in OPERATIONS)
    if "{" in path
} | REFERRING


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Api, dict[str, str]]]:
    """Return the interface, and the ids of one thing of every kind of the first tenant."""
    folder = tmp_path_factory.mktemp("matrix") / "data"
    # A stream of nothing ends at once.
    with opened(folder, max_wait_s=0.01) as api:
        yield api, one_of_each(api, folder)


def absent(ids: dict[str, str]) -> dict[str, str]:
    """Return ids of the same form that nobody has."""
    return {
        name: "f" * 64 if name == "sha256" else value[:-1] + ("0" if value[-1] != "0" else "1")
        for name, value in ids.items()
    }


def filled(value: Any, ids: dict[str, str]) -> Any:
    """Return a request with these ids."""
    if isinstance(value, dict):
        return {name: filled(each, ids) for name, each in value.items()}
    if isinstance(value, list):
        return [filled(each, ids) for each in value]
    if isinstance(value, str) and value.startswith("{"):
        return value.format(**ids)
    return value


def neutral(answer: Any, ids: dict[str, str]) -> tuple[int, dict[str, str], str]:
    """Return status, headers and body of an answer without the id that was asked for."""
    text = answer.text
    for value in ids.values():
        text = text.replace(value, "ID")
    headers = dict(answer.headers)
    if headers.get("content-type") == "application/problem+json":
        document = json.loads(text)
        document.pop("request_id")
        text = json.dumps(document, sort_keys=True)
    for changing in ("x-request-id", "date", "etag", "content-length"):
        headers.pop(changing, None)
    return answer.status_code, headers, text


def ask(client: Any, case: str, ids: dict[str, str]) -> Any:
    """Return the answer to a stranger."""
    method, path, request = CASES[case]
    return client.request(method, path.format(**ids, **PATHS), **filled(request, ids))


def test_every_operation_with_an_id_is_in_the_matrix():
    names = {
        each["name"]
        for operations in describe()["paths"].values()
        for operation in operations.values()
        for each in operation.get("parameters", ())
        if each["in"] == "path"
    }
    assert names == {
        *("scene_id", "job_id", "bundle_id", "environment_id", "batch_id", "share_id", "key_id"),
        *("webhook_id", "delivery_id", "sha256", "path"),
    }
    with_body = {
        (method, path)
        for path, operations in describe()["paths"].items()
        for method, operation in operations.items()
        if "{" in path and "requestBody" in operation
    }
    assert with_body == set(BODIES)


@pytest.mark.parametrize("case", CASES)
def test_what_is_somebody_elses_answers_as_what_does_not_exist(known: tuple[Api, dict[str, str]], case: str):
    api, ids = known
    stranger, others = api.other(STRANGER_KEY), absent(ids)
    foreign, missing = ask(stranger, case, ids), ask(stranger, case, others)
    assert neutral(foreign, ids) == neutral(missing, others)
    if case in ("deliveries of a job", "jobs of a scene"):
        assert (foreign.status_code, foreign.json()["items"]) == (200, [])
    else:
        assert foreign.status_code in (404, 422), foreign.text
        assert foreign.status_code == 404 or case in REFERRING
    # It is there, and has not changed.
    assert api.get(f"/v1/scenes/{ids['scene_id']}").json()["name"] == "a scene"


@pytest.mark.skipif(not ROUNDS, reason="is long: make hostile")
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("case", CASES)
def test_the_time_does_not_tell_whether_it_exists(known: tuple[Api, dict[str, str]], case: str):
    api, ids = known
    stranger, others = api.other(STRANGER_KEY), absent(ids)
    times: dict[str, list[float]] = {"foreign": [], "missing": []}
    order = np.random.default_rng(0).random(ROUNDS) < 0.5
    for first in order:
        for name in ("foreign", "missing") if first else ("missing", "foreign"):
            # A gap of the machine falls on both alike.
            began = time.perf_counter()
            ask(stranger, case, ids if name == "foreign" else others)
            times[name].append(time.perf_counter() - began)
    result = stats.mannwhitneyu(times["foreign"], times["missing"])
    # Sidak for all cases together: one false alarm in a thousand runs.
    assert result.pvalue > 1e-3 / len(CASES), {name: float(np.median(each)) for name, each in times.items()}

"""Every operation against what its description allows and forbids (schemathesis)."""

import os
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from lambent_server.app import describe
from schemathesis.generation import GenerationMode
from schemathesis.specs.openapi.checks import positive_data_acceptance
from support.api import KEY, expect, opened, sha256
from support.server_rows import add_bundle

EXAMPLES = int(os.environ.get("LAMBENT_FUZZ_EXAMPLES", "6"))
# A stream does not end; tests/chaos follows it.
OPERATIONS = [
    (path, method, operation)
    for path, operations in describe()["paths"].items()
    for method, operation in operations.items()
    if path != "/v1/events"
]
CASES = [
    (kind, path, method)
    for kind in ("allowed", "forbidden", "existing")
    for path, method, operation in OPERATIONS
    # Without an id "existing" is "allowed" again, and without any input nothing is forbidden.
    if (kind != "existing" or "{" in path)
    and (kind != "forbidden" or "requestBody" in operation or "parameters" in operation)
]


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Return the description bound to an application in memory, and ids of things that exist."""
    folder = tmp_path_factory.mktemp("fuzz") / "data"
    # Waiting is part of the operation, but would only slow this test.
    with opened(folder, max_wait_s=0.01, allowed_hosts=("testserver",)) as api:
        scene = api.scene(commit=False)
        add_bundle(api, folder, {"manifest.json": b"{}"}, bundle_id="bundle_y")
        head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes(8)
        sky = api.post("/v1/environments", params={"name": "sky"}, content=head).json()["id"]
        batch = {
            "assets": [{"bundle_id": "bundle_y"}],
            "environments": [{"environment_id": sky}],
            "cameras": [{"turntable": 2}],
        }
        webhook = expect(api.post("/v1/webhooks", json={"url": "https://example.com/"}), 201)["id"]
        yield {
            "webhook_id": webhook,
            "delivery_id": expect(api.post(f"/v1/webhooks/{webhook}:ping"), 202)["id"],
            "batch_id": expect(api.post("/v1/batches", json=batch), 202)["id"],
            "share_id": expect(api.post("/v1/bundles/bundle_y/shares", json={}), 201)["id"],
            "schema": schemathesis.openapi.from_asgi("/openapi.json", api.client.app),
            "scene_id": scene,
            "job_id": api.job()["id"],
            "bundle_id": "bundle_x",
            "environment_id": sky,
            "key_id": expect(api.post("/v1/keys", json={"name": "another"}), 201)["id"],
            "sha256": sha256(b"{}"),
            "path": "manifest.json",
        }


@pytest.mark.parametrize(("kind", "path", "method"), CASES)
def test_every_answer_is_one_that_is_described(known: dict[str, Any], kind: str, path: str, method: str):
    operation = known["schema"][path][method.upper()]
    mode = GenerationMode.NEGATIVE if kind == "forbidden" else GenerationMode.POSITIVE
    names = [each.name for each in operation.path_parameters]
    fixed = {"path_parameters": {name: known[name] for name in names}} if kind == "existing" else {}

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate],
    )
    @given(operation.as_strategy(generation_mode=mode, **fixed))
    def check(case: schemathesis.Case) -> None:
        response = case.call(headers={"Authorization": f"Bearer {KEY}"})
        # Allowed but unusable values have codes of their own, such as "preset_unknown".
        case.validate_response(response, excluded_checks=[positive_data_acceptance])
        assert response.status_code < 500
        if response.status_code >= 400:
            assert response.headers["content-type"] == ["application/problem+json"]
            assert kind == "forbidden" or response.json()["code"] != "invalid_request", response.text

    check()

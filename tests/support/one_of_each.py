"""One thing of every kind that an id names, for tests that go through all operations."""

from pathlib import Path

from support.api import Api, expect, sha256
from support.server_rows import add_bundle


def one_of_each(api: Api, data: Path) -> dict[str, str]:
    """Make one thing of every kind for the tenant of `api`, and return its id by the parameter's name."""
    add_bundle(api, data, {"manifest.json": b"{}"}, bundle_id="bundle_x")
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes(8)
    sky = expect(api.post("/v1/environments", params={"name": "sky"}, content=head), 201)["id"]
    batch = {
        "assets": [{"bundle_id": "bundle_x"}],
        "environments": [{"environment_id": sky}],
        "cameras": [{"turntable": 2}],
    }
    webhook = expect(api.post("/v1/webhooks", json={"url": "https://example.com/"}), 201)["id"]
    return {
        "scene_id": api.scene(),
        "job_id": api.job()["id"],
        "bundle_id": "bundle_x",
        "environment_id": sky,
        "batch_id": expect(api.post("/v1/batches", json=batch), 202)["id"],
        "share_id": expect(api.post("/v1/bundles/bundle_x/shares", json={}), 201)["id"],
        "key_id": "key_test",
        "webhook_id": webhook,
        "delivery_id": expect(api.post(f"/v1/webhooks/{webhook}:ping"), 202)["id"],
        "sha256": sha256(b"{}"),
    }

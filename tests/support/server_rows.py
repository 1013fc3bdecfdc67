"""Rows that runs would write, put straight into the database of `support.api`."""

from pathlib import Path
from typing import Any

from lambent_server.core.clock import now
from lambent_server.database.schema import bundle_files, bundles
from lambent_server.database.tenancy import Tenant, add
from support.api import TENANT, Api, sha256


def add_bundle(
    api: Api,
    folder: Path,
    files: dict[str, bytes],
    *,
    bundle_id: str = "bundle_x",
    scene_id: str = "scene_x",
    tenant: Tenant = TENANT,
) -> str:
    """Publish a bundle with these files and return its id; `folder` holds them on the way."""
    with api.services.database.write() as connection:
        values: dict[str, Any] = {"id": bundle_id, "job_id": f"job_of_{bundle_id}", "scene_id": scene_id}
        connection.execute(add(tenant, bundles, **values, created_at=now()))
    for place, (path, data) in enumerate(files.items()):
        source = folder / f"{bundle_id}-{place}"
        source.write_bytes(data)
        api.services.store.put_file(api.services.database.write, tenant, source, sha256(data), "text/html")
        values = {"path": path, "sha256": sha256(data), "size_bytes": len(data), "media_type": "text/html"}
        with api.services.database.write() as connection:
            connection.execute(add(tenant, bundle_files, bundle_id=bundle_id, **values))
    return bundle_id

"""A manifest as the body of `POST /v1/batches`."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lambent_relight.batch.manifest import Cameras, Manifest
from lambent_relight.batch.plan import stated_cameras
from lambent_relight.cameras import cameras_json

from lambent.batch_inputs import bundle_here


def order_of(manifest: Manifest, environment_ids: Mapping[Path, str]) -> dict[str, Any]:
    """Return the body of `POST /v1/batches` for a manifest; `environment_ids` names its maps on the server.

    Raises `batch.bundle_here` for an asset that is not a bundle of a server. Files of cameras are sent along.
    """
    for asset in manifest.assets:
        if not asset.bundle_id:
            raise bundle_here(asset)
    order = manifest.model_dump(
        mode="json",
        exclude={
            "schema_": True,
            "settings": True,
            "assets": {"__all__": {"bundle"}},
            "environments": {"__all__": {"map"}},
        },
    )
    for asset, entry in zip(manifest.assets, order["assets"], strict=True):
        entry["name"] = asset.called
    for light, entry in zip(manifest.environments, order["environments"], strict=True):
        identifier = light.environment_id if light.map is None else environment_ids[light.map]
        entry |= {"name": light.called, "environment_id": identifier}
    order["cameras"] = [_cameras_of(entry) for entry in manifest.cameras]
    return order


def _cameras_of(entry: Cameras) -> dict[str, Any]:
    stated = stated_cameras(entry)
    if stated is not None:
        return {"poses": json.loads(cameras_json(stated))["cameras"]}
    return entry.model_dump(mode="json", exclude={"file"})

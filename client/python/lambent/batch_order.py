"""A manifest as the body of `POST /v1/batches`."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lambent_relight.batch.manifest import Cameras, Manifest
from lambent_relight.batch.plan import stated_cameras
from lambent_relight.cameras import cameras_json

from lambent.batch_inputs import bundle_here


def order_of(manifest: Manifest, environment_ids: Mapping[Path, str]) -> dict[str, Any]:
    """Return the body of `POST /v1/batches` for a manifest; `environment_ids` names its maps on the server.

    Raises `batch.bundle_here` for an asset that is no bundle of a server. Files of cameras are sent along.
    """
    for asset in manifest.assets:
        if not asset.bundle_id:
            raise bundle_here(asset)
    return {
        "name": manifest.name,
        "assets": [
            {
                "name": asset.name,
                "bundle_id": asset.bundle_id,
                "material": asdict(asset.edit),
                "object_rotate_deg": asset.object_rotate_deg,
            }
            for asset in manifest.assets
        ],
        "environments": [
            {
                "name": light.name,
                "environment_id": light.environment_id or environment_ids[light.path],  # type: ignore[index]
                **asdict(light.given),
                "rotate_deg": light.rotate_deg,
            }
            for light in manifest.environments
        ],
        "cameras": [_cameras_of(entry) for entry in manifest.cameras],
        "qualities": [quality.model_dump() for quality in manifest.qualities],
        "output": {
            "files": list(manifest.files.suffixes),
            "passes": list(manifest.files.passes),
            "half": manifest.files.half,
            "path": manifest.files.path,
        },
    }


def _cameras_of(entry: Cameras) -> dict[str, Any]:
    stated = stated_cameras(entry)
    if stated is not None:
        return {"poses": json.loads(cameras_json(stated))["cameras"]}
    return entry.model_dump(mode="json", exclude_defaults=True, exclude={"file", "poses"})

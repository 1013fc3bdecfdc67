"""Bundles of a server: for a batch on this machine, and for a look at what a batch there would make."""

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from lambent_relight.batch.manifest import Asset, Manifest
from lambent_relight.batch.plan import Plan, make_plan
from lambent_relight.bundle import peek_bundle

from lambent.client import Client
from lambent.errors import RefusedError, UsageProblemError

INPUTS = "inputs"
"""Folder inside the output for what was fetched."""


def with_local_bundles(
    manifest: Manifest, folder: Path, note: Callable[[str], None], *, url: str = ""
) -> Manifest:
    """Return the manifest with every bundle of a server fetched into `folder`/inputs.

    A bundle that the server declines stays where it is, and its pictures fail. Maps on a server are not
    fetched: raises `batch.map_on_server`. Raises UnreachableError where no server answers.
    """
    for light in manifest.environments:
        if light.path is None:
            raise UsageProblemError(
                "batch.map_on_server",
                f"the environment {light.name} is named by its id on a server",
                "give its file, or render on the server: --server",
            )
    identifiers = {asset.bundle_id for asset in manifest.assets if asset.path is None}
    if not identifiers:
        return manifest
    places = {}
    with Client(url) as client:
        for identifier in sorted(identifiers):
            note(f"fetching {identifier}")
            try:
                places[identifier] = client.fetch(identifier, folder / INPUTS / identifier).path
            except RefusedError as error:
                note(f"{identifier}: {error}")
    assets = tuple(
        asset if asset.path is not None else replace(asset, path=places.get(asset.bundle_id))
        for asset in manifest.assets
    )
    return replace(manifest, assets=assets)


@dataclass(frozen=True, kw_only=True)
class ServerPlan:
    """What a server would be asked for."""

    plan: Plan
    to_send: tuple[Path, ...]
    """Maps that the server does not have yet."""


def plan_on_server(manifest: Manifest, client: Client, note: Callable[[str], None]) -> ServerPlan:
    """Return the pictures that a server would make of a manifest; nothing is sent there.

    Of bundles only manifest and cameras are fetched. Raises `batch.bundle_here` for an asset that is no
    bundle of a server, as the order itself does, and `batch.map_unknown` for a map that is not there.
    """
    known = client.environments()
    digests = {each.id: each.sha256 for each in known}
    there = {(each.name, each.sha256) for each in known}
    for light in manifest.environments:
        if light.environment_id and light.environment_id not in digests:
            raise UsageProblemError(
                "batch.map_unknown",
                f"the server has no environment {light.environment_id}",
                "see `GET /v1/environments`, or give its file",
            )
    maps = sorted({light.path for light in manifest.environments if light.path is not None})
    to_send = tuple(path for path in maps if path.is_file() and (path.name, _digest(path)) not in there)
    with tempfile.TemporaryDirectory(prefix="lambent-") as folder:
        places: dict[str, Path] = {}
        for asset in manifest.assets:
            if not asset.bundle_id:
                raise bundle_here(asset)
            if asset.bundle_id not in places:
                try:
                    places[asset.bundle_id] = client.peek(asset.bundle_id, Path(folder) / asset.bundle_id)
                except RefusedError as error:
                    note(f"{asset.bundle_id}: {error}")
        assets = tuple(replace(asset, path=places.get(asset.bundle_id)) for asset in manifest.assets)
        plan = make_plan(replace(manifest, assets=assets), opening=peek_bundle, known_lights=digests)
    return ServerPlan(plan=plan, to_send=to_send)


def bundle_here(asset: Asset) -> UsageProblemError:
    """Return what is said about an asset that only this machine has."""
    return UsageProblemError(
        "batch.bundle_here",
        f"the asset {asset.name} is the file {asset.path}, which the server does not have",
        "give its bundle_id there (`lambent jobs`), or render here, without --server",
    )


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

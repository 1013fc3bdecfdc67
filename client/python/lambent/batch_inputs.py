"""Bundles of a server: fetched for a batch on this machine, or peeked at to plan a batch over there."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from lambent_core.files import file_sha256
from lambent_relight.batch.manifest import Asset, Manifest
from lambent_relight.batch.plan import Plan, make_plan
from lambent_relight.bundle.bundle import Bundle, load_bundle, peek_bundle

from lambent.client import Client
from lambent.errors import RefusedError, UsageProblemError

INPUTS = "inputs"
"""Folder inside the output for fetched bundles."""


def with_local_bundles(
    manifest: Manifest, folder: Path, note: Callable[[str], None], *, url: str = ""
) -> Manifest:
    """Return the manifest with every bundle of a server fetched into `folder`/inputs.

    A bundle that the server declines stays where it is, and its pictures fail. Maps on a server are not
    fetched: raises `batch.map_on_server`. Raises UnreachableError where no server answers.
    """
    _refuse_maps_on_server(manifest)
    if all(asset.bundle is not None for asset in manifest.assets):
        return manifest

    with Client(url) as client:

        def bring(identifier: str) -> Path:
            note(f"fetching {identifier}")
            return client.fetch(identifier, folder / INPUTS / identifier).path

        return _with_bundles(manifest, bring, note)


def plan_here(manifest: Manifest, note: Callable[[str], None], *, url: str = "") -> Plan:
    """Return the pictures that a batch on this machine would make; nothing is left on the disk.

    Of bundles on a server only manifest and cameras are fetched. Raises as `with_local_bundles` does.
    """
    _refuse_maps_on_server(manifest)
    if all(asset.bundle is not None for asset in manifest.assets):
        return make_plan(manifest)
    with Client(url) as client, tempfile.TemporaryDirectory(prefix="lambent-") as name:
        folder = Path(name)
        peeked = _with_bundles(manifest, lambda each: client.peek(each, folder / each), note)

        def opening(path: Path | str) -> Bundle:
            return (peek_bundle if folder in Path(path).parents else load_bundle)(path)

        return make_plan(peeked, opening=opening)


def _refuse_maps_on_server(manifest: Manifest) -> None:
    for light in manifest.environments:
        if light.map is None:
            raise UsageProblemError(
                "batch.map_on_server",
                f"the environment {light.called} is named by its id on a server",
                "give its file, or render on the server: --server",
            )


def _with_bundles(manifest: Manifest, bring: Callable[[str], Path], note: Callable[[str], None]) -> Manifest:
    """Return the manifest with the bundles of a server where `bring` puts them, each of them once."""
    places: dict[str, Path] = {}
    for identifier in sorted({asset.bundle_id for asset in manifest.assets if asset.bundle is None}):
        try:
            places[identifier] = bring(identifier)
        except RefusedError as error:
            note(f"{identifier}: {error}")
    assets = tuple(
        asset.model_copy(update={"bundle": asset.bundle or places.get(asset.bundle_id)})
        for asset in manifest.assets
    )
    return manifest.model_copy(update={"assets": assets})


def plan_on_server(
    manifest: Manifest, client: Client, note: Callable[[str], None]
) -> tuple[Plan, tuple[Path, ...]]:
    """Return the pictures that a server would make of a manifest, and the maps to send; nothing is sent.

    Of bundles only manifest and cameras are fetched. Raises `batch.bundle_here` for an asset that is not a
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
    maps = sorted({light.map for light in manifest.environments if light.map is not None})
    to_send = tuple(path for path in maps if path.is_file() and (path.name, file_sha256(path)) not in there)
    for asset in manifest.assets:
        if not asset.bundle_id:
            raise bundle_here(asset)
    with tempfile.TemporaryDirectory(prefix="lambent-") as folder:
        peeked = _with_bundles(manifest, lambda each: client.peek(each, Path(folder) / each), note)
        plan = make_plan(peeked, opening=peek_bundle, known_lights=digests)
    return plan, to_send


def bundle_here(asset: Asset) -> UsageProblemError:
    """Return the error for an asset that only this machine has."""
    return UsageProblemError(
        "batch.bundle_here",
        f"the asset {asset.called} is the file {asset.bundle}, which the server does not have",
        "give its bundle_id there (`lambent jobs`), or render here, without --server",
    )

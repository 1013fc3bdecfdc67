"""Writes the uncertainty of the materials to a bundle."""

from pathlib import Path

from lambent_proto.v1 import bundle_pb2
from lambent_relight.bundle.uncertainty import PATH, UncertaintyGrid


def write_uncertainty(folder: Path, manifest: bundle_pb2.BundleManifest, grid: UncertaintyGrid) -> None:
    """Write the grid below `folder` and say in the manifest where it is and what it covers."""
    (folder / PATH).parent.mkdir(parents=True, exist_ok=True)
    (folder / PATH).write_bytes(grid.to_bytes())
    stated = manifest.uncertainty
    stated.path = PATH
    stated.channels.extend(grid.channels)
    stated.box.minimum.extend(grid.low.tolist())
    stated.box.maximum.extend(grid.high.tolist())

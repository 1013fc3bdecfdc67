"""Notes on an exported bundle: settings without effect, and a lite bundle that is not small."""

from typing import TYPE_CHECKING

from lambent_core.reporter import Reporter
from lambent_proto.v1 import bundle_pb2

if TYPE_CHECKING:  # It imports torch, which photographs are prepared without.
    from flashcache.config import ExportConfig

LITE_BYTES = 10_000_000
"""Size of all files up to which a lite bundle suits a telephone."""


def tell_about(reporter: Reporter, manifest: bundle_pb2.BundleManifest, settings: "ExportConfig") -> None:
    """Tell the reporter what the owner of a finished bundle should know, as findings `export.*`."""
    texels, wanted = manifest.atlas.size, settings.atlas_size
    if wanted and texels and texels != wanted:
        why = "the photographs are hardly finer than those that were trained on, so that it is the model's"
        if settings.albedo == "model":
            why = 'export.albedo is "model", and the model knows no more'
        reporter.finding(
            "export.atlas_unused",
            f"--atlas {wanted} (export.atlas_size) has no effect: the albedo texture has {texels} texels "
            f"a side, because {why}; leave the setting out, or train on larger photographs",
        )
    size = sum(file.size_bytes for file in manifest.files)
    if settings.transport_tier == "lite" and size > LITE_BYTES:
        mesh = sum(file.size_bytes for file in manifest.files if file.role == "mesh")
        ways = [] if settings.weights == "none" else ["--weights none"]
        ways += ["a smaller --atlas"] if texels > manifest.atlas.material_size else []
        reporter.finding(
            "export.lite_size",
            f"this lite bundle has {size / 1e6:.1f} MB, {mesh / 1e6:.1f} MB of it the mesh with its "
            f"textures; {LITE_BYTES / 1e6:.0f} MB suit a telephone; "
            f"export it with {' and '.join(ways) or 'fewer --faces'}",
        )

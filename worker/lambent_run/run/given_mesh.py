"""The bundle of a trained run with an edited mesh: materials, shadows and light transport of that mesh."""

import shutil
from dataclasses import replace
from pathlib import Path

from lambent_asset.bundle.manifest import write_manifest
from lambent_asset.bundle.surface_files import pixel_size, write_mesh
from lambent_asset.bundle.transport_files import write_relight_graph
from lambent_asset.given_mesh.given_surface import GivenSurface, check_place, given_surface
from lambent_asset.given_mesh.glb_file import GivenMesh, read_glb
from lambent_asset.mesh.mesh import Corner, occupied_box
from lambent_asset.textures.surface_occlusion import bake_occlusion
from lambent_asset.transport.transport import TransportConfig, bake_transport, write_transport
from lambent_asset.transport.transport_rays import MESH_RAYS, TriangleRays
from lambent_compute.threads import available_threads
from lambent_core.errors import UsageError
from lambent_core.files import file_sha256
from lambent_core.reporter import Reporter
from lambent_proto.v1 import bundle_pb2
from lambent_relight.bundle.bundle import load_bundle

from lambent_run.report.measure import write_photographs
from lambent_run.run.context import TaskContext
from lambent_run.run.export_notes import tell_about
from lambent_run.run.folder import locked, require_done
from lambent_run.run.hashes import last_training_task
from lambent_run.run.prepare import open_task
from lambent_run.run.tasks.export import (
    FOLDERS,
    add_poster,
    at_reference,
    manifest_of,
    write_cameras,
    write_environments,
)
from lambent_run.run.tasks.training import load_final, read_scene

NUM_PARTS = 5


def export_given_mesh(
    run_dir: Path, out: Path, mesh: Path, reporter: Reporter, *, tier: str = "", atlas: str = ""
) -> None:
    """Write a bundle of the run in `run_dir` whose surface is the mesh in the GLB file `mesh`, to `out`.

    The bundle has no networks, which know only the shape that was trained: refined pictures are refused. Its
    `tier`, "full" or "lite", is by default the run's, and so is `atlas`, the side of the albedo texture in
    texels, or "auto": as many as the file's pictures have. The run and its own bundle stay as they are.

    Raises `UsageError` where the run is not trained to its end, `out` exists, or the file cannot be used, and
    `ConfigError` for unknown values.
    """
    from flashcache.config import with_overrides

    given = read_glb(mesh)
    context = open_task(run_dir, "export", reporter)
    require_done(run_dir, last_training_task(context.spec.config))
    if out.exists():
        raise UsageError("export.exists", f'"{out}" exists already; choose another folder with -o')
    config = context.config
    if not tier and config.export.transport_tier == "none":
        tier = "full"
    if atlas:
        # The size of transport too, so that a texture with fewer texels does not make it coarser.
        wanted = {"atlas_size": "0" if atlas == "auto" else atlas}
        wanted["transport_size"] = str(config.export.transport_size)
        config = with_overrides(config, {f"export.{name}": value for name, value in wanted.items()})
    chosen = replace(config.export, transport_tier=tier or config.export.transport_tier)
    spec = replace(context.spec, config=replace(config, export=chosen))
    if chosen.transport_tier == "none":
        raise UsageError(
            "mesh_file.no_transport",
            "a bundle with a given mesh needs baked transport; use --tier full or lite",
        )
    partial = out.with_name(out.name + ".partial")
    with locked(run_dir):
        shutil.rmtree(partial, ignore_errors=True)
        # Of a program that was killed.
        shutil.rmtree(_rays_beside(partial), ignore_errors=True)
        try:
            _write(replace(context, spec=spec), given, mesh, partial)
            manifest = load_bundle(partial).manifest
            partial.rename(out)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
            # Rays of another mesh must not be taken for this one's: nothing resumes here.
            shutil.rmtree(_rays_beside(partial), ignore_errors=True)
    tell_about(reporter, manifest, chosen)


def _write(context: TaskContext, given: GivenMesh, mesh: Path, folder: Path) -> None:
    """Fill `folder` with everything that such a bundle has."""
    settings = context.config.export
    for name in FOLDERS:
        (folder / name).mkdir(parents=True)
    scene = read_scene(context)
    model = at_reference(load_final(context, scene).eval())
    box = occupied_box(model)
    check_place(given, box, mesh.name)
    views = scene.test or scene.train
    _advance(context, 1)

    made = given_surface(
        model,
        given,
        settings,
        box=box,
        pixel_size=pixel_size((view.camera for view in (*scene.train, *scene.test)), box),
    )
    manifest = manifest_of(context, scene, model, _box_of(given))
    manifest.given_mesh.name = mesh.name
    manifest.given_mesh.sha256 = file_sha256(mesh)
    manifest.given_mesh.kept_uv = made.kept_uv
    manifest.given_mesh.share_from_model = made.from_model
    _say(context, given, made)
    _advance(context, 2)
    rays = TriangleRays(made.surface.vertices, made.surface.faces)
    _write_mesh(context, made, rays, manifest, folder)
    _advance(context, 3)
    _write_transport(context, made, rays, manifest, folder)
    write_relight_graph(manifest, folder, seed=context.spec.seed)
    _advance(context, 4)
    write_cameras(views, folder)
    write_environments(context, model, manifest, folder)
    write_photographs(views, scene.lights[0], folder / "preview")
    add_poster(context, manifest, folder)
    write_manifest(folder, manifest)
    _advance(context, NUM_PARTS)


def _rays_beside(folder: Path) -> Path:
    """Return the folder of finished rays of the bundle that is made in `folder`."""
    return folder.with_name(folder.name + ".rays")


def _write_mesh(
    context: TaskContext,
    made: GivenSurface,
    rays: TriangleRays,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
) -> None:
    settings, surface = context.config.export, made.surface
    occlusion = bake_occlusion(
        surface,
        rays,
        origin_offset=rays.offset,
        num_points=settings.occlusion_points,
        num_rays=settings.occlusion_rays,
    )
    write_mesh(surface, made.textures(occlusion), manifest, folder, source="file", usdz=settings.usdz)


def _write_transport(
    context: TaskContext,
    made: GivenSurface,
    rays: TriangleRays,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
) -> None:
    transport, figures = bake_transport(
        made.covered,
        made.reflectors,
        rays,
        origin_offset=rays.offset,
        config=TransportConfig(tier=context.config.export.transport_tier, rays=MESH_RAYS),
        store=_rays_beside(folder),
        advance=lambda share: context.stop_if_asked(),
        num_threads=available_threads(),
    )
    write_transport(transport, manifest, folder)
    manifest.metrics.update(figures)


def _say(context: TaskContext, given: GivenMesh, made: GivenSurface) -> None:
    """Log what was taken over and what was not."""
    context.reporter.log(
        "mesh.read",
        faces=len(given.faces),
        parts=len(given.maps),
        kept_uv=made.kept_uv,
        share_from_model=round(made.from_model, 4),
    )
    if made.num_turned:
        context.reporter.log("mesh.turned_outwards", pieces=made.num_turned)
    if given.ignored:
        context.reporter.log("mesh.ignored", what=", ".join(given.ignored))


def _box_of(given: GivenMesh) -> tuple[Corner, Corner]:
    """Return the mesh's box, a hundredth of its diagonal wider, so that a flat mesh has one with a volume."""
    low, high = (values(axis=0).astype(float) for values in (given.vertices.min, given.vertices.max))
    margin = 0.01 * float(((high - low) ** 2).sum()) ** 0.5
    first, second = (low - margin).tolist(), (high + margin).tolist()
    return (first[0], first[1], first[2]), (second[0], second[1], second[2])


def _advance(context: TaskContext, done: int) -> None:
    context.progress(done, NUM_PARTS)
    context.stop_if_asked()

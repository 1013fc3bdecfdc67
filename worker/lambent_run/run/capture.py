"""The capture of a run as its tasks see it: the user's files, found cameras, given or estimated masks."""

from pathlib import Path

import numpy as np
from lambent_capture.checks.exposure_estimate import even_out_exposure
from lambent_capture.layouts.mask_folder import attach_masks
from lambent_capture.layouts.photographs import CAMERAS_FILE, read_found_cameras
from lambent_capture.loading.light_turns import fix_light
from lambent_capture.problems import Problems
from lambent_core.errors import SceneRefusedError, UsageError
from lambent_core.files import file_sha256, read_record
from lambent_core.messages import read_message
from lambent_proto.v1 import capture_pb2, scene_pb2

from lambent_run.run.context import TaskContext
from lambent_run.run.folder import task_folder
from lambent_run.run.masks import given_masks

MANIFEST = "manifest.json"
MASKS = "masks"
LEFT_OUT = "left_out.json"
"""Pictures that the check could not decode, with their SHA-256."""


def found_cameras(run_dir: Path) -> Path | None:
    """Return the folder of the cameras that the run found, or None where its capture brought them."""
    folder = task_folder(run_dir, "cameras")
    return folder if (folder / CAMERAS_FILE).is_file() else None


def left_out_of(context: TaskContext, folder: Path) -> list[str]:
    """Return which pictures in `folder` are files that the run left out because they could not be decoded."""
    known = read_record(task_folder(context.run_dir, "ingest") / LEFT_OUT)
    there = {path: digest for path, digest in known.items() if (folder / path).is_file()}
    return [path for path, digest in there.items() if file_sha256(folder / path) == digest]


def needs_masks(context: TaskContext) -> bool:
    """Return whether nothing says where the object is in the capture, as `ingest` has found."""
    record = read_record(task_folder(context.run_dir, "ingest") / "capture.json")
    figures = record.get("figures") or {}
    return not figures.get("has_masks", False)


def own_masks(context: TaskContext) -> Path | None:
    """Return the folder of the run's own masks, given or estimated, or None where the capture's are used."""
    given = given_masks(context.run_dir, context.spec.masks)
    if given is not None:
        return given
    estimated = task_folder(context.run_dir, "masks") / MASKS
    return estimated if estimated.is_dir() else None


def read_checked_manifest(context: TaskContext) -> scene_pb2.SceneManifest:
    """Return the description of the capture as it was checked, before masks were estimated."""
    return read_message(task_folder(context.run_dir, "ingest") / MANIFEST, scene_pb2.SceneManifest())


def read_manifest(context: TaskContext) -> scene_pb2.SceneManifest:
    """Return the description of the capture that the run trains on, with the run's own masks."""
    fitted, checked = (task_folder(context.run_dir, task) / MANIFEST for task in ("masks", "ingest"))
    manifest = read_message(fitted if fitted.is_file() else checked, scene_pb2.SceneManifest())
    masks = own_masks(context)
    if masks is not None:
        attach_or_refuse(manifest, context.spec.scene, masks)
    return manifest


def use_own_masks(
    context: TaskContext,
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    trained: scene_pb2.SceneManifest,
) -> None:
    """Give the frames of the capture in `folder` the run's own masks if the run was trained on them.

    Both manifests are in one world. Frames of another capture have other names or poses, and keep what they
    say themselves. Raises `SceneRefusedError` where a mask is missing or does not fit its photograph.
    """
    masks = own_masks(context)
    poses = {frame.name: frame.camera.camera_to_world for frame in trained.frames}
    if masks is None or not all(
        frame.name in poses and np.allclose(frame.camera.camera_to_world, poses[frame.name], atol=1e-3)
        for frame in manifest.frames
    ):
        return
    attach_or_refuse(manifest, folder, masks)


def settle_light(context: TaskContext, manifest: scene_pb2.SceneManifest) -> None:
    """Say in `manifest` what the light stands still with, and tell where it is not the scene.

    Raises `UsageError` for several training lights that would turn.
    """
    fixed_to, folder = context.spec.light_fixed_to, found_cameras(context.run_dir)
    recognised = folder is not None and read_found_cameras(folder).static_background
    if fixed_to == "auto":
        fixed_to = "camera" if recognised else "scene"
    if fixed_to != "scene" and len(manifest.lights) > 1:
        raise UsageError(
            "light.fixed_to_several",
            f"--light-fixed-to {fixed_to}: there are {len(manifest.lights)} training lights "
            f"({', '.join(manifest.lights)}), and only one can turn; choose one with --light",
        )
    fix_light(manifest, fixed_to)
    if fixed_to == "scene":
        if recognised:
            context.reporter.finding(
                "scene.turntable",
                "the background stands still while the object turns, but the light is taken to turn with the "
                "object, as --light-fixed-to scene says; shading will end up in the materials if it did not",
            )
        return
    seen = (
        "the background stands still while the object turns, as on a turntable" if recognised else "as asked"
    )
    context.reporter.finding(
        "scene.turntable",
        f"{seen}: the light is taken to stand still with the {fixed_to}, so that it turns around the object "
        "from photograph to photograph, and one environment is learned in the axes of the first one; if the "
        "light turned with the object, train with --light-fixed-to scene",
    )


def even_out(
    context: TaskContext, manifest: scene_pb2.SceneManifest, figures: capture_pb2.CaptureFigures
) -> None:
    """Estimate exposures in `manifest` where they are not known, and tell the findings.

    Not where the light turns: what a turn does looks like a change of exposure.
    """
    if manifest.light_fixed_to:
        return
    problems = Problems()
    even_out_exposure(manifest, figures, problems)
    for finding in problems.findings():
        context.reporter.finding(finding.code, finding.message)


def attach_or_refuse(manifest: scene_pb2.SceneManifest, folder: Path, masks: Path) -> None:
    """Give the frames of the capture in `folder` the masks in `masks`; raises `SceneRefusedError`."""
    problems = Problems()
    attach_masks(manifest, folder, masks, problems)
    if not problems.usable:
        raise SceneRefusedError.of(problems.findings())

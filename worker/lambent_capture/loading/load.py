"""Loads the pictures of a described capture into memory, reduced and in linear light."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from lambent_core.layouts import BENCHMARKS, PHOTOGRAPHS
from lambent_core.scene import Camera, Margins, Scene, View
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Channels32, Pose64, Rotation64
from lambent_capture.loading.kept_pictures import Pictures, kept
from lambent_capture.loading.light_turns import light_turn
from lambent_capture.loading.lights import select_lights
from lambent_capture.loading.radiance import (
    alphas,
    linear_photograph,
    mask_coverage,
    stored_levels,
    with_alpha,
)
from lambent_capture.pictures.resample import (
    reduced_size,
    resampled_colour,
    resampled_flags,
    resampled_weighted,
)
from lambent_capture.pictures.upright import turned_pixels, turned_pose, upright_turns
from lambent_capture.scenes.crop import Box, cropped, object_crop, whole_frame
from lambent_capture.scenes.world import rotation_and_scale, world_matrix

CropRule = Literal["object", "frame"]


def load_scene(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    *,
    max_side: int,
    lights: tuple[str, ...] | None = None,
    crop: CropRule = "frame",
    store: Path | None = None,
) -> Scene:
    """Return the capture in memory: linear radiance, straight alpha, no side longer than `max_side` pixels.

    `lights` chooses training lights by name; all lights of `manifest` by default. With the crop "object"
    photographs and cameras are first cut to the object (`is_cut_out` says which). Larger pictures are
    averaged over the area of each new pixel, in linear light and weighted by alpha, and pictures through a
    lens with distortion are resampled to the frame's pinhole camera. Ground truth is loaded
    for test views only, since training must not see it. A frame's mask limits the alpha of its photographs,
    and its exposure factor brings them to the exposure of the first frame. Photographs whose cameras were
    found here, not given, are turned upright with them. Pictures that were much reduced
    are kept in the folder `store`, if one is given, and taken from there the next time. Raises `WorkerError`
    with a `scene.*` code when a file cannot be read.
    """
    manifest = select_lights(manifest, lights or tuple(manifest.lights))
    world = world_matrix(manifest)
    views = [
        (
            frame.split,
            _load_view(
                folder,
                frame,
                max_side,
                world,
                cut_out=crop == "object" and is_cut_out(manifest, frame),
                store=store,
                turn=light_turn(manifest, frame),
                upright=manifest.layout == PHOTOGRAPHS,
            ),
        )
        for frame in manifest.frames
    ]
    return Scene(
        name=manifest.name,
        lights=tuple(manifest.lights),
        relight_lights=tuple(manifest.relight_lights),
        train=tuple(view for split, view in views if split == scene_pb2.SPLIT_TRAIN),
        test=tuple(view for split, view in views if split == scene_pb2.SPLIT_TEST),
        bounds_min=_point(manifest.bounds.minimum),
        bounds_max=_point(manifest.bounds.maximum),
        primary=(manifest.primary_rays.near, manifest.primary_rays.far),
        secondary=(manifest.secondary_rays.near, manifest.secondary_rays.far),
        contraction_radius=manifest.contraction_radius,
    )


def full_size_views(folder: Path, manifest: scene_pb2.SceneManifest, light: str) -> Iterator[View]:
    """Yield the training views under `light`, one at a time, with every pixel that their photographs have.

    They are cut to the object, and otherwise as `load_scene` returns them. Raises `WorkerError` as it does.
    """
    manifest = select_lights(manifest, (light,))
    world = world_matrix(manifest)
    for frame in manifest.frames:
        if frame.split == scene_pb2.SPLIT_TRAIN:
            yield _load_view(
                folder,
                frame,
                sys.maxsize,
                world,
                cut_out=is_cut_out(manifest, frame),
                store=None,
                turn=light_turn(manifest, frame),
                upright=manifest.layout == PHOTOGRAPHS,
            )


def is_cut_out(manifest: scene_pb2.SceneManifest, frame: scene_pb2.Frame) -> bool:
    """Return whether a frame may be cut to the object: all but test frames that benchmarks are measured on.

    Those have ground truth, show a light that no training frame has, or belong to a published data set; they
    keep their whole frames, so that figures mean what they mean elsewhere.
    """
    return frame.split != scene_pb2.SPLIT_TEST or not (
        frame.truth
        or manifest.layout in BENCHMARKS
        or any(image.light in manifest.relight_lights for image in frame.images)
    )


def _point(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z


def camera_of(frame: scene_pb2.Frame) -> Camera:
    """Return the camera of a frame as it is used in memory."""
    return _camera(frame.camera)


def _camera(camera: scene_pb2.Camera) -> Camera:
    return Camera(
        width=camera.width,
        height=camera.height,
        focal_x=camera.focal_x,
        focal_y=camera.focal_y,
        centre_x=camera.centre_x,
        centre_y=camera.centre_y,
        camera_to_world=np.array(camera.camera_to_world, dtype=np.float64).reshape(4, 4),
    )


def _load_view(
    folder: Path,
    frame: scene_pb2.Frame,
    max_side: int,
    world: Pose64,
    *,
    cut_out: bool,
    store: Path | None,
    turn: Rotation64 | None,
    upright: bool,
) -> View:
    def make() -> Pictures:
        return _pictures(folder, frame, max_side, cut_out=cut_out)

    settings = {"max_side": max_side, "cut_out": cut_out}
    pictures = make() if store is None else kept(store, folder, frame, settings, make)
    part = cropped(frame.camera, pictures.box)
    size = reduced_size(part.camera.width, part.camera.height, max_side)
    view = View(
        name=frame.name,
        camera=_camera(part.camera).resized(*size),
        images=pictures.images,
        clipped=pictures.clipped,
        truth=_load_truth(folder, frame, size, world) if frame.split == scene_pb2.SPLIT_TEST else {},
        margins=_margins(frame.camera, pictures.box, size),
        light_turn=turn,
    )
    return turned(view, upright_turns(view.camera.camera_to_world)) if upright else view


def turned(view: View, turns: int) -> View:
    """Return a view whose pictures, and camera, are turned to the left by so many quarters."""
    turns %= 4
    if not turns:
        return view

    def left(pictures: Mapping[str, ndarray]) -> dict[str, ndarray]:
        return {name: turned_pixels(each, turns) for name, each in pictures.items()}

    camera, margins = view.camera, view.margins
    focal, centre = (camera.focal_x, camera.focal_y), (camera.centre_x, camera.centre_y)
    sides = (margins.left, margins.top, margins.right, margins.bottom)
    width, height = camera.width, camera.height
    for _ in range(turns):
        focal, centre = focal[::-1], (centre[1], width - centre[0])
        width, height = height, width
        sides = (*sides[1:], sides[0])
    return replace(
        view,
        camera=Camera(
            width=width,
            height=height,
            focal_x=focal[0],
            focal_y=focal[1],
            centre_x=centre[0],
            centre_y=centre[1],
            camera_to_world=turned_pose(camera.camera_to_world, turns),
        ),
        images=left(view.images),
        clipped=left(view.clipped),
        truth=left(view.truth),
        margins=Margins(left=sides[0], top=sides[1], right=sides[2], bottom=sides[3]),
    )


def _pictures(folder: Path, frame: scene_pb2.Frame, max_side: int, *, cut_out: bool) -> Pictures:
    """Return a frame's photographs; only one of them at a time is in memory at its full size."""
    mask = mask_coverage(folder, frame)
    part = whole_frame(frame.camera)
    if cut_out:
        part = object_crop(frame.camera, alphas(folder, frame) if mask is None else [mask])
    size = reduced_size(part.camera.width, part.camera.height, max_side)
    images, clipped = {}, {}
    for image in frame.images:
        rgba, flags = linear_photograph(folder, frame, image, part.file, mask)
        if flags is not None:
            clipped[image.light] = resampled_flags(flags, rgba[..., 3:], part.camera, size)
        images[image.light] = resampled_colour(rgba, part.camera, size)
    return Pictures(part.pinhole, images, clipped)


def _margins(camera: scene_pb2.Camera, box: Box, size: tuple[int, int]) -> Margins:
    """Return the whole pixels of a frame around its crop `box`, which has `size` pixels after reducing."""
    across, down = size[0] / (box[2] - box[0]), size[1] / (box[3] - box[1])
    return Margins(
        left=int(box[0] * across),
        top=int(box[1] * down),
        right=int((camera.width - box[2]) * across),
        bottom=int((camera.height - box[3]) * down),
    )


def _load_truth(
    folder: Path, frame: scene_pb2.Frame, size: tuple[int, int], world: Pose64
) -> dict[str, Channels32]:
    rotation, scale = rotation_and_scale(world)
    truth: dict[str, ndarray] = {}
    coverage = None
    for kind in ("albedo", "normal", "roughness", "metallic", "distance"):
        if kind not in frame.truth:
            continue
        values = stored_levels(folder, frame.truth[kind])
        if values.dtype.kind == "u":
            values = values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)
        if kind in ("albedo", "normal"):
            values = with_alpha(values)
            coverage = values[..., 3:]
            if kind == "normal":
                values = np.concatenate([values[..., :3] * 2.0 - 1.0, coverage], axis=-1)
            values = resampled_colour(values, frame.camera, size)
            if kind == "normal":
                length = np.linalg.norm(values[..., :3], axis=-1, keepdims=True)
                values[..., :3] *= (values[..., 3:] > 0.0) / np.maximum(length, 1e-6)
                values[..., :3] = values[..., :3] @ rotation.T
        else:
            values = values[..., :1]
            weight = (values > 0.0).astype(np.float32) if kind == "distance" or coverage is None else coverage
            values = resampled_weighted(values, weight, frame.camera, size)
            values = values * scale if kind == "distance" else values
        truth[kind] = np.ascontiguousarray(values, dtype=np.float32)
    return truth

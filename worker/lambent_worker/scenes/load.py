"""Loads the pictures of a described capture into memory, reduced and in linear light."""

from pathlib import Path

import numpy as np
import torch
from flashcache.color import linear_from_srgb
from flashcache.data.scene import Camera, Scene, View
from jaxtyping import Float32, Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_worker.errors import WorkerError
from lambent_worker.scenes.lights import select_lights
from lambent_worker.scenes.picture_error import PictureError
from lambent_worker.scenes.pictures import read_coverage, read_pixels
from lambent_worker.scenes.resample import reduced_size, resampled_colour, resampled_weighted
from lambent_worker.scenes.world import rotation_and_scale, world_matrix


def load_scene(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    *,
    max_side: int,
    lights: tuple[str, ...] | None = None,
) -> Scene:
    """Return the capture in memory: linear radiance, straight alpha, no side longer than `max_side` pixels.

    `lights` chooses training lights by name; all lights of `manifest` by default. Larger pictures are
    averaged over the area of each new pixel, in linear light and weighted by alpha, and pictures through a
    lens with distortion are resampled to the frame's pinhole camera. Ground truth is loaded
    for test views only, since training must not see it. A frame's mask limits the alpha of its photographs,
    and its exposure factor brings them to the exposure of the first frame. Raises `WorkerError` with a
    `scene.*` code when a file cannot be read.
    """
    manifest = select_lights(manifest, lights or tuple(manifest.lights))
    world = world_matrix(manifest)
    views = [(frame.split, _load_view(folder, frame, max_side, world)) for frame in manifest.frames]
    return Scene(
        name=manifest.name,
        lights=tuple(manifest.lights),
        relight_lights=tuple(manifest.relight_lights),
        train=tuple(view for split, view in views if split == scene_pb2.SPLIT_TRAIN),
        test=tuple(view for split, view in views if split == scene_pb2.SPLIT_TEST),
        bounds_min=tuple(manifest.bounds.minimum),
        bounds_max=tuple(manifest.bounds.maximum),
        primary=(manifest.primary_rays.near, manifest.primary_rays.far),
        secondary=(manifest.secondary_rays.near, manifest.secondary_rays.far),
        contraction_radius=manifest.contraction_radius,
    )


def camera_of(frame: scene_pb2.Frame) -> Camera:
    """Return the camera of a frame as it is used in memory."""
    camera = frame.camera
    return Camera(
        width=camera.width,
        height=camera.height,
        focal_x=camera.focal_x,
        focal_y=camera.focal_y,
        centre_x=camera.centre_x,
        centre_y=camera.centre_y,
        camera_to_world=np.array(camera.camera_to_world, dtype=np.float64).reshape(4, 4),
    )


def _load_view(folder: Path, frame: scene_pb2.Frame, max_side: int, world: Float64[ndarray, "4 4"]) -> View:
    size = reduced_size(frame.camera.width, frame.camera.height, max_side)
    images = {
        image.light: resampled_colour(_photograph(folder, frame, image), frame.camera, size)
        for image in frame.images
    }
    return View(
        name=frame.name,
        camera=camera_of(frame).resized(*size),
        images=images,
        truth=_load_truth(folder, frame, size, world) if frame.split == scene_pb2.SPLIT_TEST else {},
    )


def _pixels(folder: Path, path: str) -> ndarray:
    try:
        return read_pixels(folder / path)
    except PictureError as error:
        raise WorkerError(error.code, f"{path} {error}") from error


def _photograph(
    folder: Path, frame: scene_pb2.Frame, image: scene_pb2.Image
) -> Float32[ndarray, "height width 4"]:
    rgba = _linear_rgba(folder, image.path, image.encoding)
    rgba[..., :3] *= np.float32(frame.exposure or 1.0)
    if frame.mask:
        try:
            coverage = read_coverage(folder / frame.mask, frame.mask_encoding)
        except PictureError as error:
            raise WorkerError(error.code, f"{frame.mask} {error}") from error
        if coverage.shape != rgba.shape[:2]:
            raise WorkerError(
                "scene.mask_size",
                f"{frame.mask} has {coverage.shape[1]} x {coverage.shape[0]} pixels, {image.path} has "
                f"{rgba.shape[1]} x {rgba.shape[0]}; make them one size",
            )
        # The smaller of the two: a picture that was cut out with the same mask keeps its soft edges.
        rgba[..., 3] = np.minimum(rgba[..., 3], coverage)
    return rgba


def _linear_rgba(folder: Path, path: str, encoding: str) -> Float32[ndarray, "height width 4"]:
    pixels = _pixels(folder, path)
    if pixels.shape[-1] <= 2:  # grey, perhaps with alpha
        pixels = np.concatenate([np.repeat(pixels[..., :1], 3, axis=-1), pixels[..., 1:]], axis=-1)
    if encoding == "srgb":
        curve = linear_from_srgb(torch.arange(256) / 255.0).numpy()
        rgb, alpha = curve[pixels[..., :3]], pixels[..., 3:].astype(np.float32) / 255.0
    else:
        rgb, alpha = pixels[..., :3], pixels[..., 3:]
    return _with_alpha(np.concatenate([rgb, alpha], axis=-1)).astype(np.float32)


def _load_truth(
    folder: Path, frame: scene_pb2.Frame, size: tuple[int, int], world: Float64[ndarray, "4 4"]
) -> dict[str, Float32[ndarray, "height width channels"]]:
    rotation, scale = rotation_and_scale(world)
    truth: dict[str, ndarray] = {}
    coverage = None
    for kind in ("albedo", "normal", "roughness", "metallic", "distance"):
        if kind not in frame.truth:
            continue
        values = _pixels(folder, frame.truth[kind])
        if values.dtype == np.uint8:
            values = values.astype(np.float32) / 255.0
        if kind in ("albedo", "normal"):
            values = _with_alpha(values)
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


def _with_alpha(values: Float32[ndarray, "height width _"]) -> Float32[ndarray, "height width 4"]:
    if values.shape[-1] == 4:
        return values
    return np.concatenate([values[..., :3], np.ones_like(values[..., :1])], axis=-1)

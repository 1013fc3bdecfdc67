"""Reads the pictures of a capture once, at reduced size, and measures each of them."""

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from lambent_core.colour import srgb_from_linear
from lambent_proto.v1 import scene_pb2
from numpy import ndarray
from PIL import Image
from scipy import ndimage

from lambent_capture.arrays import Grey, Grey32, Region, Rgb
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.pictures.coverage import frame_mask
from lambent_capture.pictures.picture import box_averaged
from lambent_capture.pictures.pictures import read_picture
from lambent_capture.pictures.resample import reduced_size
from lambent_capture.pictures.upright import upright_turns
from lambent_capture.scenes.picture_camera import PictureCamera

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
_RIM = 3
"""Pixels left out along the outline when sharpness is measured: the outline is the mask's, not the lens's."""
PORTRAIT_SIDE = 320
"""Longer side of the picture by which people recognise a capture, pixels."""
_PORTRAIT_BEHIND = 232.0
"""What is behind an object that is cut out, an encoded grey."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureObservation:
    """Measurements of one photograph."""

    light: str
    path: str
    clipped_share: float
    """Share of the object's pixels at the end of the scale; 0 for linear pictures."""
    detail: float
    """Fine over coarse contrast on the object; the unit means nothing, only ratios do. 0 where unknown."""
    luminance: Grey32
    """Linear, in the exposure of the first frame, at silhouette size."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Observation:
    """Measurements of a frame after reading its pictures."""

    frame: scene_pb2.Frame
    camera: PictureCamera
    """In pixels at silhouette size."""
    coverage: Grey32
    """Share of each pixel that the object covers, at silhouette size."""
    pictures: tuple[PictureObservation, ...]
    thumbnail: str
    """JPEG, base64, upright."""
    portrait: str = ""
    """The first frame's picture by which people recognise the capture: JPEG, base64, upright; else empty."""

    @property
    def mask(self) -> Region:
        """Return the silhouette."""
        return self.coverage >= 0.5

    @property
    def has_mask(self) -> bool:
        """Return whether anything in the picture is not the object."""
        return bool((self.coverage < 0.5).any())


def observe(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    limits: CaptureLimits,
    announce: Callable[[str], None] = lambda path: None,
) -> list[Observation]:
    """Return the measurements of frames with photographs in training lights, in the order of `manifest`.

    `announce` is called with the path of each file before it is decoded. Raises `PictureError` for one that
    cannot be read.
    """
    observations: list[Observation] = []
    for frame in manifest.frames:
        images = [image for image in frame.images if image.light in manifest.lights]
        if images:
            is_first = not observations
            observations.append(_observe_frame(folder, frame, images, limits, announce, is_first=is_first))
    return observations


def _observe_frame(
    folder: Path,
    frame: scene_pb2.Frame,
    images: list[scene_pb2.Image],
    limits: CaptureLimits,
    announce: Callable[[str], None],
    *,
    is_first: bool,
) -> Observation:
    camera = PictureCamera.of_frame(frame)
    size = reduced_size(camera.width, camera.height, limits.silhouette_side)
    mask = None
    if frame.mask:
        announce(frame.mask)
        mask = frame_mask(folder, frame)
    pictures, coverage = [], np.ones((size[1], size[0]), dtype=np.float32)
    thumbnail = portrait = ""
    for image in images:
        announce(image.path)
        picture = read_picture(folder / image.path, side=limits.detail_side)
        shown, alpha = picture.srgb(), picture.coverage()
        if mask is not None:
            alpha = np.minimum(alpha, box_averaged(mask.coverage, (alpha.shape[1], alpha.shape[0])))
        inside = alpha > 0.98
        light = (picture.linear() @ LUMINANCE) * np.float32(frame.exposure or 1.0)
        ended = picture.clipped()
        small = box_averaged(alpha, size)
        pictures.append(
            PictureObservation(
                light=image.light,
                path=image.path,
                clipped_share=float(np.any(ended, axis=-1)[inside].mean())
                if ended is not None and inside.any()
                else 0.0,
                detail=fine_contrast(srgb_from_linear(light).astype(np.float32), alpha),
                luminance=box_averaged(light * alpha, size) / np.maximum(small, 1e-6),
            )
        )
        if not thumbnail:
            coverage = small
            turns = upright_turns(camera.camera_to_world)
            upright, cover = np.rot90(shown, turns), np.rot90(alpha, turns)
            thumbnail = thumbnail_of(upright, cover, side=limits.thumbnail_side)
            if is_first:
                portrait = portrait_of(upright, cover)
    return Observation(
        frame=frame,
        camera=camera.resized(*size),
        coverage=coverage,
        pictures=tuple(pictures),
        thumbnail=thumbnail,
        portrait=portrait,
    )


def fine_contrast(values: Grey, alpha: Grey) -> float:
    """Return the share of the object's contrast that is in its finest details, independent of its content.

    The standard deviation of details of about one pixel, over that of details of about three: blur takes the
    first away and leaves the second. 0 where the object is too small or has no contrast at all.
    """
    inside = ndimage.binary_erosion(alpha > 0.98, iterations=_RIM, border_value=1)
    if inside.sum() < 64:
        return 0.0
    # Outside of the object its mean, so that the outline makes no edge.
    filled = np.where(alpha > 0.5, values, values[inside].mean()).astype(np.float32)
    fine = filled - ndimage.gaussian_filter(filled, 0.7)
    coarse = ndimage.gaussian_filter(filled, 1.4) - ndimage.gaussian_filter(filled, 2.8)
    spread = float(coarse[inside].std())
    return float(fine[inside].std()) / spread if spread > 1e-4 else 0.0


def thumbnail_of(image_srgb: Rgb, alpha: Grey32, *, side: int) -> str:
    """Return `outlined_picture` as JPEG, base64."""
    return _jpeg(Image.fromarray(outlined_picture(image_srgb, alpha, side)), quality=75)


def portrait_of(image_srgb: Rgb, alpha: Grey32) -> str:
    """Return a picture of at most `PORTRAIT_SIDE` pixels over light grey, as JPEG in base64."""
    over = image_srgb * alpha[..., None] + _PORTRAIT_BEHIND * (1.0 - alpha[..., None])
    size = reduced_size(alpha.shape[1], alpha.shape[0], PORTRAIT_SIDE)
    image = Image.fromarray(np.round(over).astype(np.uint8)).resize(size, Image.Resampling.BOX)
    return _jpeg(image, quality=80)


def _jpeg(image: Image.Image, *, quality: int) -> str:
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=quality)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def outlined_picture(
    image_srgb: Rgb, alpha: Grey, side: int, behind: float = 0.0
) -> UInt8[ndarray, "rows columns 3"]:
    """Return a small picture over grey with the outline of the mask in magenta.

    `behind` is how much of what is cut off shines through, 0..1.
    """
    weight = (alpha + behind * (1.0 - alpha))[..., None]
    over = image_srgb * weight + 176.0 * (1.0 - weight)
    size = reduced_size(alpha.shape[1], alpha.shape[0], side)
    image = Image.fromarray(np.round(over).astype(np.uint8)).resize(size, Image.Resampling.BOX)
    mask = box_averaged(alpha, size) >= 0.5
    shown = np.array(image)
    shown[mask & ~ndimage.binary_erosion(mask, border_value=1)] = (230, 0, 160)
    return shown

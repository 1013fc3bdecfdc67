"""Ground truth of a scene in TensoIR-synthetic's layout, and the figures that compare pictures with it.

Pictures are float64; image figures follow the published protocol: composited over white in sRGB-encoded
values. Albedo is linear and compared after one factor per channel; normals are unit, world space.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lambent_relight import Camera
from numpy.typing import NDArray
from PIL import Image

Picture = NDArray[np.floating]
BACKGROUND_NORMAL = (0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class TrueView:
    """A held-out view: its camera and everything that is known about it."""

    name: str
    camera: Camera
    pictures_srgb: dict[str, Picture]
    """By light: [H, W, 3], over white."""
    albedo: Picture
    """[H, W, 3], linear, over white."""
    normal: Picture
    """[H, W, 3], unit; (0, 0, 1) on the background."""
    roughness: Picture
    """[H, W], perceptual; inside the mask."""
    metalness: Picture
    """[H, W], inside the mask."""
    mask: NDArray[np.bool_]
    """[H, W], where the object covers any part of a pixel."""


def read_camera(folder: Path) -> Camera:
    """Return the camera of a view folder."""
    data = json.loads((folder / "metadata.json").read_text())
    width, height = int(data["imw"]), int(data["imh"])
    focal = 0.5 * width / np.tan(0.5 * float(data["cam_angle_x"]))
    pose = np.array([float(word) for word in data["cam_transform_mat"].split(",")]).reshape(4, 4)
    return Camera.centred(folder.name, width, height, focal, pose)


def read_view(folder: Path, lights: tuple[str, ...]) -> TrueView:
    """Return one view with its pictures under `lights` (file names without "rgba_" and suffix)."""
    albedo, normal = _pixels(folder / "albedo.png"), _pixels(folder / "normal.png")
    return TrueView(
        name=folder.name,
        camera=read_camera(folder),
        pictures_srgb={light: over_white(_pixels(folder / f"rgba_{light}.png")) for light in lights},
        albedo=over_white(albedo),
        normal=blend_normals(2.0 * normal[..., :3] - 1.0, normal[..., 3:]),
        roughness=_pixels(folder / "roughness.png")[..., 0],
        metalness=_pixels(folder / "metallic.png")[..., 0],
        mask=albedo[..., 3] > 0,
    )


def nearest_photograph(scene: Path, view: TrueView, light: str) -> Picture:
    """Return the training photograph whose camera is closest to the view's: the floor of a reconstruction."""
    folders = sorted(path for path in scene.glob("train_*") if path.is_dir())
    eye = view.camera.camera_to_world[:3, 3]
    closest = min(folders, key=lambda f: np.linalg.norm(read_camera(f).camera_to_world[:3, 3] - eye))
    return over_white(_pixels(closest / f"rgba_{light}.png"))


def _pixels(path: Path) -> Picture:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGBA"), np.float64) / 255.0


def over_white(rgba: Picture) -> Picture:
    """Return straight-alpha [H, W, 4] composited over white, [H, W, 3]."""
    return rgba[..., :3] * rgba[..., 3:] + 1.0 - rgba[..., 3:]


def blend_normals(normal: Picture, alpha: Picture) -> Picture:
    """Return unit normals [H, W, 3] that go over into (0, 0, 1) where `alpha` [H, W, 1] falls to zero."""
    mixed = normal * alpha + np.array(BACKGROUND_NORMAL) * (1.0 - alpha)
    unit: Picture = mixed / np.maximum(np.linalg.norm(mixed, axis=-1, keepdims=True), 1e-9)
    return unit


def psnr(picture: Picture, true: Picture) -> float:
    """Return the peak signal-to-noise ratio in dB for values in [0, 1]; 100 dB for equal pictures."""
    return float(-10.0 * np.log10(max(float(np.mean((picture - true) ** 2)), 1e-10)))


def albedo_ratio(albedos: list[Picture], views: list[TrueView]) -> Picture:
    """Return one factor per channel, [3]: the median of truth / prediction over covered pixels of all views.

    Predictions [H, W, 3] are linear and over white, like the truth.
    """
    ratios = [
        view.albedo[view.mask] / np.maximum(albedo[view.mask], 1e-6)
        for albedo, view in zip(albedos, views, strict=True)
    ]
    return np.median(np.concatenate(ratios), axis=0)


def albedo_psnr(albedos: list[Picture], ratio: Picture, views: list[TrueView]) -> float:
    """Return the PSNR in dB of scaled albedo over all views, after ^(1/2.2), white outside the mask."""
    scaled = [
        np.where(view.mask[..., None], np.clip(ratio * albedo, 0.0, 1.0), 1.0)
        for albedo, view in zip(albedos, views, strict=True)
    ]
    return psnr(np.stack(scaled) ** (1.0 / 2.2), np.stack([view.albedo for view in views]) ** (1.0 / 2.2))


def normal_error_deg(normal: Picture, view: TrueView) -> float:
    """Return the mean angle between unit normals inside the mask, in degrees."""
    cosine = np.clip((normal * view.normal).sum(axis=-1), -1.0, 1.0)
    return float(np.degrees(np.arccos(cosine))[view.mask].mean())


def rmse(estimate: Picture, true: Picture, mask: NDArray[np.bool_]) -> float:
    """Return the root mean square difference of two maps [H, W] inside the mask."""
    return float(np.sqrt(np.mean((estimate - true)[mask] ** 2)))

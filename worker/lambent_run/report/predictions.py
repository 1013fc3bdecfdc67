"""Renders a trained model's predictions for a scene's views, as float maps that any script can score.

pred/<view>/rgba_<light>.npy          straight alpha [H, W, 4], sRGB-encoded, the physically based picture
pred/<view>/albedo.npy                linear [H, W, 4];  normal.npy world xyz [H, W, 3]
pred/<view>/roughness.npy             perceptual, [H, W, 1];  metallic.npy [H, W, 1];  distance.npy [H, W, 1]
pred_cache/<view>/rgba_<light>.npy    the same picture from the NeRF cache alone
pred_direct/<view>/rgba_<light>.npy   relit without the indirect bounce
pred_unscaled/<view>/rgba_<light>.npy relit without the albedo ratio, a few views
<name>_stderr.npy                     for every Monte Carlo picture: its standard error, linear radiance
                                      [H, W, 3]
<name>.exr                            on request: linear radiance times alpha, alpha, and the standard error
pred/<view>/uncertainty.npy           how uncertain the materials are [H, W, 5]: docs/reference/protocol.md
noise/<view>.json                     mean standard error of each Monte Carlo picture, linear radiance
"""

import json
from pathlib import Path

import numpy as np
import torch
from flashcache.color import srgb_from_linear
from flashcache.evaluation.metrics import normal_with_background
from flashcache.evaluation.views import (
    GBuffer,
    Picture,
    PictureSamples,
    render_physical,
    render_relit,
    render_surface,
)
from jaxtyping import Float, Float32
from lambent_core.exr import write_exr
from lambent_core.files import whole_file, write_json
from lambent_core.scene import View, evenly_spaced
from numpy import ndarray

from lambent_run.report import figures
from lambent_run.report.request import UNSCALED_VIEWS, Subject
from lambent_run.report.uncertainty import uncertainty_map

CACHE_FOLDER = "pred_cache"
DIRECT_FOLDER = "pred_direct"
UNSCALED_FOLDER = "pred_unscaled"
ERROR_SUFFIX = "_stderr"


def predict_surfaces(subject: Subject) -> None:
    """Write surface maps and pictures under the training lights for all views; existing ones are kept."""
    for view in subject.views:
        folder = subject.out / "pred" / view.name
        if not (folder / "metallic.npy").is_file():
            buffer = render_surface(
                subject.model,
                view.camera,
                light=subject.model.light_at(0, view.light_turn),
                antialias=subject.request.antialias,
            )
            _save_pictures_of_cache(subject, view, buffer)
            _save_surface(folder, buffer)
        subject.advance()
        for index, light in enumerate(subject.scene.lights):
            path = folder / f"rgba_{light}.npy"
            if not _is_there(subject, path):
                picture = render_physical(
                    subject.model,
                    view.camera,
                    _samples(subject),
                    light=subject.model.light_at(index, view.light_turn),
                    seed=subject.seed,
                    rule=subject.rule,
                )
                _save_picture(subject, view.name, f"physical/{light}", path, picture)
            subject.advance()


def predict_relit(subject: Subject, ratio: tuple[float, float, float]) -> None:
    """Write the relit pictures of all views; `ratio` multiplies the albedo per channel."""
    unscaled = {view.name for view in evenly_spaced(subject.views, UNSCALED_VIEWS)}
    ones = (1.0, 1.0, 1.0)
    for view in subject.views:
        for light in subject.maps:
            kinds = [("pred", "relit", True, ratio), (DIRECT_FOLDER, "direct", False, ratio)]
            if view.name in unscaled and ratio != ones:
                kinds.append((UNSCALED_FOLDER, "unscaled", True, ones))
            for folder, kind, indirect, factor in kinds:
                path = subject.out / folder / view.name / f"rgba_{light}.npy"
                if not _is_there(subject, path):
                    picture = render_relit(
                        subject.model,
                        view.camera,
                        subject.maps[light],
                        _samples(subject),
                        albedo_ratio=factor,
                        indirect=indirect,
                        seed=subject.seed,
                        rule=subject.rule,
                    )
                    _save_picture(subject, view.name, f"{kind}/{light}", path, picture)
                subject.advance()


def _samples(subject: Subject) -> PictureSamples:
    request = subject.request
    return PictureSamples(
        num_directions=request.num_directions, num_repeats=request.num_repeats, antialias=request.antialias
    )


def predict_uncertainty(subject: Subject) -> None:
    """Write the uncertainty of materials where the pixels of each view meet the surface."""
    if subject.uncertainty is None:
        return
    for view in subject.views:
        folder = subject.out / "pred" / view.name
        if not (folder / "uncertainty.npy").is_file():
            distance = np.load(folder / "distance.npy", allow_pickle=False)
            values = uncertainty_map(subject.model, subject.uncertainty, view.camera, distance)
            save_array(folder / "uncertainty.npy", values)


def num_pictures(subject: Subject) -> int:
    """Return the number of calls of `advance` by the two functions above."""
    few = len(evenly_spaced(subject.views, UNSCALED_VIEWS))
    views, maps = len(subject.views), len(subject.maps)
    return views * (1 + len(subject.scene.lights) + 2 * maps) + few * maps


def read_noise(out: Path, view: str) -> dict[str, float]:
    """Return mean standard errors of a view's Monte Carlo pictures by `<kind>/<light>`, linear radiance."""
    path = out / "noise" / f"{view}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def encoded(
    rgb: Float[ndarray, "height width 3"], opacity: Float[ndarray, "height width 1"]
) -> Float32[ndarray, "height width 4"]:
    """Return linear straight-alpha radiance clipped to 0..1 and sRGB-encoded, with its alpha."""
    values = torch.from_numpy(np.clip(rgb, 0.0, 1.0).astype(np.float32))
    return np.concatenate([srgb_from_linear(values).numpy(), np.clip(opacity, 0.0, 1.0)], axis=-1)


def over_white(image: Float[ndarray, "height width 4"]) -> Float[ndarray, "height width 3"]:
    """Return a photograph, linear straight alpha, as pages show it: sRGB-encoded over white, 0..1."""
    return figures.picture(encoded(image[..., :3], image[..., 3:]).astype(np.float64))


def load(out: Path, folder: str, view: View, name: str) -> Float[ndarray, "height width channels"] | None:
    """Return a predicted map as float64, or None where it was not rendered."""
    path = out / folder / view.name / f"{name}.npy"
    return np.load(path, allow_pickle=False).astype(np.float64) if path.is_file() else None


def _save_surface(folder: Path, buffer: GBuffer) -> None:
    opacity = np.clip(buffer.opacity, 0.0, 1.0)
    save_array(folder / "albedo.npy", np.concatenate([buffer.albedo, opacity], axis=-1))
    save_array(folder / "normal.npy", normal_with_background(buffer.normal, opacity))
    save_array(folder / "roughness.npy", buffer.perceptual_roughness)
    save_array(folder / "distance.npy", buffer.distance)
    save_array(folder / "metallic.npy", buffer.metalness)


def _save_pictures_of_cache(subject: Subject, view: View, buffer: GBuffer) -> None:
    for index, light in enumerate(subject.scene.lights):
        seen = buffer
        if index:
            seen = render_surface(
                subject.model, view.camera, light=index, antialias=subject.request.antialias
            )
        straight = seen.cache_rgb / np.maximum(seen.opacity, 1e-6)
        save_array(
            subject.out / CACHE_FOLDER / view.name / f"rgba_{light}.npy", encoded(straight, seen.opacity)
        )


def _is_there(subject: Subject, path: Path) -> bool:
    """Return whether a picture was written, with all that goes with it."""
    return path.is_file() and (path.with_suffix(".exr").is_file() or not subject.request.exr)


def _save_picture(subject: Subject, view: str, kind: str, path: Path, picture: Picture) -> None:
    """Save a picture, and before it its standard error and the mean of that over the opaque part."""
    out, error = subject.out, picture.standard_error
    seen = picture.opacity[..., 0] > 0.5
    noise = float(error[seen].mean()) if seen.any() else 0.0
    (out / "noise").mkdir(parents=True, exist_ok=True)
    write_json(out / "noise" / f"{view}.json", {**read_noise(out, view), kind: noise})
    save_array(path.with_name(f"{path.stem}{ERROR_SUFFIX}.npy"), error)
    if subject.request.exr:
        write_exr(path.with_suffix(".exr"), exr_channels(picture))
    save_array(path, encoded(picture.rgb, picture.opacity))


def exr_channels(picture: Picture) -> dict[str, Float32[ndarray, "height width"]]:
    """Return a picture as channels of an EXR: premultiplied colour, alpha, and the layer `standard_error`."""
    opacity = np.clip(picture.opacity, 0.0, 1.0)
    planes = {name: (picture.rgb * opacity)[..., c] for c, name in enumerate("RGB")}
    planes["A"] = opacity[..., 0]
    return planes | {
        f"standard_error.{name}": (picture.standard_error * opacity)[..., c] for c, name in enumerate("RGB")
    }


def save_array(path: Path, values: Float[ndarray, "..."]) -> None:
    """Write a float32 array; the file is there whole or not at all."""
    with whole_file(path) as partial, partial.open("wb") as file:
        np.save(file, np.ascontiguousarray(values, dtype=np.float32))

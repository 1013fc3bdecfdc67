"""Relit pictures from a bundle: the entry point.

picture = render(load_bundle("cow.relight"), camera, load_environment("sky.exr"), rotate_deg=90)
"""

import logging
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lambent_relight.brdf import materials_from_roughness
from lambent_relight.bundle import Bundle
from lambent_relight.cameras import Camera
from lambent_relight.directions import normalise
from lambent_relight.environments import Environment
from lambent_relight.errors import SettingError, UnsupportedQuality
from lambent_relight.graphs import OnnxCaches, PrimaryHits, SurfaceCaches
from lambent_relight.light_sampling import LightSampler
from lambent_relight.picture import RelitPicture
from lambent_relight.refined import Light, Scene, outgoing_radiance
from lambent_relight.scattering import SurfacePoints
from lambent_relight.views import View, look

Background = Literal["transparent", "environment"] | tuple[float, float, float]

Reader = Literal["auto", "fused", "onnx"]

_LOG = logging.getLogger("lambent_relight")
_KEPT_RAYS = 3_000_000
"""Camera rays that are remembered; about 70 bytes each."""
_MAX_ANTIALIAS = 8


class Renderer:
    """Renders views of one bundle; keeps its graphs open and what the last cameras saw."""

    def __init__(self, bundle: Bundle, *, num_threads: int | None = None, reader: Reader = "auto") -> None:
        """Prepare `bundle` for `num_threads` CPU threads (default: all this process may use).

        `reader` says what answers secondary rays: "fused" (compiled code, fast), "onnx" (the bundle's
        graphs), or "auto": fused where the bundle's networks are known, else the graphs, which is logged
        as a warning with the reason. Raises SettingError when "fused" is asked for and impossible.
        """
        self.bundle = bundle
        self.caches: SurfaceCaches = _open_caches(bundle, num_threads, reader)
        self._views: dict[tuple[bytes, int], View] = {}
        self._light: tuple[Environment, Light] | None = None

    def gbuffer(self, camera: Camera) -> PrimaryHits:
        """Return what the rays through the middles of `camera`'s pixels see, [height * width, n] each."""
        return self.caches.gbuffer(*camera.rays())

    def view(self, camera: Camera, antialias: int) -> View:
        """Return what `camera` sees; the last few cameras are remembered."""
        key = (camera.key(), antialias)
        if key not in self._views:
            view = look(self.caches, camera, antialias)
            while self._views and sum(v.num_rays for v in self._views.values()) + view.num_rays > _KEPT_RAYS:
                self._views.pop(next(iter(self._views)))
            self._views[key] = view
        return self._views[key]

    def _prepared(self, environment: Environment) -> Light:
        if self._light is None or self._light[0] is not environment:
            self._light = (environment, Light(environment, LightSampler(environment)))
        return self._light[1]

    def render(
        self,
        camera: Camera,
        environment: Environment,
        *,
        rotate_deg: float = 0.0,
        quality: str = "refined",
        num_samples: int = 64,
        seed: int = 0,
        indirect: bool = True,
        antialias: int = 2,
        albedo_ratio: NDArray[np.floating] | None = None,
        background: Background = "transparent",
        progress: Callable[[float], None] | None = None,
    ) -> RelitPicture:
        """Return the bundle's object as `camera` sees it in the light of `environment`; see `render`."""
        if quality != "refined":
            raise UnsupportedQuality(
                "relight.quality_unsupported", f"quality {quality!r} does not exist yet", 'use "refined"'
            )
        if num_samples < 2:
            raise SettingError("relight.num_samples", f"{num_samples} samples", "use at least 2")
        if not 1 <= antialias <= _MAX_ANTIALIAS:
            raise SettingError("relight.antialias", f"antialias {antialias}", f"use 1 to {_MAX_ANTIALIAS}")
        ratio = _checked_ratio(self.bundle, albedo_ratio)
        light = self._prepared(environment.rotated(rotate_deg) if rotate_deg else environment)
        view = self.view(camera, antialias)
        seen = view.hits
        albedo = np.clip(seen.albedo * ratio, 0.0, 1.0)
        points = SurfacePoints(
            view.origin + seen.distance * view.direction,
            seen.normal,
            -view.direction,
            materials_from_roughness(albedo, seen.perceptual_roughness, seen.metalness),
        )
        radiance = outgoing_radiance(
            points,
            Scene(self.caches, self.bundle.manifest.secondary_rays.origin_offset, ratio),
            light,
            num_samples=max(2, -(-num_samples // antialias**2)),
            seed=seed,
            indirect=indirect,
            progress=progress,
        )
        coverage = view.coverage()
        direct, bounced = view.mean(radiance.direct), view.mean(radiance.indirect)
        rgb, error = direct + bounced, view.error_of_mean(radiance.standard_error)
        opacity = coverage
        if background != "transparent":
            behind = _background(background, light.environment, camera.rays()[1]).reshape(rgb.shape)
            rgb, error = coverage * rgb + (1.0 - coverage) * behind, coverage * error
            opacity = np.ones_like(coverage)
        return RelitPicture(
            rgb=rgb,
            opacity=opacity,
            standard_error=error,
            direct=direct,
            indirect=bounced,
            albedo=view.mean(albedo),
            normal=normalise(view.mean(seen.normal)),
            perceptual_roughness=view.mean(seen.perceptual_roughness),
            metalness=view.mean(seen.metalness),
            distance=view.mean(seen.distance),
            coverage=coverage,
            num_samples=radiance.num_samples * antialias**2,
        )


def _open_caches(bundle: Bundle, num_threads: int | None, reader: Reader) -> SurfaceCaches:
    if reader == "onnx":
        return OnnxCaches(bundle, num_threads=num_threads)
    # Compiled code takes a second to import, which programs that only look at bundles do not pay.
    from lambent_relight.fused import FusedCaches, NotFused

    try:
        return FusedCaches(bundle, num_threads=num_threads)
    except NotFused as reason:
        if reader == "fused":
            raise SettingError(
                "relight.reader", f"the fused reader cannot read this bundle ({reason})", 'use "onnx"'
            ) from reason
        _LOG.warning("relighting through onnxruntime, which is slower: %s", reason)
        return OnnxCaches(bundle, num_threads=num_threads)


def _checked_ratio(bundle: Bundle, ratio: NDArray[np.floating] | None) -> NDArray[np.float32]:
    values = np.asarray(bundle.manifest.albedo_scale_rgb if ratio is None else ratio, np.float32)
    values = np.broadcast_to(values, (3,)) if values.shape in ((), (1,), (3,)) else values
    if values.shape != (3,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise SettingError(
            "relight.albedo_ratio", f"albedo ratio {ratio}", "give one or three positive numbers"
        )
    return values


def _background(
    background: Background, environment: Environment, direction: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return what lies behind the object along every camera ray, [ray, 3]."""
    if background == "environment":
        return environment.lookup(direction)
    colour = np.asarray(background, np.float32) if not isinstance(background, str) else np.empty(0)
    if colour.shape != (3,) or not (np.isfinite(colour).all() and (colour >= 0).all()):
        raise SettingError(
            "relight.background",
            f"background {background!r}",
            'use "transparent", "environment" or three linear values',
        )
    return np.broadcast_to(colour, direction.shape)


def render(
    bundle: Bundle,
    camera: Camera,
    environment: Environment,
    *,
    rotate_deg: float = 0.0,
    quality: str = "refined",
    num_samples: int = 64,
    seed: int = 0,
    indirect: bool = True,
    antialias: int = 2,
    albedo_ratio: NDArray[np.floating] | None = None,
    background: Background = "transparent",
    progress: Callable[[float], None] | None = None,
) -> RelitPicture:
    """Return the bundle's object as `camera` sees it in the light of `environment`.

    `rotate_deg` turns the light by that angle about +z. `num_samples` light directions are spent on every
    covered pixel, shared by `antialias` x `antialias` rays (two directions each at least); `indirect` adds
    light that was reflected once before. `albedo_ratio` (one or three factors on the stored albedo, result
    clipped to [0, 1]) defaults to the manifest's `albedo_scale_rgb`. `background` is "transparent",
    "environment" or a linear colour. `progress` is called with the finished fraction. Equal seeds give equal
    pictures.

    Opens the bundle's graphs anew: to render many pictures, make one `Renderer`. Raises SettingError,
    UnsupportedQuality (every quality but "refined") or BundleError.
    """
    return Renderer(bundle).render(
        camera,
        environment,
        rotate_deg=rotate_deg,
        quality=quality,
        num_samples=num_samples,
        seed=seed,
        indirect=indirect,
        antialias=antialias,
        albedo_ratio=albedo_ratio,
        background=background,
        progress=progress,
    )

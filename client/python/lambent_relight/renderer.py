"""Relit pictures from a bundle: the entry point.

picture = render(load_bundle("cow.relight"), camera, load_environment("sky.exr"), rotate_deg=90)
"""

import functools
import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lambent_relight.brdf import materials_from_roughness
from lambent_relight.bundle.adapted import choose
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import NoCaches, OnnxCaches, PrimaryHits, SurfaceCaches
from lambent_relight.cameras import Camera
from lambent_relight.directions import normalise, rotate_about_z
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import Environment
from lambent_relight.errors import SettingError, UnsupportedQuality
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.sampling_plan import BOUNCES, Bounces, Sampling, estimated
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Light, Scene
from lambent_relight.views import View, look

if TYPE_CHECKING:
    from lambent_relight.baked.renderer import BakedRenderer
    from lambent_relight.fused.reader import FusedCaches

Background = Literal["transparent", "environment"] | tuple[float, float, float]

Reader = Literal["auto", "fused", "onnx"]

QUALITIES = ("preview", "baked", "refined")

_LOG = logging.getLogger("lambent_relight")
KEPT_RAYS = 3_000_000
"""Camera rays that are remembered by default; about 70 bytes each."""
_MAX_ANTIALIAS = 8


class Renderer:
    """Renders views of one bundle; keeps its graphs open and what the last cameras saw."""

    def __init__(
        self,
        bundle: Bundle,
        *,
        num_threads: int | None = None,
        reader: Reader = "auto",
        kept_rays: int = KEPT_RAYS,
    ) -> None:
        """Prepare `bundle` for `num_threads` CPU threads (default: all this process may use).

        `reader` says what answers secondary rays: "fused" (compiled code, fast), "onnx" (the bundle's
        graphs), or "auto": fused where the bundle's networks are known, else the graphs, which is logged
        as a warning with the reason. Raises SettingError when "fused" is asked for and impossible.
        `kept_rays` bounds the views that are remembered, by their camera rays; the last one always is.
        """
        self.bundle = bundle
        self._kept_rays = kept_rays
        self._networks = _open_caches(bundle, num_threads, reader)
        self.caches: SurfaceCaches = self._networks
        self._told = ""
        self._views: dict[tuple[bytes, int], View] = {}
        self._light: tuple[Environment, Light] | None = None
        self._baked: BakedRenderer | None = None

    def gbuffer(self, camera: Camera) -> PrimaryHits:
        """Return what the rays through the middles of `camera`'s pixels see, [height * width, n] each."""
        return self.caches.gbuffer(*camera.rays())

    def view(self, camera: Camera, antialias: int) -> View:
        """Return what `camera` sees; the last few cameras are remembered."""
        key = (camera.key(), antialias)
        if key not in self._views:
            view = look(self.caches, camera, antialias)
            while (
                self._views
                and sum(v.num_rays for v in self._views.values()) + view.num_rays > self._kept_rays
            ):
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
        edit: MaterialEdit | None = None,
        object_rotate_deg: float = 0.0,
        until_stderr: float = 0.0,
        bounces: Bounces = "auto",
        soft_edges: bool = True,
        progress: Callable[[float], None] | None = None,
    ) -> RelitPicture:
        """Return the bundle's object as `camera` sees it in the light of `environment`; see `render`.

        Without `soft_edges` the mesh alone draws the outline of a `baked` picture: for a camera that moves.
        """
        if quality not in QUALITIES:
            raise UnsupportedQuality(
                "relight.quality_unsupported",
                f"there is no quality {quality!r}",
                f"use one of {', '.join(QUALITIES)}",
            )
        if num_samples < 2:
            raise SettingError("relight.num_samples", f"{num_samples} samples", "use at least 2")
        if not 1 <= antialias <= _MAX_ANTIALIAS:
            raise SettingError("relight.antialias", f"antialias {antialias}", f"use 1 to {_MAX_ANTIALIAS}")
        if not 0.0 <= until_stderr < 1.0:
            raise SettingError("relight.until_stderr", f"standard error {until_stderr}", "use 0 to 1")
        if bounces not in BOUNCES:
            raise SettingError("relight.bounces", f"bounces {bounces!r}", f"use one of {', '.join(BOUNCES)}")
        edit = _combined(self.bundle, edit or MaterialEdit(), albedo_ratio)
        turned = environment.rotated(rotate_deg) if rotate_deg else environment
        if object_rotate_deg:
            # Turning the object is turning everything else the other way.
            turned = turned.rotated(-object_rotate_deg)
            camera = _turned_camera(camera, -object_rotate_deg)
        if quality == "refined":
            sampling = Sampling(num_samples, seed, indirect, antialias, until_stderr, bounces)
            picture = self._refined(camera, turned, edit, sampling, progress)
        else:
            picture = self.baked().render(
                camera,
                turned,
                preview=quality == "preview",
                antialias=antialias,
                indirect=indirect,
                edit=edit,
                soft_edges=soft_edges,
            )
            if progress is not None:
                progress(1.0)
        if object_rotate_deg:
            picture = replace(picture, normal=rotate_about_z(picture.normal, object_rotate_deg))
        if background == "transparent":
            return picture
        behind = _background(background, turned, camera.rays()[1]).reshape(picture.rgb.shape)
        return replace(
            picture,
            rgb=picture.coverage * picture.rgb + (1.0 - picture.coverage) * behind,
            standard_error=picture.coverage * picture.standard_error,
            opacity=np.ones_like(picture.coverage),
        )

    def baked(self) -> "BakedRenderer":
        """Return what renders `preview` and `baked`; raises UnsupportedQuality without baked transport."""
        # Compiled code takes a second to import, which refined relighting through graphs does not pay.
        from lambent_relight.baked.renderer import BakedRenderer

        if self._baked is None:
            self._baked = BakedRenderer(self.bundle, self.caches, kept_pixels=self._kept_rays * 2 // 3)
        return self._baked

    def _scene(self, environment: Environment, edit: MaterialEdit, sampling: Sampling) -> tuple[Scene, str]:
        """Return what refined pictures see, and where their bounced light comes from.

        Raises SettingError where that was asked for by name and is not there.
        """
        plain = Scene(self.caches, self.bundle.manifest.secondary_rays.origin_offset, edit)
        if not sampling.indirect:
            return plain, ""
        if sampling.bounces in ("auto", "adapted"):
            insists = sampling.bounces == "adapted"
            chosen = choose(self.bundle, environment, edit, although_worse=insists)
            if chosen.light is not None:
                adapted = functools.partial(self._networks.adapted, chosen.light.name)
                return replace(plain, adapted=adapted), f"adapted:{chosen.light.name}"
            if insists:
                found = chosen.why_not or "the bundle has no adapted caches"
                advice = "run lambent bake-light for this light, or leave the bounces to auto"
                raise SettingError("relight.light_not_adapted", found, advice)
            if chosen.why_not and chosen.why_not != self._told:
                _LOG.warning("no adapted fast cache fits this picture: %s", chosen.why_not)
                self._told = chosen.why_not
        if sampling.bounces == "one":
            return plain, "one"
        if self.bundle.manifest.HasField("transport"):
            return replace(plain, hits=self.baked().hits(environment, edit)), "transport"
        if sampling.bounces == "transport":
            self.baked()
        return plain, "one"

    def _refined(
        self,
        camera: Camera,
        environment: Environment,
        edit: MaterialEdit,
        sampling: Sampling,
        progress: Callable[[float], None] | None,
    ) -> RelitPicture:
        light = self._prepared(environment)
        view = self.view(camera, sampling.antialias)
        seen = view.hits
        albedo, roughness = edit.apply(seen.albedo, seen.perceptual_roughness)
        points = SurfacePoints(
            view.origin + seen.distance * view.direction,
            seen.normal,
            -view.direction,
            materials_from_roughness(albedo, roughness, seen.metalness),
        )
        scene, bounces = self._scene(environment, edit, sampling)
        radiance = estimated(points, scene, light, sampling, progress)
        coverage = view.coverage()
        direct, bounced = view.mean(radiance.direct), view.mean(radiance.indirect)
        specular = view.mean(radiance.specular)
        return RelitPicture(
            rgb=direct + bounced,
            opacity=coverage,
            standard_error=view.error_of_mean(radiance.standard_error),
            direct=direct,
            indirect=bounced,
            diffuse=direct + bounced - specular,
            specular=specular,
            visibility=view.mean(radiance.visibility[:, :1]),
            albedo=view.mean(albedo),
            normal=normalise(view.mean(seen.normal)),
            perceptual_roughness=view.mean(roughness),
            metalness=view.mean(seen.metalness),
            distance=view.mean(seen.distance),
            coverage=coverage,
            num_samples=radiance.num_samples * sampling.antialias**2,
            bounces=bounces,
        )


def _open_caches(
    bundle: Bundle, num_threads: int | None, reader: Reader
) -> "NoCaches | OnnxCaches | FusedCaches":
    if not bundle.has_networks:
        return NoCaches()
    if reader == "onnx":
        return OnnxCaches(bundle, num_threads=num_threads)
    # Compiled code takes a second to import, which programs that only look at bundles do not pay.
    from lambent_relight.fused.reader import FusedCaches, NotFused

    try:
        return FusedCaches(bundle, num_threads=num_threads)
    except NotFused as reason:
        if reader == "fused":
            raise SettingError(
                "relight.reader", f"the fused reader cannot read this bundle ({reason})", 'use "onnx"'
            ) from reason
        _LOG.warning("relighting through onnxruntime, which is slower: %s", reason)
        return OnnxCaches(bundle, num_threads=num_threads)


def _combined(bundle: Bundle, edit: MaterialEdit, ratio: NDArray[np.floating] | None) -> MaterialEdit:
    """Return `edit` with its gain times the albedo ratio, by default the manifest's."""
    values = np.asarray(bundle.manifest.albedo_scale_rgb if ratio is None else ratio, np.float64)
    if values.shape not in ((), (1,), (3,)):
        raise SettingError(
            "relight.albedo_ratio", f"albedo ratio {ratio}", "give one or three positive numbers"
        )
    gain = np.broadcast_to(values, (3,)) * np.asarray(edit.albedo_gain)
    return replace(edit, albedo_gain=tuple(float(value) for value in gain))


def _turned_camera(camera: Camera, degrees: float) -> Camera:
    """Return `camera` carried around the z axis by +`degrees`."""
    angle = np.radians(degrees)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return replace(camera, camera_to_world=turn @ camera.camera_to_world)


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
    edit: MaterialEdit | None = None,
    object_rotate_deg: float = 0.0,
    until_stderr: float = 0.0,
    bounces: Bounces = "auto",
    progress: Callable[[float], None] | None = None,
) -> RelitPicture:
    """Return the bundle's object as `camera` sees it in the light of `environment`.

    `rotate_deg` turns the light by that angle about +z. `num_samples` light directions are spent on every
    covered pixel, shared by `antialias` x `antialias` rays (two directions each at least); `indirect` adds
    light that was reflected once before. `albedo_ratio` (one or three factors on the stored albedo, result
    clipped to [0, 1]) defaults to the manifest's `albedo_scale_rgb`. `background` is "transparent",
    "environment" or a linear colour. `edit` changes the material, `object_rotate_deg` turns the object, not
    its light, about +z. `quality` is "refined" (Monte Carlo), or "baked" or "preview" (from baked transport,
    without noise; `num_samples` and `seed` have no effect). With `until_stderr` above 0, refined pictures go
    on, `num_samples` at a time and up to 64 times, until their mean standard error is that share of their
    mean radiance. `bounces` "auto" asks a fast cache that was adapted to this very light and material where
    the bundle has one that was not found worse than baked transport, and else shades what refined rays hit
    from baked transport where there is some, all bounces included; "one" traces on once; "adapted" and
    "transport" insist. The picture's `bounces` says what it was. `progress` is called with the finished
    fraction. Equal seeds give equal pictures.

    Opens the bundle's graphs anew: to render many pictures, make one `Renderer`. Raises SettingError,
    UnsupportedQuality (no such quality, or no baked transport) or BundleError.
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
        edit=edit,
        object_rotate_deg=object_rotate_deg,
        until_stderr=until_stderr,
        bounces=bounces,
        progress=progress,
    )

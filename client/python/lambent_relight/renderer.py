"""Relit pictures from a bundle: the entry point.

picture = render(load_bundle("cow.relight"), camera, load_environment("sky.exr"), rotate_deg=90)
"""

import functools
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack, get_args

import numpy as np
from lambent_core.directions import normalise, rotate_about_z
from lambent_core.errors import SettingError
from lambent_core.pictures import RenderSettings
from numpy.typing import ArrayLike, NDArray

from lambent_relight.arguments import array, colour, instance, number, refusal, whole
from lambent_relight.baked.traced_surface import MeshSurroundings
from lambent_relight.brdf import materials_from_roughness
from lambent_relight.bundle.adapted import choose
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import NoCaches, OnnxCaches, SurfaceCaches
from lambent_relight.cameras import Camera
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import Environment, as_environment
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.denoising import denoised
from lambent_relight.refined.passes import Light, Scene
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.sampling_plan import estimated
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.surroundings import CacheSurroundings
from lambent_relight.settings import BACKGROUNDS, Changes, Colour, settled
from lambent_relight.views import View, look

if TYPE_CHECKING:
    from lambent_relight.baked.renderer import BakedRenderer
    from lambent_relight.baked.surface_detail import SurfaceDetail
    from lambent_relight.fused.reader import FusedCaches

Background = str | Colour
"""A name as in the settings, or a linear colour."""
Reader = Literal["auto", "fused", "onnx"]

_LOG = logging.getLogger("lambent_relight")
KEPT_RAYS = 3_000_000
"""Camera rays that are remembered by default; about 70 bytes each."""


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
        self.bundle = instance(bundle, Bundle, "bundle", "open it with load_bundle(path)")
        if reader not in get_args(Reader):
            raise SettingError(
                "relight.reader", f"reader {reader!r}", f"use one of {', '.join(get_args(Reader))}"
            )
        num_threads = None if num_threads is None else whole(num_threads, "num_threads", 1)
        self._kept_rays = whole(kept_rays, "kept_rays", 0)
        self._networks = _open_caches(bundle, num_threads, reader)
        self.caches: SurfaceCaches = self._networks
        self._told = ""
        self._views: dict[tuple[bytes, int], View] = {}
        self._light: tuple[Environment, Light] | None = None
        self._baked: BakedRenderer | None = None

    def __repr__(self) -> str:
        """Return the bundle and what reads its networks in one line."""
        return f"Renderer({self.bundle!r}, reader {self.caches.name!r})"

    def view(self, camera: Camera, antialias: int) -> View:
        """Return what `camera` sees; the last few cameras are remembered."""
        key = (camera.key(), antialias)
        if key not in self._views:
            view = self._textured(look(self.caches, camera, antialias), antialias)
            while (
                self._views
                and sum(v.num_rays for v in self._views.values()) + view.num_rays > self._kept_rays
            ):
                self._views.pop(next(iter(self._views)))
            self._views[key] = view
        return self._views[key]

    def _textured(self, view: View, antialias: int) -> View:
        """Return a view with the detail of the mesh's textures, where the bundle has it."""
        if self._detail is None:
            return view
        return replace(view, hits=self._detail.applied(view.hits, view.camera.finer(antialias), view.ray))

    @functools.cached_property
    def _detail(self) -> "SurfaceDetail | None":
        """The detail of the textures over the model's albedo, which baked transport has."""
        manifest = self.bundle.manifest
        if not (manifest.HasField("transport") and manifest.atlas.albedo_source == "photographs"):
            return None
        # Compiled code takes a second to import, which other bundles do not pay.
        from lambent_relight.baked.surface_detail import SurfaceDetail

        return SurfaceDetail.of(self.baked().scene)

    def _prepared(self, environment: Environment) -> Light:
        if self._light is None or self._light[0] is not environment:
            self._light = (environment, Light(environment, LightSampler(environment)))
        return self._light[1]

    def render(
        self,
        camera: Camera,
        environment: Environment | NDArray[np.floating] | Path | str,
        settings: RenderSettings | None = None,
        *,
        rotate_deg: float = 0.0,
        object_rotate_deg: float = 0.0,
        edit: MaterialEdit | None = None,
        progress: Callable[[float], None] | None = None,
        **changes: Unpack[Changes],
    ) -> RelitPicture:
        """Return the bundle's object as `camera` sees it in the light of `environment`, linear.

        The environment may also be an array [height, width, 3] of linear radiance, or the path of a map; for
        many pictures in one light make it once. `changes` go over `settings`, such as `quality="baked"` or
        `spp=256`. `rotate_deg` turns the light about +z, `object_rotate_deg` the object, not its light.
        `edit` changes the material. `progress` is called with the finished fraction.

        Refined pictures spend `spp` light directions on every covered pixel, shared by its rays (two each at
        least); with `until_stderr` up to 64 times as many, where they help. `bounces` says where bounced
        light came from. Equal seeds give equal pictures. Raises SettingError, UnsupportedQuality (no such
        quality, or no baked transport) or BundleError.
        """
        instance(camera, Camera, "camera", "use turntable, load_cameras or Bundle.cameras")
        environment = as_environment(environment)
        rotate_deg = number(rotate_deg, "rotate_deg")
        object_rotate_deg = number(object_rotate_deg, "object_rotate_deg")
        if settings is not None:
            instance(settings, RenderSettings, "settings", "give RenderSettings, or its fields by name")
        if edit is not None:
            instance(edit, MaterialEdit, "edit", "give MaterialEdit(albedo_gain=..., roughness_scale=...)")
        if progress is not None and not callable(progress):
            raise SettingError(
                "relight.argument", "progress is not a function", "give one of the fraction done"
            )
        soft_edges, ratio = changes.pop("soft_edges", True), changes.pop("albedo_ratio", None)
        behind = changes.pop("background", None)
        if isinstance(behind, str):
            changes["background"] = behind
        settings = settled(settings, **changes)
        behind = settings.background if behind is None else behind
        edit = _combined(self.bundle, edit or MaterialEdit(), ratio)
        seen_from, turned = _turned(camera, environment, rotate_deg, object_rotate_deg)
        if settings.quality == "refined":
            picture = self._refined(seen_from, turned, edit, settings, progress)
            if settings.denoise:
                picture = denoised(picture)
        else:
            picture = self.baked().render(
                seen_from,
                turned,
                preview=settings.quality == "preview",
                antialias=settings.antialias,
                indirect=settings.indirect,
                edit=edit,
                soft_edges=soft_edges,
            )
            if progress is not None:
                progress(1.0)
        if object_rotate_deg:
            picture = replace(picture, normal=rotate_about_z(picture.normal, object_rotate_deg))
        return with_background(picture, behind, camera, environment, rotate_deg, object_rotate_deg)

    def baked(self) -> "BakedRenderer":
        """Return what renders `preview` and `baked`; raises UnsupportedQuality without baked transport."""
        # Compiled code takes a second to import, which refined relighting through graphs does not pay.
        from lambent_relight.baked.renderer import BYTES_PER_RAY, BakedRenderer

        if self._baked is None:
            self._baked = BakedRenderer(self.bundle, self.caches, kept_bytes=self._kept_rays * BYTES_PER_RAY)
        return self._baked

    def _tell(self, what: str) -> None:
        """Warn of something once, however many pictures it is true of."""
        if what != self._told:
            _LOG.warning(what)
            self._told = what

    def _scene(
        self, environment: Environment, edit: MaterialEdit, settings: RenderSettings
    ) -> tuple[Scene, str]:
        """Return what refined pictures see, and where their bounced light comes from.

        Raises SettingError where that was asked for by name and is not there.
        """
        networks, caches, num_threads = self._networks, self.caches, 1
        if caches is networks and not isinstance(networks, NoCaches | OnnxCaches):
            # Compiled code is called by the threads that do everything else; onnxruntime has its own.
            num_threads, networks = networks.num_threads, networks.in_callers_thread()
            caches = networks
        has_transport = self.bundle.manifest.HasField("transport")
        offset = self.bundle.manifest.secondary_rays.origin_offset
        if settings.occlusion == "mesh" or (settings.occlusion == "auto" and has_transport):
            around: MeshSurroundings | CacheSurroundings = MeshSurroundings(self.baked().traced, edit)
        else:
            around = CacheSurroundings(caches, offset, edit)
        light = self._prepared(environment)
        plain = Scene(around, light, num_threads=num_threads, indirect=settings.indirect)
        bounces = settings.bounces
        if bounces.isdecimal():
            return replace(plain, most_bounces=int(bounces)), bounces if settings.indirect else ""
        if not settings.indirect:
            return plain, ""
        if bounces in ("auto", "adapted"):
            insists = bounces == "adapted"
            cache, why_not = choose(self.bundle, environment, edit, although_worse=insists)
            if cache is not None:
                # The adapted cache's opacities belong to its radiance, and to its own start of rays.
                around = CacheSurroundings(caches, offset, edit)
                adapted = functools.partial(networks.adapted, cache.name)
                if settings.occlusion == "mesh":
                    says = f'the fast cache adapted to "{cache.name}" says what is in the way of its light'
                    self._tell(
                        f'occlusion="mesh" has no effect: {says}; bounces="transport" leaves that to the mesh'
                    )
                return replace(plain, around=around, adapted=adapted), f"adapted:{cache.name}"
            if insists:
                reason = why_not or "the bundle has no adapted caches"
                advice = "run lambent bake-light for this light, or leave the bounces to auto"
                raise SettingError("relight.light_not_adapted", reason, advice)
            if why_not:
                self._tell(f"no adapted fast cache fits this picture: {why_not}")
        if bounces == "one" or (not has_transport and bounces not in ("baked", "transport")):
            return replace(plain, most_bounces=2), "one"
        hits = self.baked().hits(environment, edit)
        # The cache's occlusion is not that of the bake, so there it is taken only where it is asked for.
        if isinstance(around, MeshSurroundings):
            around, as_baked = replace(around, texels=hits.at_texels), bounces != "transport"
        else:
            around, as_baked = replace(around, hits=hits), bounces == "baked"
        return replace(plain, around=around), "baked" if as_baked else "transport"

    def _refined(
        self,
        camera: Camera,
        environment: Environment,
        edit: MaterialEdit,
        settings: RenderSettings,
        progress: Callable[[float], None] | None,
    ) -> RelitPicture:
        view = self.view(camera, settings.antialias)
        seen = view.hits
        albedo, roughness = edit.apply(seen.albedo, seen.perceptual_roughness)
        scene, bounces = self._scene(environment, edit, settings)
        position, settled = view.origin + seen.distance * view.direction, None
        if isinstance(scene.around, MeshSurroundings) or bounces == "baked":
            settled = self.baked().traced.settled(view.origin, view.direction, seen.distance)
            position = settled.position
        materials = materials_from_roughness(albedo, roughness, seen.metalness)
        points = SurfacePoints(position, seen.normal, -view.direction, materials)
        pixels = PixelRays.of(view.pixel, seen.opacity)
        known = None
        if settled is not None:
            hits = self.baked().hits(environment, edit) if bounces == "baked" else None
            sky = environment if isinstance(scene.around, MeshSurroundings) else None
            known = self.baked().known_light(points, settled, hits=hits, sky=sky)
        radiance = estimated(points, pixels, scene, settings, progress, known)
        coverage, distance = view.coverage(), view.mean(seen.distance)
        direct, bounced, specular = map(view.mean, (radiance.direct, radiance.indirect, radiance.specular))
        return RelitPicture(
            rgb=direct + bounced,
            opacity=coverage,
            standard_error=view.picture(radiance.standard_error),
            direct=direct,
            indirect=bounced,
            diffuse=direct + bounced - specular,
            specular=specular,
            visibility=np.clip(view.mean(radiance.visibility[:, :1]), 0.0, 1.0),
            albedo=view.mean(albedo),
            normal=normalise(view.mean(seen.normal)),
            perceptual_roughness=view.mean(roughness),
            metalness=view.mean(seen.metalness),
            distance=distance,
            depth=camera.depth_along_axis(distance),
            coverage=coverage,
            num_samples=radiance.mean_samples * settings.antialias**2,
            bounces=bounces,
            camera_attributes=camera.exr_attributes(),
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


def _combined(bundle: Bundle, edit: MaterialEdit, ratio: ArrayLike | None) -> MaterialEdit:
    """Return `edit` with its gain times the albedo ratio, by default the manifest's."""
    refuse = refusal("relight.albedo_ratio")
    stated = tuple(bundle.manifest.albedo_scale_rgb)
    factors = stated if ratio is None else colour(ratio, "albedo_ratio", refuse=refuse)
    red, green, blue = np.multiply(factors, edit.albedo_gain).tolist()
    return replace(edit, albedo_gain=(red, green, blue))


def _turned(
    camera: Camera, environment: Environment, rotate_deg: float, object_rotate_deg: float
) -> tuple[Camera, Environment]:
    """Return camera and light as the object sees them: turning it turns everything else the other way."""
    turned = environment.rotated(rotate_deg) if rotate_deg else environment
    if not object_rotate_deg:
        return camera, turned
    angle = np.radians(-object_rotate_deg)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    around = replace(camera, camera_to_world=turn @ camera.camera_to_world)
    return around, turned.rotated(-object_rotate_deg)


def with_background(
    picture: RelitPicture,
    background: Background,
    camera: Camera,
    environment: Environment,
    rotate_deg: float = 0.0,
    object_rotate_deg: float = 0.0,
) -> RelitPicture:
    """Return a transparent `picture` before a background; the other arguments are those it was made with."""
    behind = BACKGROUNDS.get(background, background) if isinstance(background, str) else background
    if behind == "transparent":
        return picture
    seen_from, turned = _turned(camera, environment, rotate_deg, object_rotate_deg)
    if behind == "environment":
        back = turned.lookup(seen_from.rays()[1]).reshape(picture.rgb.shape)
    else:
        refuse = refusal("relight.background")
        advice = f"use one of {', '.join(BACKGROUNDS)}, or three linear values"
        if isinstance(behind, str):
            raise refuse(f"background {background!r}", advice)
        back = array(behind, (3,), "background", refuse=refuse).astype(np.float32)
        if (back < 0.0).any():
            raise refuse(f"background {background!r}", advice)
    return replace(
        picture,
        rgb=picture.coverage * picture.rgb + (1.0 - picture.coverage) * back,
        standard_error=picture.coverage * picture.standard_error,
        opacity=np.ones_like(picture.coverage),
    )


def render(
    bundle: Bundle,
    camera: Camera,
    environment: Environment | NDArray[np.floating] | Path | str,
    settings: RenderSettings | None = None,
    **given: Any,
) -> RelitPicture:
    """Return the bundle's object as `camera` sees it; `given` and what is raised as in `Renderer.render`.

    Opens the bundle's graphs anew: to render many pictures, make one `Renderer`.
    """
    return Renderer(bundle).render(camera, environment, settings, **given)

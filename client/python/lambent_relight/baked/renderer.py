"""Renders the qualities `preview` and `baked`; views and lights are cached between pictures."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from lambent_core.directions import normalise
from numpy.typing import NDArray

from lambent_relight.baked.edges import with_soft_edges
from lambent_relight.baked.hits import BakedHits, HitFinder
from lambent_relight.baked.light import MAX_DOMINANT, BakedLight, LitTexels, lit_texels, prepare_light
from lambent_relight.baked.scene import load_baked_scene
from lambent_relight.baked.shading import Lobes, lobes_of, shade
from lambent_relight.baked.shadow_maps import ShadowMap, shadow_map
from lambent_relight.baked.surface_bounce import SurfaceBlocks
from lambent_relight.baked.traced_surface import Settled, TracedSurface
from lambent_relight.baked.transport import shadow_directions
from lambent_relight.baked.view import BakedView, look_at_surface
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import NoCaches, SurfaceCaches
from lambent_relight.cameras import Camera
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.maps import Environment
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.known_light import KnownLight
from lambent_relight.refined.known_sky import KnownSky, SkyCells
from lambent_relight.refined.scattering import SurfacePoints

KEPT_BYTES = 768_000_000
"""Maximum memory of cached views: 200 bytes a pixel with one fragment each, 800 with 4 x 4."""
BYTES_PER_RAY = 256
"""Part of it for each camera ray whose refined view may be remembered."""
_KEPT_SHADOWS = 3 * MAX_DOMINANT
"""Number of cached shadow maps, 4 MB each."""
_KEPT_LIGHTS = 3
"""Number of cached environments, enough to compare two side by side."""


class BakedRenderer:
    """Renders from baked transport; with view and light cached, a picture costs a matrix product."""

    def __init__(self, bundle: Bundle, caches: SurfaceCaches, *, kept_bytes: int = KEPT_BYTES) -> None:
        """Read the transport of `bundle`; raises UnsupportedQuality when it has none.

        `kept_bytes` bounds the memory of the views that are remembered; the last one always is.
        """
        self._kept_bytes = kept_bytes
        self.scene = load_baked_scene(bundle)
        self._caches = caches
        self._views: dict[tuple[bytes, int, bool], BakedView] = {}
        self._known: _Prepared | None = None
        self._cells: tuple[Environment, SkyCells] | None = None
        self._shadows: dict[tuple[bytes, float], ShadowMap] = {}
        self._lights: list[tuple[Environment, int, BakedLight]] = []

    def view(self, camera: Camera, antialias: int, *, soft_edges: bool) -> BakedView:
        """Return the view of `camera`; the last few cameras are cached."""
        # Without networks the edges are the mesh's.
        soft_edges = soft_edges and not isinstance(self._caches, NoCaches)
        key = (camera.key(), antialias, soft_edges)
        if key not in self._views:
            view = look_at_surface(self.scene, camera, antialias, apart=not soft_edges)
            if soft_edges:
                view = with_soft_edges(view, self._caches, antialias)
            while (
                self._views
                and sum(each.size_bytes for each in self._views.values()) + view.size_bytes > self._kept_bytes
            ):
                self._views.pop(next(iter(self._views)))
            self._views[key] = view
        return self._views[key]

    def light(self, environment: Environment, dominant_lights: int) -> BakedLight:
        """Return `environment` prepared for rendering; the last few are cached, whatever their rotation."""
        same = [light for light in self._lights if light[0].radiance is environment.radiance]
        known = next((light for light in same if light[1] == dominant_lights), None)
        if known is None:
            bands = round(len(self.scene.transport.direct) ** 0.5)
            # Levels do not depend on the lights that are split off.
            turns = ((light, environment.rotate_deg - other.rotate_deg) for other, _, light in same)
            levels = next((light.prefiltered.rotated(turn) for light, turn in turns), None)
            light = prepare_light(environment, bands, dominant_lights, levels)
            known = (environment, dominant_lights, light)
            self._lights = [*self._lights[1 - _KEPT_LIGHTS :], known]
        turn = environment.rotate_deg - known[0].rotate_deg
        return known[2].rotated(turn) if turn else known[2]

    @cached_property
    def traced(self) -> TracedSurface:
        """The mesh, prepared for rays when first needed."""
        return TracedSurface(self.scene)

    @cached_property
    def _finder(self) -> HitFinder:
        return HitFinder(self.scene)

    @cached_property
    def _blocks(self) -> SurfaceBlocks:
        return SurfaceBlocks(self.scene)

    def hits(self, environment: Environment, edit: MaterialEdit) -> BakedHits:
        """Return the radiance of hit points in refined relighting under `environment`."""
        can_split = self.scene.transport.shadow_bits is not None
        light = self.light(environment, MAX_DOMINANT if can_split else 0)
        return BakedHits(self._finder, light, edit)

    def known_light(
        self,
        points: SurfacePoints,
        settled: Settled,
        *,
        hits: BakedHits | None,
        sky: Environment | None,
    ) -> KnownLight:
        """Return what `points` reflect diffusely of the light that was baked around them.

        `settled` says where the points are on the mesh; `hits` has the light of other surfaces and `sky` that
        of the environment, where they are to be known.
        """
        materials = points.materials
        reflected = (1.0 - materials.metalness) * materials.albedo / np.float32(np.pi)
        light = KnownLight.nothing(len(points.position))
        if hits is not None:
            around = self._blocks.around(points.position, points.normal, settled.uv)
            known = around.known & settled.near[:, None]
            radiance = np.where(known, reflected * around.mean(hits.indirect), np.float32(0.0))
            light = KnownLight(radiance.astype(np.float32), known[:, 0])
        bits = self.scene.transport.shadow_bits
        if sky is None or bits is None:
            return light
        if self._cells is None or self._cells[0] is not sky:
            self._cells = (sky, SkyCells.of(sky, shadow_directions()))
        # Bits of any texel will do: where they are wrong they only make noise.
        bits = bits[self.scene.texels_at(settled.uv)]
        return replace(light, sky=KnownSky.of(self._cells[1], bits, points.normal, reflected))

    def render(
        self,
        camera: Camera,
        environment: Environment,
        *,
        preview: bool,
        antialias: int,
        indirect: bool,
        edit: MaterialEdit,
        soft_edges: bool = True,
    ) -> RelitPicture:
        """Return the object as `camera` sees it, without background.

        Without `soft_edges` the mesh decides what is covered, which makes a new view many times faster; so
        it does in a `preview`.
        """
        view = self.view(camera, antialias, soft_edges=soft_edges and not preview)
        light = self.light(environment, 0 if preview else MAX_DOMINANT)
        known = self._prepared(view, edit, preview=preview)
        lit: dict[str, Any] = shade(
            view,
            known.lit,
            known.lobes,
            light,
            [self._shadow_map(*each) for each in zip(light.directions, light.radii_rad, strict=True)],
            preview=preview,
            indirect=indirect,
            bounce_gain=edit.bounce_gain(self.scene.mean_albedo),
        )
        return replace(known.still, **lit)

    def _shadow_map(self, direction: NDArray[np.float32], radius_rad: float) -> ShadowMap:
        """Return the shadows of a dominant light; the last few are cached."""
        key = (direction.tobytes(), float(radius_rad))
        if key not in self._shadows:
            while len(self._shadows) >= _KEPT_SHADOWS:
                self._shadows.pop(next(iter(self._shadows)))
            self._shadows[key] = shadow_map(self.scene.mesh, direction, float(radius_rad))
        return self._shadows[key]

    def _prepared(self, view: BakedView, edit: MaterialEdit, *, preview: bool) -> "_Prepared":
        """Return the materials and texels of a view; cached for the last view and edit."""
        known = self._known
        if known is None or known.view is not view or known.edit != edit or known.preview != preview:
            lobes = lobes_of(view, edit, preview=preview)
            same = known is not None and known.view is view
            lit = known.lit if same and known is not None else lit_texels(self.scene, view.used)
            known = _Prepared(view, edit, preview, lit, lobes, _still(view, lobes))
            self._known = known
        return known


@dataclass(frozen=True, eq=False)
class _Prepared:
    view: BakedView
    edit: MaterialEdit
    preview: bool
    lit: LitTexels
    lobes: Lobes
    still: RelitPicture
    """Everything in a picture that does not depend on the light; arrays are shared between pictures."""


def _still(view: BakedView, lobes: Lobes) -> RelitPicture:
    black = np.zeros((view.camera.height, view.camera.width, 3), np.float32)
    coverage, distance = view.image(view.coverage), view.image(view.distance)
    still = RelitPicture(
        rgb=black,
        opacity=coverage,
        standard_error=black,
        direct=black,
        indirect=black,
        diffuse=black,
        specular=black,
        visibility=np.clip(view.image(view.openness), 0.0, 1.0),
        albedo=view.image(lobes.albedo),
        normal=normalise(view.image(view.normal)),
        perceptual_roughness=view.image(lobes.perceptual_roughness),
        metalness=view.image(view.metalness),
        distance=distance,
        depth=view.camera.depth_along_axis(distance),
        coverage=coverage,
        num_samples=0,
        camera_attributes=view.camera.exr_attributes(),
    )
    for image in vars(still).values():
        if isinstance(image, np.ndarray):
            image.flags.writeable = False
    return still

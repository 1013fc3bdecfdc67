"""Pictures of the qualities `preview` and `baked`; views and the light are remembered between pictures."""

import numpy as np

from lambent_relight.baked import Lobes, lobes_of, shade
from lambent_relight.baked_edges import with_soft_edges
from lambent_relight.baked_hits import BakedHits, HitFinder
from lambent_relight.baked_light import MAX_DOMINANT, BakedLight, prepare_light
from lambent_relight.baked_scene import load_baked_scene
from lambent_relight.baked_view import BakedView, look_at_surface
from lambent_relight.bundle import Bundle
from lambent_relight.cameras import Camera
from lambent_relight.edits import MaterialEdit
from lambent_relight.environments import Environment
from lambent_relight.graphs import SurfaceCaches
from lambent_relight.picture import RelitPicture

QUALITIES = ("preview", "baked")
_KEPT_PIXELS = 2_000_000
"""Pixels of views that are remembered; about 400 bytes each."""


class BakedRenderer:
    """Renders from baked transport. A known view in a known light, turned or not, costs a matrix product."""

    def __init__(self, bundle: Bundle, caches: SurfaceCaches) -> None:
        """Read the transport of `bundle`; raises UnsupportedQuality when it has none."""
        self.scene = load_baked_scene(bundle)
        self._caches = caches
        self._views: dict[tuple[bytes, int, bool], BakedView] = {}
        self._lobes: tuple[object, Lobes] | None = None
        self._finder: HitFinder | None = None
        self._light: tuple[Environment, int, BakedLight] | None = None

    def view(self, camera: Camera, antialias: int, *, soft_edges: bool) -> BakedView:
        """Return what `camera` sees; the last few cameras are remembered."""
        key = (camera.key(), antialias, soft_edges)
        if key not in self._views:
            view = look_at_surface(self.scene, camera, antialias)
            if soft_edges:
                view = with_soft_edges(view, self._caches, antialias)
            while (
                self._views
                and sum(v.num_pixels for v in self._views.values()) + view.num_pixels > _KEPT_PIXELS
            ):
                self._views.pop(next(iter(self._views)))
            self._views[key] = view
        return self._views[key]

    def light(self, environment: Environment, dominant_lights: int) -> BakedLight:
        """Return `environment` prepared; turning a known one only turns what was prepared."""
        known = self._light
        if known is None or known[0].radiance is not environment.radiance or known[1] != dominant_lights:
            bands = round(len(self.scene.transport.direct) ** 0.5)
            known = (environment, dominant_lights, prepare_light(environment, bands, dominant_lights))
            self._light = known
        turn = environment.rotate_deg - known[0].rotate_deg
        return known[2].rotated(turn) if turn else known[2]

    def hits(self, environment: Environment, edit: MaterialEdit) -> BakedHits:
        """Return what hit points of refined relighting send back under `environment`."""
        if self._finder is None:
            self._finder = HitFinder(self.scene)
        can_split = self.scene.transport.shadow_bits is not None
        light = self.light(environment, MAX_DOMINANT if can_split else 0)
        return BakedHits(self._finder, light, edit)

    def render(
        self,
        camera: Camera,
        environment: Environment,
        *,
        preview: bool,
        antialias: int,
        indirect: bool,
        edit: MaterialEdit,
        compiled: bool = True,
    ) -> RelitPicture:
        """Return the object as `camera` sees it, without background.

        `compiled` False keeps to numpy where there is a choice; results differ by rounding only.
        """
        view = self.view(camera, antialias, soft_edges=not preview)
        can_split = self.scene.transport.shadow_bits is not None and not preview
        light = self.light(environment, MAX_DOMINANT if can_split else 0)
        lobes = self._lobes_of(view, edit, preview=preview)
        found = shade(
            self.scene,
            view,
            lobes,
            light,
            preview=preview,
            indirect=indirect,
            bounce_gain=edit.bounce_gain(self.scene.albedo.mean(axis=0)),
            compiled=compiled,
        )
        direct = found.diffuse_direct + found.specular_direct
        bounced = found.diffuse_indirect + found.specular_indirect
        rgb = view.image(direct + bounced)
        return RelitPicture(
            rgb=rgb,
            opacity=view.image(view.coverage),
            standard_error=np.zeros_like(rgb),
            direct=view.image(direct),
            indirect=view.image(bounced),
            diffuse=view.image(found.diffuse_direct + found.diffuse_indirect),
            specular=view.image(found.specular_direct + found.specular_indirect),
            visibility=view.image(view.openness),
            albedo=view.image(lobes.albedo),
            normal=view.image(view.normal),
            perceptual_roughness=view.image(lobes.perceptual_roughness),
            metalness=view.image(view.metalness),
            distance=view.image(view.distance),
            coverage=view.image(view.coverage),
            num_samples=0,
        )

    def _lobes_of(self, view: BakedView, edit: MaterialEdit, *, preview: bool) -> Lobes:
        key = (id(view), edit, preview)
        if self._lobes is None or self._lobes[0] != key:
            self._lobes = (key, lobes_of(view, edit, preview=preview))
        return self._lobes[1]

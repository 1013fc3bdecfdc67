"""The NeRF radiance cache: density, normals and outgoing radiance along sampled rays."""

from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.caches.fast_cache import CacheAnswer, FastCache, FastCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.encoding.occupancy import Occupancy
from flashcache.encoding.turns import LightTurns
from flashcache.errors import ConfigError
from flashcache.fields.appearance import Appearance, AppearanceConfig, AppearanceField
from flashcache.fields.density import (
    DensityConfig,
    DensityField,
    NormalConfig,
    NormalField,
    derived_normal,
)
from flashcache.fields.packing import Layers, arrays_of, packed_grid, packed_occupancy
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch, ray_query
from flashcache.kernels.cpu import over_rows
from flashcache.randomness import uniform
from flashcache.rows import Rows
from flashcache.volume.proposal_sampling import (
    PRIMARY_CURVE,
    SECONDARY_CURVE,
    DistanceCurve,
    RaySamples,
    SampleCounts,
    midpoints,
    sample_rays,
)
from flashcache.volume.quadrature import draw_points, render_weights

NEGLIGIBLE = 1e-7
"""Factor up to which a point's radiance is left out where its density is not known to torch anyway: less than
the rounding of what the others add up to."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NerfCacheConfig:
    """Sizes of the NeRF cache and its samples per ray."""

    proposals: tuple[DensityConfig, DensityConfig] = field(
        default_factory=lambda: (
            DensityConfig(grid=HashGridConfig(finest_resolution=512, num_features=1)),
            DensityConfig(grid=HashGridConfig(finest_resolution=1024, num_features=1)),
        )
    )
    density: DensityConfig = field(default_factory=DensityConfig)
    normals: NormalConfig = field(default_factory=NormalConfig)
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)
    reflected: FastCacheConfig = field(default_factory=FastCacheConfig)
    """Sizes of the network for reflected radiance in the appearance architecture `fast_like`."""
    primary_counts: SampleCounts = field(default_factory=SampleCounts)
    secondary_counts: SampleCounts = field(default_factory=SampleCounts)
    secondary_colours: int = 0
    """Points at which a secondary ray's radiance is evaluated, drawn by weight; 0 evaluates all."""
    secondary_sure_opacity: float = 0.0
    """Opacity from which the radiance of all drawn points of a secondary ray is evaluated. Of less opaque
    rays a share is, the quotient of the opacities, which counts for the others; 0: always all."""
    least_weight: float = 0.0
    """Render weight up to which a point on a camera ray is not evaluated and sends no radiance."""
    normal_floor: float = 4.0
    """Gradient of log density below which derived normals shrink [1/scene unit]."""
    exponent: float = 1.0
    """Exponent of the proposal weights on secondary rays and after training; the end of the annealing."""

    def __post_init__(self) -> None:
        if self.secondary_colours < 0:
            raise ConfigError(f"secondary_colours must not be negative, got {self.secondary_colours}")
        for name in ("least_weight", "secondary_sure_opacity"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ConfigError(f"{name} must lie in 0..1, got {getattr(self, name)}")


class Geometry(NamedTuple):
    """The sampled points of a batch of primary rays: N per ray, flattened where the axis is `points`."""

    samples: RaySamples
    weights: Float[Tensor, "rays samples"]
    hidden: Float[Tensor, "points width"]
    normal: Float[Tensor, "points 3"]
    derived: Float[Tensor, "some 3"] | None
    """Derived normals of the first rays only; None if they were not requested."""

    @property
    def opacity(self) -> Float[Tensor, " rays"]:
        """Sum of the render weights."""
        return self.weights.sum(dim=-1)


class Meeting(NamedTuple):
    """The points that secondary rays meet: `repeats` per ray, flattened where the axis is `points`."""

    opacity: Float[Tensor, " rays"]
    distance: Float[Tensor, " rays"]
    """Mean distance over the opaque part, the far end where nothing is hit."""
    positions: Float[Tensor, "points 3"]
    hidden: Float[Tensor, "points width"]
    factors: Float[Tensor, "rays repeats"]
    """Weight of each point's radiance in that of the ray (paper Eqs. 3 and 11)."""


class _Met(NamedTuple):
    """As `Meeting`, with distances in place of positions, which need not be known for all points."""

    opacity: Tensor
    distance: Tensor
    middles: Float[Tensor, "rays repeats"]
    """Distance of each point from the origin of its ray."""
    hidden: Tensor | None
    """None where compiled code sampled the rays, which keeps no features."""
    factors: Tensor


class NerfCache(nn.Module):
    """Two proposal densities, the final density with normals, and the appearance."""

    def __init__(
        self,
        config: NerfCacheConfig,
        contraction_radius: float,
        num_lights: int,
        secondary: tuple[float, float],
        turns: LightTurns | None = None,
        occupancy: Occupancy | None = None,
    ) -> None:
        """`secondary` is the near and the far distance of reflected rays, scene units.

        With `turns` a light index is the number of a turn of the one light. Outside of `occupancy` all
        densities are zero.
        """
        super().__init__()
        self.config = config
        self.occupancy = occupancy
        self.proposals = nn.ModuleList(
            DensityField(proposal, contraction_radius, occupancy) for proposal in config.proposals
        )
        self.density = DensityField(config.density, contraction_radius, occupancy)
        num_hidden = self.density.network.num_outputs
        self.normals = NormalField(config.normals, num_hidden, contraction_radius)
        reflected = None
        if config.appearance.architecture == "fast_like":
            reflected = FastCache(
                config.reflected,
                contraction_radius,
                num_lights,
                secondary,
                position_frequencies=4,
                origin_frequencies=4,
                colour_bias=-1.0,
                turns=turns,
            )
        self.appearance = AppearanceField(
            config.appearance, num_hidden, contraction_radius, num_lights, reflected, turns
        )

    def sample(
        self,
        rays: Rays,
        counts: SampleCounts,
        curve: DistanceCurve,
        *,
        exponent: float | Float[Tensor, ""],
        generator: torch.Generator | None,
    ) -> RaySamples:
        """Return the final intervals of `rays`; see `sample_rays`."""
        first, second = (cast(DensityField, field).density for field in self.proposals)
        return sample_rays(rays, (first, second), counts, curve, exponent=exponent, generator=generator)

    def trace(
        self,
        rays: Rays,
        *,
        exponent: float | Float[Tensor, ""] | None = None,
        generator: torch.Generator | None,
        num_derived: int = 0,
    ) -> Geometry:
        """Return the geometry that primary rays meet; by default with the exponent of the configuration.

        The first `num_derived` rays also get derived normals, which cost a Jacobian per point.
        """
        counts = self.config.primary_counts
        exponent = self.config.exponent if exponent is None else exponent
        rays = rays if self.occupancy is None else self.occupancy.narrowed(rays)
        samples = self.sample(rays, counts, PRIMARY_CURVE, exponent=exponent, generator=generator)
        points = samples.positions.reshape(-1, 3)
        split = num_derived * counts.final
        parts, derived = [], None
        if split:
            part, gradient = self.density.with_gradient(points[:split])
            parts.append(part)
            derived = derived_normal(gradient, self.config.normal_floor)
        if split < len(points):
            parts.append(self.density(points[split:]))
        density = torch.cat([part.density for part in parts]).reshape(len(rays), counts.final)
        hidden = torch.cat([part.hidden for part in parts])
        weights = render_weights(density, samples.distances)
        return Geometry(samples, weights, hidden, self.normals(points, hidden), derived)

    def outgoing(
        self,
        geometry: Geometry,
        directions: Float[Tensor, "rays 3"],
        light_index: Int[Tensor, " rays"],
        *,
        with_specular: bool = True,
    ) -> Appearance:
        """Return the radiance that all points of `geometry` send back along their rays.

        Those whose render weight is at most `least_weight` send none and cost nothing.
        """
        num_samples = geometry.weights.shape[-1]
        positions = geometry.samples.positions.reshape(-1, 3)
        rows = Rows.all(len(positions), positions.device)
        if self.config.least_weight:
            rows = Rows.where(geometry.weights.detach().reshape(-1) > self.config.least_weight)
        point = rows.of(torch.arange(len(positions), device=positions.device))
        ray = point.div(num_samples, rounding_mode="floor")
        appearance = self.appearance(
            rows.of(positions),
            rows.of(geometry.hidden),
            rows.of(geometry.normal),
            -directions[ray],
            light_index[ray],
            with_specular=with_specular,
        )
        nothing = torch.zeros_like(positions)
        return Appearance(*(rows.into(nothing, part) for part in appearance))

    def incident(
        self,
        rays: Rays,
        light_index: Int[Tensor, " rays"],
        generator: torch.Generator | None,
        *,
        jitter: bool = False,
    ) -> CacheAnswer:
        """Return near-field radiance (premultiplied, without environment), opacity and distance.

        With `secondary_colours` K > 0 radiance is evaluated at K points drawn by weight, which
        needs a generator and is unbiased; otherwise at all of them. `jitter` also moves the
        intervals at random, as the paper does in training. `distance` is the mean distance over the
        opaque part, the far end where nothing is hit.
        """
        if self.occupancy is None:
            return self._incident(rays, light_index, generator, jitter=jitter)
        narrow = self.occupancy.narrowed(rays)
        rows = Rows.where(narrow.far > narrow.near)
        met = narrow if rows.index is None else narrow.select(rows.index)
        answer = self._incident(met, rows.of(light_index), generator, jitter=jitter)
        opacity = rows.into(torch.zeros_like(rays.far), answer.opacity)
        distance = rows.into(rays.far, answer.distance)
        return CacheAnswer(
            rows.into(torch.zeros_like(rays.origins), answer.near_radiance),
            opacity,
            torch.where(opacity < 1e-3, rays.far, distance),
        )

    def _incident(
        self,
        rays: Rays,
        light_index: Int[Tensor, " rays"],
        generator: torch.Generator | None,
        *,
        jitter: bool,
    ) -> CacheAnswer:
        num_colours = self.config.secondary_colours if generator is not None else 0
        sure_from = self.config.secondary_sure_opacity if num_colours else 0.0
        met = self._meet(rays, num_colours, generator, jitter=jitter, sure_from=sure_from)
        repeats, num_points = met.factors.shape[-1], met.factors.numel()
        rows = Rows.all(num_points, met.factors.device)
        if met.hidden is None or sure_from:
            least = NEGLIGIBLE if met.hidden is None else 0.0
            rows = Rows.where(met.factors.detach().reshape(-1) > least)
        point = rows.of(torch.arange(num_points, device=met.factors.device))
        ray = point.div(repeats, rounding_mode="floor")
        directions = rays.directions[ray]
        positions = rays.origins[ray] + rows.of(met.middles.reshape(-1))[:, None] * directions
        hidden = self.density(positions).hidden if met.hidden is None else rows.of(met.hidden)
        normal = self.normals(positions, hidden)
        radiance = self.appearance(positions, hidden, normal, -directions, light_index[ray]).radiance
        sent = rows.of(met.factors.reshape(-1))[:, None] * radiance
        near = (
            rows.into(rays.origins.new_zeros(num_points, 3), sent).reshape(len(rays), repeats, 3).sum(dim=1)
        )
        return CacheAnswer(near, met.opacity, met.distance)

    def meet(
        self, rays: Rays, num_points: int, generator: torch.Generator | None, *, jitter: bool = False
    ) -> Meeting:
        """Return the points that secondary rays meet: all with their render weights, or some of them.

        `num_points` K > 0 draws K points per ray by weight, which needs a generator. `jitter` as in
        `incident`.
        """
        narrow = rays if self.occupancy is None else self.occupancy.narrowed(rays)
        met = self._meet(narrow, num_points, generator, jitter=jitter)
        positions = rays.at(met.middles).reshape(-1, 3)
        hidden = self.density(positions).hidden if met.hidden is None else met.hidden
        distance = torch.where(met.opacity < 1e-3, rays.far, met.distance)
        return Meeting(met.opacity, distance, positions, hidden, met.factors)

    def _meet(
        self,
        rays: Rays,
        num_points: int,
        generator: torch.Generator | None,
        *,
        jitter: bool,
        sure_from: float = 0.0,
    ) -> _Met:
        # Compiled code samples secondary rays where no gradients are recorded and intervals are not moved.
        if not jitter and dispatch.answers_compiled(rays.origins, rays.near, self.density.grid.table):
            (weights, middles), hidden = self._sample_compiled(rays), None
        else:
            counts, exponent = self.config.secondary_counts, self.config.exponent
            jittered = generator if jitter else None
            samples = self.sample(rays, counts, SECONDARY_CURVE, exponent=exponent, generator=jittered)
            middles = midpoints(samples.distances)
            density, hidden = self.density(samples.positions.reshape(-1, 3))
            weights = render_weights(density.reshape(middles.shape), samples.distances)
        opacity = weights.sum(dim=-1)
        distance = (weights * middles).sum(dim=-1) / opacity.clamp_min(1e-3)
        distance = torch.where(opacity < 1e-3, rays.far, distance)
        if not num_points:
            return _Met(opacity, distance, middles, hidden, weights)
        u = uniform((len(rays), num_points), generator, weights.device)
        draw = draw_points(weights, u, sure_from=sure_from)
        if hidden is not None:
            first = weights.shape[1] * torch.arange(len(rays), device=u.device)
            hidden = hidden[(draw.index + first[:, None]).reshape(-1)]
        return _Met(opacity, distance, middles.gather(-1, draw.index), hidden, draw.weight)

    def _sample_compiled(self, rays: Rays) -> tuple[Float[Tensor, "rays samples"], ...]:
        """Return render weights and middles of the final intervals of secondary rays, without jitter."""
        layers, counts = Layers(), self.config.secondary_counts
        fields = [cast(DensityField, field) for field in (*self.proposals, self.density)]
        settings = tuple(field.packed(layers) for field in fields)
        start, end = (SECONDARY_CURVE.ladder(limit) for limit in (rays.near, rays.far))
        weights, middles = torch.empty(2, len(rays), counts.final)
        over_rows(
            ray_query.sample,
            len(rays),
            ray_query.RAYS,
            *arrays_of(rays.origins, rays.directions, start, end - start),
            SECONDARY_CURVE.inverse_constants,
            (counts.first, counts.second, counts.final),
            np.float32(self.config.exponent),
            tuple(packed_grid(field.grid) for field in fields),
            layers.packed(),
            settings,
            *packed_occupancy(self.occupancy),
            layers.widest,
            *arrays_of(weights, middles),
        )
        return weights, middles

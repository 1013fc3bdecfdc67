"""Monte Carlo estimates of reflected radiance, and the control variate that makes them cheap.

Diffuse and specular reflection are two integrals with their own directions (the "halves"). Directions,
densities and weights carry no gradient; reflectance, cosine and radiance do (detached sampling).
"""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from flashcache.errors import ConfigError
from flashcache.fields.mlp import scale_gradient
from flashcache.physical.brdf import Materials
from flashcache.physical.incident import (
    Incident,
    LightSources,
    NearField,
    SecondaryRays,
)
from flashcache.physical.sampling import CosineLobe, GgxLobe, Strategy
from flashcache.physical.shading import DrawnDirections, Estimate, ShadingPoints


@dataclass(frozen=True, kw_only=True, slots=True)
class DirectionCounts:
    """How many directions per point each strategy draws in one estimate."""

    cosine: int
    """Cosine-weighted, diffuse half."""
    sampler: int
    """From the light sampler, diffuse half; cosine-weighted instead where there is no sampler."""
    specular: int
    """From the GGX lobe, specular half."""

    def __post_init__(self) -> None:
        if min(self.cosine, self.sampler, self.specular) < 0:
            raise ConfigError(f"direction counts must not be negative, got {self}")

    @property
    def total(self) -> int:
        """Return the number of secondary rays per point."""
        return self.cosine + self.sampler + self.specular

    @classmethod
    def split(cls, total: int) -> "DirectionCounts":
        """Return the paper's division of `total`: half specular, the rest shared by cosine and sampler."""
        if total % 4:
            raise ConfigError(
                f"the number of secondary rays must be a multiple of 4 (half diffuse, half of those from the "
                f"light sampler), got {total}; give cosine, sampler and specular counts for another division"
            )
        return cls(cosine=total // 4, sampler=total // 4, specular=total // 2)

    @classmethod
    def of_picture(cls, total: int) -> "DirectionCounts":
        """Return a point's directions in pictures: a quarter cosine, a quarter GGX, the rest by the light.

        Three at least.
        """
        quarter = max(1, total // 4)
        return cls(cosine=quarter, sampler=max(1, total - 2 * quarter), specular=quarter)

    def divided(self, parts: int) -> "DirectionCounts":
        """Return the directions of each of `parts` points that share these; no half is left without one.

        The total is divided exactly where it is a multiple of `parts` that gives each point two or more.
        """
        diffuse = self.cosine + self.sampler
        share = max(2, self.total // parts) if self.total else 0
        specular = min(max(1, round(share * self.specular / self.total)), share - 1) if share else 0
        cosine = -(-(share - specular) * self.cosine // diffuse) if diffuse else 0
        return DirectionCounts(cosine=cosine, sampler=share - specular - cosine, specular=specular)


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorConfig:
    """How incoming light is sampled at a surface point (supplement 2.3 and 2.7)."""

    fast: DirectionCounts = field(default_factory=lambda: DirectionCounts.split(64))
    """Directions that only the fast cache answers."""
    exact: DirectionCounts = field(default_factory=lambda: DirectionCounts.split(16))
    """Directions of the correction, which both caches answer; all directions without the control variate."""
    control_variate: Literal["on", "off", "fast_only"] = "on"
    """"off" uses the NeRF cache only. "fast_only" leaves the correction out and is biased; it traces exact
    directions in training only, for the fast cache and the light sampler to learn from."""
    sampler: Literal["vmf", "none"] = "vmf"
    stratified: bool = False
    """Spread the variates of a point evenly (unbiased, less noise); the paper draws them independently.

    Stated variances are those of independent variates, and with this an upper bound: 4 to 10 times the true
    ones where that was measured."""
    normal_gradient: float = 0.01
    """Factor on the gradient that reaches the shading normal."""
    through_cache: float = 0.0
    """Factor on the gradient into the caches; the paper's code has 1e-4; 0 saves the graph."""

    def __post_init__(self) -> None:
        if self.control_variate not in ("on", "off", "fast_only"):
            raise ConfigError(f"control_variate must be on, off or fast_only, got {self.control_variate!r}")
        if self.sampler not in ("vmf", "none"):
            raise ConfigError(f"sampler must be vmf or none, got {self.sampler!r}")
        for name in ("fast", "exact"):
            counts: DirectionCounts = getattr(self, name)
            used = self.control_variate != ("off" if name == "fast" else "fast_only")
            if used and (counts.cosine + counts.sampler < 1 or counts.specular < 1):
                # No fast estimate at all leaves the correction alone; half of one is wrong.
                if name == "fast" and counts.total == 0 and self.control_variate == "on":
                    continue
                raise ConfigError(
                    f"{name} needs at least one diffuse and one specular direction, got {counts}"
                )


def control_variate(
    points: ShadingPoints,
    materials: Materials,
    sources: LightSources,
    *,
    mixture: Strategy | None,
    config: EstimatorConfig,
    generator: torch.Generator,
    with_variance: bool = False,
    supervise: bool = False,
) -> Estimate:
    """Return the fast estimate plus the correction that makes its mean that of the NeRF cache alone.

    The correction evaluates both caches, `sources.near` and `sources.fast`, on the same rays; the fast
    estimate has its own. `mixture` is the light sampler's at the points, or None to draw from the cosine
    instead. Caches are called without gradients unless `config.through_cache` says otherwise, except for the
    fast cache on the rays of the correction, whose answer is returned for its own loss; the environment is
    called once, with gradients.
    `supervise` traces the exact directions also where the estimate leaves them out ("fast_only"), for the
    losses that learn from them. Source: paper Eq. 9.
    """
    nothing = DirectionCounts(cosine=0, sampler=0, specular=0)
    counts = (
        config.exact if supervise or config.control_variate != "fast_only" else nothing,
        nothing if config.control_variate == "off" else config.fast,
    )
    cosine = CosineLobe(points.normal.detach())
    lobe = GgxLobe(points.omega_o.detach(), points.normal.detach(), materials.alpha.detach())
    diffuse: list[tuple[Strategy, list[int]]]
    if mixture is None or config.sampler == "none":
        diffuse = [(cosine, [count.cosine + count.sampler for count in counts])]
    else:
        diffuse = [(cosine, [c.cosine for c in counts]), (mixture, [c.sampler for c in counts])]
    specular = [(lobe, [count.specular for count in counts])]
    directions = DrawnDirections.draw(points, diffuse, specular, config.stratified, sources.limits, generator)
    rays = directions.rays
    sky = sources.environment(rays.directions, rays.light_index)
    exact_nerf, exact_fast, fast_only = _ask(rays, directions.num_exact_rays, sources, config)
    near, clear = _signed(exact_nerf, exact_fast, fast_only, config)
    radiance = directions.scatter(near + clear.unsqueeze(-1) * sky)
    result = directions.integrate(radiance, materials, config.normal_gradient, with_variance)
    if exact_nerf is None:
        return result
    return result._replace(exact=directions.exact(exact_nerf, exact_fast, sky))


def estimate(
    points: ShadingPoints,
    materials: Materials,
    sources: LightSources,
    *,
    diffuse: Sequence[tuple[Strategy, int]],
    specular: Sequence[tuple[Strategy, int]],
    config: EstimatorConfig,
    generator: torch.Generator,
    with_variance: bool = False,
) -> Estimate:
    """Return the plain multi-sample estimate with any strategies, and their directions, in each half.

    For relighting, the halves are usually (cosine, map) and (GGX, map) with the same `EnvironmentMapSampler`,
    and `sources.near` answers with what the new light makes of the near field. Only `stratified` and the
    gradient factors of `config` are used. Source: paper Eq. 5 with the power heuristic of
    supplement 2.7.
    """
    halves = [[(strategy, [count]) for strategy, count in half] for half in (diffuse, specular)]
    directions = DrawnDirections.draw(
        points, halves[0], halves[1], config.stratified, sources.limits, generator
    )
    radiance = _arriving(directions, sources, config)
    return directions.integrate(radiance, materials, config.normal_gradient, with_variance)


def relight(
    points: ShadingPoints,
    materials: Materials,
    sources: LightSources,
    *,
    light: Strategy | None,
    counts: DirectionCounts,
    config: EstimatorConfig,
    generator: torch.Generator,
    continued: bool = False,
) -> Estimate:
    """Return radiance under a known environment with its variance; no gradients.

    `light` draws from the environment: an `EnvironmentMapSampler`, or the learned sampler's mixture. It gets
    `counts.sampler` directions, which go to the cosine without it. Every direction counts for both lobes,
    weighted by the power heuristic. Beyond the paper, which samples only the map: the GGX share is what keeps
    shiny surfaces free of noise. With `continued` the directions of neighbouring points avoid each other
    (`draw_uniforms`): for pictures.
    """
    cosine = CosineLobe(points.normal)
    lobe = GgxLobe(points.omega_o, points.normal, materials.alpha)
    strategies: list[tuple[Strategy, list[int]]]
    if light is None:
        strategies = [(cosine, [counts.cosine + counts.sampler]), (lobe, [counts.specular])]
    else:
        strategies = [(cosine, [counts.cosine]), (light, [counts.sampler]), (lobe, [counts.specular])]
    with torch.no_grad():
        directions = DrawnDirections.draw(
            points, strategies, [], config.stratified, sources.limits, generator, continued=continued
        )
        return directions.integrate_together(_arriving(directions, sources, config), materials)


def _arriving(directions: DrawnDirections, sources: LightSources, config: EstimatorConfig) -> Tensor:
    """Return the radiance [points, lights, 3] that arrives from the near field and the environment behind."""
    rays = directions.rays
    near, clear = _signed(sources.near(rays), None, None, config)
    sky = sources.environment(rays.directions, rays.light_index)
    return directions.scatter(near + clear.unsqueeze(-1) * sky)


def _ask(
    rays: SecondaryRays, num_exact: int, sources: LightSources, config: EstimatorConfig
) -> tuple[NearField | None, NearField | None, NearField | None]:
    """Return the two caches' answers to the exact rays, and the fast cache's to the others."""
    nerf, fast = sources.near, sources.fast
    assert fast is not None, "a control variate needs both caches"
    exact, rest = rays.split(num_exact)
    frozen = config.through_cache == 0.0
    # The fast cache's own loss needs a graph of the exact rays only.
    apart = frozen and torch.is_grad_enabled()
    with torch.no_grad() if frozen else nullcontext():
        if config.control_variate == "off":
            return nerf(exact), None, None
        if config.control_variate == "fast_only" and not num_exact:
            return None, None, fast(rest)
        exact_nerf = nerf(exact)
        if not apart:
            both = fast(rays)
            parts = (slice(None, num_exact), slice(num_exact, None))
            head, last = (
                Incident(both.near_radiance[part], both.opacity[part], both.distance[part]) for part in parts
            )
            return exact_nerf, head, last
        tail = fast(rest)
    return exact_nerf, fast(exact), tail


def _signed(
    exact_nerf: NearField | None,
    exact_fast: NearField | None,
    fast_only: NearField | None,
    config: EstimatorConfig,
) -> tuple[Tensor, Tensor]:
    """Return the near radiance and the factor of the environment with which every ray enters the sum.

    An exact ray counts NeRF minus fast cache: the environment enters with minus the difference of the
    opacities. Without a correction it counts nothing.
    """

    def parts(answer: NearField) -> tuple[Tensor, Tensor]:
        return (
            scale_gradient(answer.near_radiance, config.through_cache),
            1.0 - scale_gradient(answer.opacity, config.through_cache),
        )

    blocks = []
    if exact_nerf is not None:
        near, clear = parts(exact_nerf)
        if config.control_variate == "fast_only" and exact_fast is not None:
            near, clear = torch.zeros_like(near), torch.zeros_like(clear)
        elif exact_fast is not None:
            known, seen = parts(exact_fast)
            near, clear = near - known, clear - seen
        blocks.append((near, clear))
    if fast_only is not None:
        blocks.append(parts(fast_only))
    if len(blocks) == 1:
        return blocks[0]
    return torch.cat([near for near, _ in blocks]), torch.cat([clear for _, clear in blocks])

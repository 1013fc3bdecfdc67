"""One pass of a refined picture: even directions at every point, and what comes from there.

Where the faces of a mesh are what is in the way, one compiled loop follows the rays, looks up the sky, and
leaves a list of hits. Other surroundings (a learned visibility, which is between 0 and 1) are asked for
whole arrays of rays.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight.brdf import cosine_pdf
from lambent_relight.bundle.graphs import AdaptedHits
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import Environment
from lambent_relight.refined.known_light import KnownLight
from lambent_relight.refined.known_sky import cells_of
from lambent_relight.refined.scattering import (
    LightDirections,
    SurfacePoints,
    draw_directions,
    strategy_shares,
)
from lambent_relight.refined.surroundings import Met, Surroundings

FOLLOWED = 0.25
"""Rays blocked with at least this probability are always followed to the hit, others by chance."""


@dataclass(frozen=True)
class Light:
    """An environment and its sampler."""

    environment: Environment
    sampler: LightSampler


@dataclass(frozen=True)
class Scene:
    """The object and its light."""

    around: Surroundings
    """What secondary rays meet."""
    light: Light
    adapted: Callable[[NDArray[np.float32], NDArray[np.float32]], AdaptedHits] | None = None
    """Hits of rays [n, 3] and their radiance under exactly this light; takes precedence over `around`."""
    most_bounces: int = 0
    """Reflections of light on its way to the eye, as random paths; 0: all that `around` knows, else two."""
    num_threads: int = 1
    """Threads that may call these functions at once."""
    indirect: bool = True
    """Whether light that other surfaces reflect counts."""


def one_pass(
    points: SurfacePoints,
    u: NDArray[np.float64],
    scene: Scene,
    rng: np.random.Generator,
    known: KnownLight,
) -> NDArray[np.float32]:
    """Return means over directions of points [point, 3], drawn from uniforms `u` [ray, 3], [6, point, 3].

    Direct radiance, once-reflected radiance, the specular part of both, the free share, and once-reflected
    radiance of the diffuse lobe where it is `known`, which the second lacks; and what the same directions
    find of the known sky. Rays divide evenly among the points, in their order.
    """
    sampler = scene.light.sampler
    drawn = draw_directions(points, sampler, u, strategy_shares(points, sampler))
    result = np.zeros((6, len(points.position), 3))
    traced = scene.around.mesh is not None and (scene.adapted is None or not scene.indirect)
    (_trace if traced else _ask)(points, drawn, scene, rng, known, result)
    return result.astype(np.float32)


def _trace(
    points: SurfacePoints,
    drawn: LightDirections,
    scene: Scene,
    rng: np.random.Generator,
    known: KnownLight,
    result: NDArray[np.float64],
) -> None:
    """Write the means of `one_pass` to `result`, through the faces of a mesh."""
    from lambent_relight.refined import traced_kernels as kernels

    mesh, offset = scene.around.mesh, np.float32(scene.around.origin_offset)
    assert mesh is not None
    environment = scene.light.environment
    origin = np.ascontiguousarray(points.position + offset * points.normal, np.float32)
    rays, where = np.empty((2, len(drawn.omega_i)), np.int32), np.empty((len(drawn.omega_i), 3), np.float32)
    lobes = (drawn.diffuse, drawn.specular)
    count = kernels.follow(
        (mesh.tree, mesh.one_sided),
        (environment.radiance, np.float32(environment.rotate_deg / 360.0)),
        (origin, np.ascontiguousarray(points.normal, np.float32)),
        cells_of(known.sky),
        (drawn.omega_i, *lobes, drawn.pdf_solid_angle[:, 0]),
        scene.indirect,
        rays,
        where,
        result,
    )
    ray, face, where = rays[0, :count], rays[1, :count], where[:count]
    if not scene.indirect or count == 0:
        return
    met = scene.around.met(face, where)
    direction = drawn.omega_i[ray]
    bouncing = _reflected(met, origin[ray // (len(drawn.omega_i) // len(origin))], direction, scene, rng)
    kernels.add_bounces(ray, known.known, *lobes, np.ascontiguousarray(bouncing, np.float32), result)


def _ask(
    points: SurfacePoints,
    drawn: LightDirections,
    scene: Scene,
    rng: np.random.Generator,
    known: KnownLight,
    result: NDArray[np.float64],
) -> None:
    """Write the means of `one_pass` to `result`, through anything."""
    from lambent_relight.refined import scattering_kernels as kernels

    active, per_pass = drawn.active, len(drawn.omega_i) // max(len(points.position), 1)
    owner = active // per_pass
    normal, direction = points.normal[owner], drawn.omega_i[active]
    origin = points.position[owner] + np.float32(scene.around.origin_offset) * normal
    adapted = scene.adapted(origin, direction) if scene.indirect and scene.adapted is not None else None
    seen = scene.around.meet(origin, direction) if adapted is None else Met(adapted.opacity, adapted.distance)
    arriving = (1.0 - seen.opacity) * scene.light.environment.lookup(direction)
    bouncing = np.zeros_like(arriving) if adapted is None else adapted.radiance
    if scene.indirect and adapted is None:
        # Below `FOLLOWED`, a hit of opacity a is followed with probability a / FOLLOWED, at weight FOLLOWED:
        # the mean is that of following all at weight a.
        hit = np.flatnonzero(FOLLOWED * rng.random(len(active)) < seen.opacity[:, 0])
        bouncing[hit] = _reflected(seen[hit], origin[hit], direction[hit], scene, rng)
        bouncing[hit] *= np.maximum(seen.opacity[hit], np.float32(FOLLOWED))
    cosine = cosine_pdf(direction, normal)[:, 0] / drawn.pdf_solid_angle[active, 0]
    lobes = (drawn.diffuse, drawn.specular)
    free = 1.0 - seen.opacity
    kernels.add_up(active, per_pass, known.known, *lobes, arriving, bouncing, cosine, free, result)


def _reflected(
    met: Met,
    origin: NDArray[np.float32],
    direction: NDArray[np.float32],
    scene: Scene,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Return what comes back along rays that met something, [ray, 3]."""
    if scene.most_bounces == 0 and scene.around.has_radiance:
        return scene.around.radiance(met, origin + met.distance * direction, -direction)
    return _path_radiance(met, origin, direction, scene, rng, (scene.most_bounces or 2) - 1)


def _path_radiance(
    met: Met,
    origin: NDArray[np.float32],
    direction: NDArray[np.float32],
    scene: Scene,
    rng: np.random.Generator,
    most_bounces: int,
) -> NDArray[np.float32]:
    """Return unbiased estimates of what comes back along rays that met something, [ray, 3].

    A path continues from each hit in one direction, followed with the probability of its opacity: light
    that reaches the hits after at most `most_bounces` reflections, theirs included.
    """
    if most_bounces < 1 or len(origin) == 0:
        return np.zeros((len(origin), 3), np.float32)
    points = scene.around.surface(met, origin + met.distance * direction, -direction)
    light = scene.light
    shares = strategy_shares(points, light.sampler)
    drawn = draw_directions(points, light.sampler, rng.random((len(origin), 3)), shares)
    active = drawn.active
    start = points.position[active] + np.float32(scene.around.origin_offset) * points.normal[active]
    onwards = drawn.omega_i[active]
    seen = scene.around.meet(start, onwards)
    arriving = (1.0 - seen.opacity) * light.environment.lookup(onwards)
    if most_bounces > 1:
        hit = np.flatnonzero(rng.random(len(active)) < seen.opacity[:, 0])
        arriving[hit] += _path_radiance(seen[hit], start[hit], onwards[hit], scene, rng, most_bounces - 1)
    radiance = np.zeros((len(origin), 3), np.float32)
    radiance[active] = drawn.weight[active] * arriving
    return radiance

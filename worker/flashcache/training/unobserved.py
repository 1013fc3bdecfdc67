"""Points and directions that no photograph shows: where the NeRF cache is asked without ever being taught."""

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.config import StageTwoConfig
from flashcache.geometry.directions import dot
from flashcache.physical.estimator import control_variate
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from flashcache.training.joint_losses import Terms, consistency_terms
from flashcache.training.passes import Pass

BLOCKED = 0.5
"""Opacity from which a secondary ray counts as having hit something."""


def unobserved_points(
    model: InverseModel, first: Pass, num_points: int, generator: torch.Generator
) -> tuple[ShadingPoints, Float[Tensor, "points width"]]:
    """Return points that face their viewer with their density features; without gradients.

    Up to half are what exact secondary rays hit, looked at along those rays; the others are points of the
    pass, looked at from random directions above them.
    """
    seen = first.points
    with torch.no_grad():
        device = seen.positions.device
        pick = torch.randint(len(seen.positions), (num_points // 2,), generator=generator, device=device)
        towards = torch.randn(len(pick), 3, generator=generator, device=device, dtype=seen.positions.dtype)
        towards = torch.nn.functional.normalize(towards, dim=-1)
        above = torch.where(dot(towards, seen.normal[pick]) < 0.0, -towards, towards)
        positions, omega_o, lights = [seen.positions[pick]], [above], [seen.light_index[pick]]
        exact = first.estimate.exact
        if exact is not None:
            hits = (exact.nerf.opacity > BLOCKED).nonzero()[:, 0]
            if len(hits):
                hits = hits[torch.randint(len(hits), (len(pick),), generator=generator, device=device)]
                rays, distance = exact.rays, exact.nerf.distance[hits, None]
                positions.append(rays.origins[hits] + distance * rays.directions[hits])
                omega_o.append(-rays.directions[hits])
                lights.append(rays.light_index[hits])
        places, towards = torch.cat(positions), torch.cat(omega_o)
        hidden = model.nerf.density(places).hidden
        normal = model.nerf.normals(places, hidden)
        facing = dot(normal, towards)[:, 0] > 0.0
        points = ShadingPoints(places[facing], normal[facing], towards[facing], torch.cat(lights)[facing])
        return points, hidden[facing]


def unobserved_terms(
    model: InverseModel, config: StageTwoConfig, first: Pass, generator: torch.Generator
) -> Terms:
    """Return consistency losses where no photograph speaks: the cache learns what the materials say there.

    Moves the cache's heads only, as the consistency loss at observed points does (supplement 2.9).
    """
    points, hidden = unobserved_points(model, first, config.unobserved.num_points, generator)
    if not len(points.positions):
        return {}
    with torch.no_grad():
        mixture = None
        if config.estimator.sampler == "vmf":
            mixture = model.light_sampler(points.positions, points.light_index)
        estimate = control_variate(
            points,
            model.materials(points.positions),
            nerf=model.nerf_source(generator, jitter=config.secondary_jitter),
            fast=model.fast_source(),
            environment=model.environment,
            mixture=mixture,
            limits=model.limits,
            config=config.estimator,
            generator=generator,
        )
    weight = torch.ones_like(points.positions[:, 0])
    return consistency_terms(
        model, points, hidden, estimate, weight, config.unobserved.weight, name="unobserved"
    )

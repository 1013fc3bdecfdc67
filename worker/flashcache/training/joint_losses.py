"""The losses of stage two by the parts they change; every function returns its weighted terms by name."""

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.color import perceptual_roughness_from_alpha
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch
from flashcache.fields.appearance import Appearance
from flashcache.fields.materials import Materials
from flashcache.losses.clusters import ClusterConfig, gloss_differences, material_entropy
from flashcache.losses.fast_cache import fast_cache_loss
from flashcache.losses.light_sampler import light_sampler_loss
from flashcache.losses.metalness import directional_variation, directions_around, variation_prior
from flashcache.losses.photometric import cache_photometric, consistency, mask_loss, physical_photometric
from flashcache.losses.priors import grey_prior, grid_decay, tint_prior
from flashcache.losses.smoothness import pseudo_albedo, smoothness
from flashcache.parallel.ranks import rows_of_all_ranks
from flashcache.physical.incident import SecondaryRays
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import Estimate, ShadingPoints
from flashcache.randomness import normal, uniform
from flashcache.training.cache_losses import shape_terms
from flashcache.training.passes import Shaded

Terms = dict[str, Tensor]

GREY_DIRECTIONS = 256
"""Random directions in which the environment is compared with grey."""


def covered(batch: RayBatch, points: ShadingPoints) -> Float[Tensor, " points"]:
    """Return one for shaded points whose pixel shows the object, else zero."""
    repeats = len(points.positions) // len(batch)
    return (batch.coverage > 0.0).repeat(repeats).to(points.positions.dtype)


def cache_terms(
    model: InverseModel,
    config: StageTwoConfig,
    batch: RayBatch,
    geometry: Geometry,
    cache: Float[Tensor, "rays 3"],
    generator: torch.Generator,
    *,
    with_normals: bool,
) -> Terms:
    """Return the losses of the NeRF cache against the photographs, and those on its shape."""
    background = torch.ones_like(batch.colour)
    if config.random_background:
        background = uniform(background.shape, generator, background.device)
    opacity = geometry.opacity
    seen = cache + (1.0 - opacity)[:, None] * background
    terms = {"colour": cache_photometric(seen, batch.over(background), batch.clipped)}
    if config.mask_weight:
        terms["mask"] = config.mask_weight * mask_loss(opacity, batch.coverage)
    terms |= shape_terms(
        batch,
        geometry,
        normal_weight=config.normal_weight if with_normals else 0.0,
        normal_weight_gradient=config.normal_weight_gradient,
        orientation_weight=config.orientation_weight if with_normals else 0.0,
        orientation_derived=config.orientation_derived,
        distortion_weight=config.distortion_weight,
    )
    return terms


def decay_terms(model: InverseModel, config: StageTwoConfig) -> Terms:
    """Return the decay of the trained grids; proposals are frozen, and decay alone would erase them."""
    if not config.grid_decay:
        return {}
    grids = [model.materials.grid, model.light_sampler.grid, model.nerf.density.grid]
    if model.materials.gloss is not None:
        grids.append(model.materials.gloss.grid)
    return {"grid_decay": config.grid_decay * grid_decay(grids)}


def physical_loss(
    config: StageTwoConfig,
    batch: RayBatch,
    cache: Float[Tensor, "rays 3"],
    picture: Float[Tensor, "rays 3"],
    other: Float[Tensor, "rays 3"],
) -> Float[Tensor, ""]:
    """Return the weighted photometric loss of a physical picture over black; `other` is a constant."""
    counted = (batch.coverage > 0.0).to(cache.dtype)
    wanted = batch.colour * batch.coverage[:, None]
    share = 0.5 if config.symmetric else 1.0
    loss = physical_photometric(wanted, picture, other.detach(), cache, counted, batch.clipped)
    return share * config.physical_weight * loss


def consistency_terms(
    model: InverseModel,
    points: ShadingPoints,
    hidden: Float[Tensor, "points width"],
    estimate: Estimate,
    point_weight: Float[Tensor, " points"],
    weight: float,
) -> Terms:
    """Return the losses that move the cache's heads towards physical estimates at the same points."""
    heads = model.nerf.appearance(
        points.positions, hidden.detach(), points.normal.detach(), points.omega_o, points.light_index
    )
    pairs = {
        "diffuse": (heads.diffuse, estimate.diffuse),
        "specular": (heads.specular, estimate.specular),
        "irradiance": (heads.irradiance, estimate.irradiance),
    }
    return {
        f"consistency_{part}": weight * consistency(head, physical, point_weight)
        for part, (head, physical) in pairs.items()
    }


def material_terms(
    model: InverseModel,
    config: StageTwoConfig,
    batch: RayBatch,
    appearance: Appearance,
    shaded: Shaded,
    generator: torch.Generator,
    *,
    with_gloss: bool = True,
) -> Terms:
    """Return the priors on materials, without `with_gloss` smoothness alone: the others wait."""
    points = shaded.points
    terms: Terms = {}
    if config.smoothness_weight:
        shape, device = points.positions.shape, points.positions.device
        step = config.smoothness_step * normal(shape, generator, device)
        nearby = points.positions + step
        with torch.no_grad():
            hidden = model.nerf.density(nearby).hidden
            moved = model.nerf.appearance(nearby, hidden, points.normal, points.omega_o, points.light_index)
            here, there = (
                pseudo_albedo(getattr(each, config.pseudo_albedo), each.irradiance)
                for each in (Appearance(*(part[shaded.index] for part in appearance)), moved)
            )
        terms["smoothness"] = config.smoothness_weight * smoothness(
            shaded.materials,
            model.materials(nearby),
            here,
            there,
            covered(batch, points),
            guided=config.smoothness_guide,
        )
    if not with_gloss:
        return terms
    if config.clusters.gloss_weight or config.clusters.weight:
        terms |= cluster_terms(config.clusters, batch, shaded)
    return terms


def cluster_terms(config: ClusterConfig, batch: RayBatch, shaded: Shaded) -> Terms:
    """Return the preference for few materials: one point of each ray, since all pairs are compared."""
    own, first, terms = shaded.materials, slice(len(batch)), {}
    parts = (own.albedo, own.alpha, own.metalness)
    materials = Materials(*(rows_of_all_ranks(part[first]) for part in parts))
    seen = rows_of_all_ranks((batch.coverage > 0.0).to(own.albedo.dtype))
    if config.gloss_weight:
        positions = rows_of_all_ranks(shaded.points.positions[first].detach())
        terms["gloss"] = config.gloss_weight * gloss_differences(materials, positions, seen, config)
    if config.weight:
        terms["clusters"] = config.weight * material_entropy(materials, seen, config.width, config.gloss)
    return terms


def metalness_terms(
    model: InverseModel,
    config: StageTwoConfig,
    batch: RayBatch,
    geometry: Geometry,
    shaded: Shaded,
    generator: torch.Generator,
    *,
    warming_up: bool,
) -> Terms:
    """Return the prior that prefers metal on strongly view-dependent surfaces (decision 0015)."""
    prior = config.metalness_prior
    weight = prior.warmup_weight if warming_up else prior.weight
    if not weight:
        return {}
    # One point of each ray, because the appearance is evaluated in many directions.
    first, repeats = slice(len(batch)), prior.num_directions
    points = ShadingPoints(*(part[first] for part in shaded.points))
    with torch.no_grad():
        normal = points.normal
        outgoing = model.nerf.appearance(
            points.positions.repeat_interleave(repeats, dim=0),
            geometry.hidden[shaded.index[first]].repeat_interleave(repeats, dim=0),
            normal.repeat_interleave(repeats, dim=0),
            directions_around(normal, repeats, generator).reshape(-1, 3),
            points.light_index.repeat_interleave(repeats),
        )
        shape = (len(normal), repeats, 3)
        seen = covered(batch, points)
        variation = directional_variation(
            outgoing.diffuse.reshape(shape), outgoing.specular.reshape(shape), seen
        )
    metalness = shaded.materials.metalness[first]
    terms = {"metalness": weight * variation_prior(metalness, prior.range, variation, seen, prior)}
    if warming_up and prior.perceptual_roughness is not None:
        width = perceptual_roughness_from_alpha(shaded.materials.alpha[first])
        terms["width"] = weight * variation_prior(width, prior.perceptual_roughness, variation, seen, prior)
    return terms


def environment_terms(model: InverseModel, config: StageTwoConfig, generator: torch.Generator) -> Terms:
    """Return the priors on the environments that are learned (decisions 0006 and 0030)."""
    learned = model.environment.learned_lights
    device = learned.device
    if not len(learned) or not (config.grey_weight or config.tint_weight):
        return {}
    directions = torch.randn(GREY_DIRECTIONS, 3, generator=generator, device=device)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    index = learned[torch.randint(len(learned), (GREY_DIRECTIONS,), generator=generator, device=device)]
    radiance, terms = model.environment(directions, index), {}
    if config.grey_weight:
        terms["grey"] = config.grey_weight * grey_prior(radiance)
    if config.tint_weight:
        terms["tint"] = config.tint_weight * tint_prior(radiance)
    return terms


def in_reach(model: InverseModel, rays: SecondaryRays) -> Float[Tensor, " rays"]:
    """Return one for rays that start where the fast cache is taught, else zero (authors' code)."""
    radius = model.domain.fast_radius or model.domain.contraction_radius
    return (rays.origins.norm(dim=-1) < radius).to(rays.origins.dtype)


def secondary_terms(model: InverseModel, config: StageTwoConfig, shaded: Shaded) -> Terms:
    """Return the losses that train the fast cache and the light sampler on the exact rays."""
    exact = shaded.estimate.exact
    terms: dict[str, Tensor] = {}
    if exact is None:
        return terms
    if exact.fast is not None:
        terms["fast"] = fast_cache_loss(
            exact.fast,
            exact.nerf,
            in_reach(model, exact.rays),
            model.limits,
            counted=exact.rays.counted,
            from_diffuse=exact.from_diffuse if config.fast_by_half else None,
            distance_weight=config.distance_weight,
        )
    if shaded.mixture is not None:
        terms["sampler"] = light_sampler_loss(shaded.mixture, exact)
    return terms

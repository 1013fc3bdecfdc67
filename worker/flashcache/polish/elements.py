"""Surface elements: small pieces of the trained surface, each with the pixels that show it."""

from dataclasses import dataclass, replace
from functools import partial

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.data.ray_batches import TrainingPixels
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.directions import dot, facing, normalize
from flashcache.physical.model import InverseModel
from flashcache.volume.quadrature import composite, draw_points

OPAQUE, SOUND_OPACITY = 0.99, 0.9
"""Coverage of a pixel, and opacity of its ray, from which it is an observation."""
GRAZING = 0.15
"""Cosine at the viewer below which a pixel is not one."""
MOST_PIXELS = 120_000
MOST_ELEMENTS = 24_000
MOST_OBSERVATIONS = 10
"""Per element."""
LEAST_OBSERVATIONS = 2
HELD_OUT = 5
CHUNK_RAYS = 4096
MOST_DETAIL = 1.6
GRAIN = 0.1
"""Standard deviation of the logarithm of trained albedo where the true one is uniform."""
SIDES = 6
PLACES = 4
"""Places of a ray at which fields are taught."""


@dataclass(frozen=True, slots=True, eq=False)
class Elements:
    """Pieces of surface and their observations, which lie one element after another."""

    positions: Float[Tensor, "elements 3"]
    """Mean of the observed points, scene units."""
    normal: Float[Tensor, "elements 3"]
    """Mean of the predicted normals, unit."""
    size: float
    """Side of the voxels in which observations share an element, scene units."""
    first: Int[Tensor, " elements_and_one"]
    """Number of each element's first observation; the last entry is the number of all."""
    points: Float[Tensor, "observations 3"]
    """What each pixel shows, scene units."""
    omega_o: Float[Tensor, "observations 3"]
    """Unit, towards the camera."""
    colour: Float[Tensor, "observations 3"]
    """Linear Rec. 709."""
    clipped: Bool[Tensor, "observations 3"]
    """Channels that are known to be at least so bright."""
    detail: Float[Tensor, "observations 3"]
    """Albedo that the trained field has at the point, over its mean in the element."""
    light: Int[Tensor, " observations"]
    """Light of the photograph, as in `RayBatch.light_index`."""
    pixel: Int[Tensor, " observations"]
    """Position among the training pixels."""
    photograph: Int[Tensor, " observations"]
    """Number of the photograph among all training photographs."""
    places: Float[Tensor, "observations places 3"]
    """Samples of each pixel's ray in equal parts of its render weight: where a picture is shaded."""
    rest: Float[Tensor, "rest places 3"]
    """The same of opaque pixels without an observation: too oblique, too blurred, or alone."""

    def __len__(self) -> int:
        """Return the number of elements."""
        return len(self.positions)

    @property
    def counts(self) -> Int[Tensor, " elements"]:
        """Return the number of observations of each element."""
        return self.first[1:] - self.first[:-1]

    def of(self, kept: Bool[Tensor, " observations"]) -> "Elements":
        """Return the same elements with some of their observations; elements may be left without any."""
        counts = torch.zeros(len(self), dtype=torch.long).index_add_(0, self.element, kept.long())
        names = ["points", "omega_o", "colour", "clipped", "detail", "light", "pixel", "photograph", "places"]
        rows = {name: getattr(self, name)[kept] for name in names}
        return replace(self, first=torch.nn.functional.pad(counts.cumsum(0), (1, 0)), **rows)

    def split(self) -> tuple["Elements", "Elements"]:
        """Return the elements for a fit, and with what photographs show that the fit does not see.

        Every `HELD_OUT`th photograph is held out, but for elements that would be left with too little.
        """
        held = self.photograph % HELD_OUT == HELD_OUT - 1
        left = torch.zeros(len(self), dtype=torch.long).index_add_(0, self.element, (~held).long())
        held = held & (left >= LEAST_OBSERVATIONS)[self.element]
        return self.of(~held), self.of(held)

    @property
    def element(self) -> Int[Tensor, " observations"]:
        """Return the element of each observation."""
        return torch.repeat_interleave(torch.arange(len(self)), self.counts)


@dataclass(frozen=True, slots=True, eq=False)
class _Hits:
    points: Float[Tensor, "rays 3"]
    normal: Float[Tensor, "rays 3"]
    omega_o: Float[Tensor, "rays 3"]
    spread: Float[Tensor, " rays"]
    """Standard deviation of the render weights along the ray, scene units."""
    opacity: Float[Tensor, " rays"]
    places: Float[Tensor, "rays places 3"]


def find_elements(model: InverseModel, pixels: TrainingPixels, generator: torch.Generator) -> Elements:
    """Return the elements of the surface that the photographs show; few or none where they show little.

    Opaque pixels are traced once. Those whose points lie in one voxel, as wide as a pixel, and whose normals
    have the same dominant axis are one element: that a pixel shows a point is its visibility.
    """
    chosen = _opaque_pixels(pixels, generator)
    batches = chosen.split(CHUNK_RAYS)
    parts = on_all_cores(partial(_hits, model, pixels), batches, pixels.device)
    hits = _Hits(*(torch.cat([getattr(part, name) for part in parts]) for name in _Hits.__slots__))
    size = _footprint(pixels, hits.points, chosen)
    sound = (
        (hits.spread < 1.5 * size)
        & (hits.opacity > SOUND_OPACITY)
        & (dot(hits.normal, hits.omega_o)[:, 0] > GRAZING)
    )
    kept = sound.nonzero()[:, 0]
    while True:
        element, counts = _voxels(hits.points[kept], hits.normal[kept], size)
        if (counts >= LEAST_OBSERVATIONS).sum() <= MOST_ELEMENTS:
            break
        size *= 1.1
    kept = kept[(counts >= LEAST_OBSERVATIONS)[element]]
    element, counts = _voxels(hits.points[kept], hits.normal[kept], size)
    positions = _means(hits.points[kept], element, counts)
    normal = normalize(_means(hits.normal[kept], element, counts))
    alone = torch.ones(len(chosen), dtype=torch.bool)
    alone[kept] = False
    order = _some_of_each(element, counts, generator)
    kept, element = kept[order], element[order]
    batch = pixels.at(chosen[kept])
    clipped = torch.zeros_like(batch.colour, dtype=torch.bool) if batch.clipped is None else batch.clipped
    first = torch.nn.functional.pad(counts.clamp_max(MOST_OBSERVATIONS).cumsum(0), (1, 0))
    return Elements(
        positions=positions,
        normal=normal,
        size=size,
        first=first,
        points=hits.points[kept],
        omega_o=hits.omega_o[kept],
        colour=batch.colour,
        clipped=clipped,
        detail=_detail(model, hits.points[kept], element, len(counts)),
        light=batch.light_index,
        pixel=chosen[kept],
        photograph=pixels.photograph_of(chosen[kept]),
        places=hits.places[kept],
        rest=hits.places[alone & (hits.opacity > SOUND_OPACITY)],
    )


def _opaque_pixels(pixels: TrainingPixels, generator: torch.Generator) -> Int[Tensor, " some"]:
    """Return the positions of opaque pixels, at most `MOST_PIXELS` of them at random."""
    inside = pixels.inside
    covered = torch.cat([pixels.at(part).coverage > OPAQUE for part in inside.split(1 << 16)])
    opaque = inside[covered]
    if len(opaque) > MOST_PIXELS:
        drawn = torch.randperm(len(opaque), generator=generator, device=opaque.device)[:MOST_PIXELS]
        opaque = opaque[drawn.sort().values]
    return opaque


def _hits(model: InverseModel, pixels: TrainingPixels, index: Int[Tensor, " rays"]) -> _Hits:
    batch = pixels.at(index)
    geometry = model.nerf.trace(batch.rays, generator=None)
    share = geometry.weights / geometry.opacity.clamp_min(1e-6)[:, None]
    places = geometry.samples.positions.reshape(len(index), -1, 3)
    points = (share[..., None] * places).sum(dim=1)
    away = (places - points[:, None]).square().sum(dim=-1)
    omega_o = -batch.rays.directions
    normal = facing(normalize(composite(share, geometry.normal)), omega_o)
    parts = (torch.arange(PLACES, device=index.device) + 0.5) / PLACES
    drawn = draw_points(geometry.weights, parts.expand(len(index), PLACES)).index
    met = places.gather(1, drawn[..., None].expand(-1, -1, 3))
    return _Hits(points, normal, omega_o, (share * away).sum(dim=1).sqrt(), geometry.opacity, met)


def _footprint(pixels: TrainingPixels, points: Float[Tensor, "rays 3"], index: Int[Tensor, " rays"]) -> float:
    """Return the median width of a pixel on the surface, scene units."""
    if not len(index):
        return 1.0
    image = pixels.photograph_of(index)
    distance = (points - pixels.pose[image, :3, 3]).norm(dim=-1)
    return float((distance / pixels.focal[image].mean(dim=-1)).median())


def _voxels(
    points: Float[Tensor, "rays 3"], normal: Float[Tensor, "rays 3"], size: float
) -> tuple[Int[Tensor, " rays"], Int[Tensor, " elements"]]:
    """Return each ray's element and the elements' numbers of rays."""
    if not len(points):
        return torch.zeros(0, dtype=torch.long), torch.zeros(0, dtype=torch.long)
    cell = torch.floor(points / size).long()
    cell = cell - cell.min(dim=0).values
    extent = cell.max(dim=0).values + 1
    axis = normal.abs().argmax(dim=1, keepdim=True)
    side = (2 * axis + (normal.gather(1, axis) > 0))[:, 0]
    key = ((cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]) * SIDES + side
    _, element, counts = key.unique(return_inverse=True, return_counts=True)
    return element, counts


def _means(
    values: Float[Tensor, "rays 3"], element: Int[Tensor, " rays"], counts: Int[Tensor, " elements"]
) -> Float[Tensor, "elements 3"]:
    total = values.new_zeros(len(counts), 3).index_add_(0, element, values)
    return total / counts.clamp_min(1)[:, None]


def _some_of_each(
    element: Int[Tensor, " rays"], counts: Int[Tensor, " elements"], generator: torch.Generator
) -> Int[Tensor, " some"]:
    """Return rays ordered by element, at most `MOST_OBSERVATIONS` of each, drawn at random."""
    shuffled = torch.randperm(len(element), generator=generator, device=element.device)
    order = shuffled[element[shuffled].argsort(stable=True)]
    start = torch.nn.functional.pad(counts.cumsum(0), (1, 0))[:-1]
    rank = torch.arange(len(order), device=element.device) - start[element[order]]
    return order[rank < MOST_OBSERVATIONS]


def _detail(
    model: InverseModel,
    points: Float[Tensor, "observations 3"],
    element: Int[Tensor, " observations"],
    count: int,
) -> Float[Tensor, "observations 3"]:
    albedo = torch.cat([model.materials(part).albedo for part in points.split(1 << 15)])
    mean = _means(albedo, element, torch.bincount(element, minlength=count))
    ratio = (albedo / mean[element].clamp_min(1e-3)).log()
    # Small differences are grain more often than paint: the best estimate of one in noise (Wiener).
    squared = ratio.square()
    return (ratio * squared / (squared + GRAIN**2)).clamp(-MOST_DETAIL, MOST_DETAIL).exp()

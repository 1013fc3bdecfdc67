"""Strategies that draw directions, and how several of them are combined at a batch of points.

A strategy is bound to its points: `sample` maps uniform variates to directions, `pdf` is the density in 1/sr
of any direction on the whole sphere. Uniform variates and directions have shapes [points, lights, k] and
[points, lights, 3].
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.geometry.directions import (
    direction_from_uv,
    dot,
    environment_solid_angles,
    from_frame,
    normalize,
    reflect,
    uv_from_direction,
)
from flashcache.physical.brdf import ggx_density
from flashcache.randomness import uniform

PDF_FLOOR = 1e-5
"""Smallest density in 1/sr by which a contribution is divided."""


@runtime_checkable
class Strategy(Protocol):
    """A way to draw directions at each point of a batch."""

    num_uniforms: int
    """Uniform variates that one direction takes."""

    def sample(self, u: Float[Tensor, "points lights k"]) -> Float[Tensor, "points lights 3"]:
        """Return unit directions."""
        ...

    def pdf(self, omega_i: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights"]:
        """Return `pdf_solid_angle` of directions, whichever strategy drew them."""
        ...


def _disc(angle: Float[Tensor, "*batch"], sine: Tensor, cosine: Tensor) -> Float[Tensor, "*batch 3"]:
    return torch.stack([sine * torch.cos(angle), sine * torch.sin(angle), cosine], dim=-1)


@dataclass(frozen=True)
class CosineLobe:
    """Directions above the surface with density n.omega_i / pi."""

    normal: Float[Tensor, "points 3"]
    num_uniforms = 2

    def sample(self, u: Float[Tensor, "points lights 2"]) -> Float[Tensor, "points lights 3"]:
        """Return directions above the surface (Malley's method)."""
        local = _disc(2.0 * math.pi * u[..., 1], u[..., 0].sqrt(), (1.0 - u[..., 0]).sqrt())
        return from_frame(local, self.normal.unsqueeze(1))

    def pdf(self, omega_i: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights"]:
        """Return n.omega_i / pi, zero below the surface."""
        return dot(self.normal.unsqueeze(1), omega_i).squeeze(-1).clamp_min(0.0) / math.pi


@dataclass(frozen=True)
class GgxLobe:
    """The view direction mirrored about half vectors with density D (n.h).

    Some directions end below the surface. Source: supplement 2.7.
    """

    omega_o: Float[Tensor, "points 3"]
    normal: Float[Tensor, "points 3"]
    alpha: Float[Tensor, "points 1"]
    num_uniforms = 2

    def sample(self, u: Float[Tensor, "points lights 2"]) -> Float[Tensor, "points lights 3"]:
        """Return mirrored directions, tan^2 of the half vector's angle being alpha^2 u / (1 - u)."""
        tangent = self.alpha * (u[..., 0] / (1.0 - u[..., 0])).sqrt()
        cosine = (1.0 + tangent * tangent).rsqrt()
        local = _disc(2.0 * math.pi * u[..., 1] - math.pi, tangent * cosine, cosine)
        omega_h = from_frame(local, self.normal.unsqueeze(1))
        return reflect(self.omega_o.unsqueeze(1), omega_h)

    def pdf(self, omega_i: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights"]:
        """Return D(h) |n.h| / (4 |omega_o.h|)."""
        omega_o, normal = self.omega_o.unsqueeze(1), self.normal.unsqueeze(1)
        omega_h = normalize(omega_i + omega_o)
        density = ggx_density(normal, omega_h, self.alpha.unsqueeze(1))
        jacobian = 4.0 * dot(omega_o, omega_h).abs().clamp_min(1e-7)
        return (density * dot(normal, omega_h).abs() / jacobian).squeeze(-1)


class EnvironmentMapSampler:
    """Directions in proportion to the brightness of a known environment picture; the same at every point.

    A pixel is drawn with probability proportional to (R + G + B) times its solid angle, and a direction
    uniformly (by solid angle) inside it. A black picture is sampled uniformly. `image` is linear radiance in
    the convention of `geometry.directions`. For pictures, whose light is known or has been recovered:
    training uses the learned light sampler.
    """

    num_uniforms = 2

    def __init__(self, image: Float[Tensor, "height width 3"]) -> None:
        height, width, _ = image.shape
        solid_angle = environment_solid_angles(height, width, dtype=torch.float64).to(image.device)
        brightness = image.double().sum(dim=-1).clamp_min(0.0)
        if not bool((brightness > 0.0).any()):
            brightness = torch.ones_like(brightness)
        power = (brightness * solid_angle[:, None]).reshape(-1)
        self._shape = (height, width)
        self._pdf = (brightness / power.sum()).to(image.dtype)
        of_rows = power.reshape(height, width).sum(dim=1)
        self._rows = of_rows.cumsum(0) / of_rows.sum()
        # A black row is never drawn; its columns are even, so that nothing is divided by zero.
        columns = torch.where(of_rows[:, None] > 0.0, brightness, torch.ones_like(brightness)).cumsum(dim=1)
        self._columns = columns / columns[:, -1:]

    def sample(self, u: Float[Tensor, "points lights 2"]) -> Float[Tensor, "points lights 3"]:
        """Return directions: the first variate picks a row, the second a column in it.

        Both rests place the direction inside of the pixel, so variates that are spread evenly give directions
        that are.
        """
        height, width = self._shape
        row, down = _inverse(self._rows, u[..., 0].double())
        # All rows one after another: that of row r lies between r and r + 1.
        ends = (self._columns + torch.arange(height, device=u.device)[:, None]).reshape(-1)
        place, across = _inverse(ends, row + u[..., 1].double(), starts=row.double())
        column = (place - row * width).clamp(0, width - 1)
        top, bottom = (torch.cos((row + offset) * (math.pi / height)) for offset in (0, 1))
        v = torch.acos((top + (bottom - top) * down).clamp(-1.0, 1.0)) / math.pi
        uv = torch.stack([(column + across) / width, v], dim=-1)
        return direction_from_uv(uv).to(u.dtype)

    def pdf(self, omega_i: Float[Tensor, "points lights 3"]) -> Float[Tensor, "points lights"]:
        """Return the density of the pixel in which each direction lies."""
        height, width = self._shape
        uv = uv_from_direction(omega_i)
        column = (uv[..., 0] * width).long().clamp(0, width - 1)
        row = (uv[..., 1] * height).long().clamp(0, height - 1)
        return self._pdf[row, column]


def _inverse(ends: Tensor, at: Tensor, starts: Tensor | float = 0.0) -> tuple[Tensor, Tensor]:
    """Return the interval of rising `ends` in which each of `at` lies, and how far along it, 0..1.

    The first interval begins at `starts`, as does any that would begin before.
    """
    place = torch.searchsorted(ends, at.contiguous(), right=True).clamp_max(len(ends) - 1)
    upper = ends[place]
    lower = torch.where(place > 0, ends[(place - 1).clamp_min(0)], torch.zeros_like(upper))
    lower = torch.maximum(lower, torch.as_tensor(starts, dtype=lower.dtype, device=lower.device))
    return place, ((at - lower) / (upper - lower).clamp_min(1e-300)).clamp(0.0, 1.0)


class DirectionSamples(NamedTuple):
    """Directions drawn by several strategies; a weighted sum over `lights` estimates an integral."""

    omega_i: Float[Tensor, "points lights 3"]
    pdf_solid_angle: Float[Tensor, "points lights"]
    """Density of the strategy that drew the direction, at least 1e-5."""
    mis_weight: Float[Tensor, "points lights"]
    """Power-heuristic weight of that strategy, in 0..1."""
    weight: Float[Tensor, "points lights"]
    """`mis_weight` / (number of directions * `pdf_solid_angle`): the integrand's factor."""
    groups: tuple[int, ...]
    """Lengths of the consecutive blocks of directions that one strategy drew for one estimate."""


def draw_uniforms(
    shape: tuple[int, int, int],
    generator: torch.Generator,
    like: Tensor,
    *,
    stratified: bool = False,
    continued: bool = False,
) -> Float[Tensor, "points lights k"]:
    """Return uniform variates in [0, 1): independent ones, or a lattice shifted at random at each point.

    Every variate of the lattice is uniform, so that estimates stay unbiased; those of one point avoid each
    other. The lattice is the additive recurrence of the generalised golden ratio (Roberts' sequence). With
    `continued` one lattice, shifted once, runs from each point into the next, so that the variates of
    neighbours avoid each other too: the mean of a pixel's points has less noise, and the points' errors
    depend on each other.
    """
    points, count, dimensions = shape
    if not stratified:
        return uniform(shape, generator, like.device, like.dtype)
    if continued:
        shift = torch.rand((1, 1, dimensions), generator=generator, dtype=like.dtype, device=like.device)
    else:
        shift = uniform((points, 1, dimensions), generator, like.device, like.dtype)
    ratio = 2.0
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    # From numbers alone: a tensor that is made from a list is copied to a GPU, which waits for the copy.
    numbers = points * count if continued else count
    number = torch.arange(numbers, dtype=torch.float64, device=like.device)
    lattice = torch.stack([number * ratio ** -(k + 1) for k in range(dimensions)], dim=-1) % 1.0
    if continued:
        lattice = lattice.reshape(points, count, dimensions)
    # The remainder of a float32 sum can round up to 1.
    return ((shift + lattice.to(like)) % 1.0).clamp_max(1.0 - torch.finfo(like.dtype).eps / 2)


def draw_directions(
    strategies: Sequence[tuple[Strategy, Sequence[int]]],
    generator: torch.Generator,
    like: Float[Tensor, "points 3"],
    *,
    stratified: bool = False,
    continued: bool = False,
) -> DirectionSamples:
    """Return directions for one or several independent estimates of the same integral.

    Each strategy comes with its number of directions in every estimate. Directions lie in the order of the
    estimates, within one in the order of the strategies, and are weighted by the power heuristic among the
    strategies of their own estimate. Without gradients: directions, densities and weights are constants of
    the estimators (detached sampling). Source: paper Eq. 5 with supplement 2.7.
    """
    with torch.no_grad():
        strategies = [(strategy, tuple(counts)) for strategy, counts in strategies if any(counts)]
        num_points = like.shape[0]
        if not strategies:
            none = like.new_zeros((num_points, 0))
            return DirectionSamples(like.new_zeros((num_points, 0, 3)), none, none, none, ())
        drawn = []
        for strategy, counts in strategies:
            shapes = [(num_points, count, strategy.num_uniforms) for count in counts]
            u = [
                draw_uniforms(shape, generator, like, stratified=stratified, continued=continued)
                for shape in shapes
            ]
            drawn.append(strategy.sample(torch.cat(u, dim=1)).split(counts, dim=1))
        # (estimate, strategy, directions) of the blocks in the order of the result.
        blocks = [
            (estimate, index, counts[estimate])
            for estimate in range(len(strategies[0][1]))
            for index, (_, counts) in enumerate(strategies)
            if counts[estimate]
        ]
        groups = tuple(length for _, _, length in blocks)
        omega_i = torch.cat([drawn[index][estimate] for estimate, index, _ in blocks], dim=1)
        densities = [strategy.pdf(omega_i) for strategy, _ in strategies]
        starts = [sum(groups[:block]) for block in range(len(groups))]
        own = torch.cat(
            [
                densities[index][:, start : start + length]
                for (_, index, length), start in zip(blocks, starts, strict=True)
            ],
            dim=1,
        )
        own = own.clamp_min(PDF_FLOOR)
        expected = own * _row(like, [length for length in groups for _ in range(length)])
        if len(strategies) == 1:
            mis_weight = torch.ones_like(own)
        else:
            total = torch.zeros_like(own)
            for density, (_, counts) in zip(densities, strategies, strict=True):
                rivals = [counts[estimate] for estimate, _, length in blocks for _ in range(length)]
                total += (density.clamp_min(PDF_FLOOR) * _row(like, rivals)).square()
            mis_weight = expected.square() / total
        return DirectionSamples(omega_i, own, mis_weight, mis_weight / expected, groups)


def _row(like: Tensor, numbers: Sequence[int]) -> Float[Tensor, " numbers"]:
    """Return numbers as a tensor; equal neighbours are filled in on the device."""
    runs = [(number, len(list(equal))) for number, equal in groupby(numbers)]
    return torch.cat([like.new_full((length,), number) for number, length in runs])

"""A grey card in one photograph settles what photographs under unknown light leave open.

A factor per channel on all albedos, with its inverse on the environments, changes hardly anything that a
photograph shows: only the highlights of dielectrics, whose reflectance at normal incidence is known.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from flashcache.errors import FlashCacheError
from flashcache.geometry.rays import Rays
from flashcache.physical.model import InverseModel

LEAST_SAMPLES = 4
"""Pixels of the card that must meet the surface: a median of fewer is a matter of chance."""
FACTOR_LIMITS = (0.1, 10.0)
"""A factor outside says that the card is not where it was said to be."""
REACH = 3.0
"""How far the nearest element may be from what a pixel shows, in sizes of an element."""
SURFACE_OPACITY = 0.9
MOST_CLAMPED = 0.05
"""Share of elements that would be whiter than white from which on the user is warned."""


class GreyCardError(FlashCacheError):
    """The card cannot be used; `code` is stable."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True, eq=False)
class Card:
    """Where a photograph shows a card, and what the card reflects."""

    rays: Rays
    """Through the card's pixels."""
    reflectance: float
    """Albedo of the card in all channels, 0..1."""


@dataclass(frozen=True, slots=True, eq=False)
class Scaled:
    """Albedo and light after the card's factor."""

    albedo: Float[Tensor, "elements 3"]
    sky: Float[Tensor, "lights cells 3"]
    findings: tuple[tuple[str, str], ...] = ()
    """Code and message of what the user should know; with an error nothing was scaled."""
    values: dict[str, float] = field(default_factory=dict)
    """For the log."""
    factor: Float[Tensor, "3"] | None = None
    """On albedos; None where nothing was scaled."""


def card_factor(albedo: Float[Tensor, "samples 3"], reflectance: float) -> Float[Tensor, "3"]:
    """Return the factor per channel that brings the card's fitted `albedo` to its `reflectance`.

    From the median over the samples, so that up to half of them may show something else. Raises
    `GreyCardError` for too few samples, values that are not finite, and a factor outside `FACTOR_LIMITS`.
    """
    if len(albedo) < LEAST_SAMPLES:
        raise GreyCardError(
            "grey_card.not_on_surface",
            f"only {len(albedo)} pixels of the grey card meet the reconstructed surface, and at least "
            f"{LEAST_SAMPLES} are needed; the card must lie on the object or on what it stands on, inside "
            "the mask",
        )
    # The mean of the two middle ones where the number is even.
    level = albedo.double().quantile(0.5, dim=0)
    factor = reflectance / level
    low, high = FACTOR_LIMITS
    if not bool(torch.isfinite(factor).all()) or bool((factor < low).any() or (factor > high).any()):
        red, green, blue = level.tolist()
        raise GreyCardError(
            "grey_card.factor_absurd",
            f"the surface under the grey card has a fitted albedo of {red:.3g}, {green:.3g}, {blue:.3g} "
            f"(red, green, blue) and the card is said to reflect {reflectance:g}: more than a factor of "
            f"{high:g} apart; look whether the box of --grey-card shows the card, evenly lit and not "
            "glossy, and whether the reflectance is right",
        )
    return factor.to(albedo.dtype)


def scale_to_card(
    albedo: Float[Tensor, "elements 3"],
    sky: Float[Tensor, "lights cells 3"],
    factor: Float[Tensor, "3"],
) -> Scaled:
    """Return `albedo` times `factor`, at most 1, and all environments `sky` over it.

    All lights get the inverse, for all of them light the same albedo.
    """
    scaled = albedo * factor
    clamped = float((scaled > 1.0).any(dim=-1).float().mean()) if len(scaled) else 0.0
    findings = []
    if clamped > MOST_CLAMPED:
        findings.append(
            (
                "grey_card.brighter_than_white",
                f"with the albedo that the grey card gives, {100.0 * clamped:.0f} % of the surface would "
                "reflect more light than reaches it, and were made white: the card may lie in a shadow, show "
                "a highlight, or reflect less than was said",
            )
        )
    red, green, blue = factor.tolist()
    values = {"card_red": red, "card_green": green, "card_blue": blue, "card_clamped": clamped}
    return Scaled(scaled.clamp_max(1.0), sky / factor, tuple(findings), values, factor)


def settle_by_card(
    model: InverseModel,
    card: Card | None,
    positions: Float[Tensor, "elements 3"],
    size: float,
    albedo: Float[Tensor, "elements 3"],
    sky: Float[Tensor, "lights cells 3"],
) -> Scaled:
    """Return the fitted `albedo` of elements of `size` and the environments, brought to the card's level.

    What prevents that becomes a finding, and then both are as they were; so they are without a card.
    """
    if card is None:
        return Scaled(albedo, sky)
    points = card_points(model, card.rays)
    try:
        factor = card_factor(albedo_at(points, positions, size, albedo), card.reflectance)
    except GreyCardError as error:
        message = f"the grey card was not used, and colours are known up to a factor as without it: {error}"
        return Scaled(albedo, sky, findings=((error.code, message),))
    return scale_to_card(albedo, sky, factor)


@torch.no_grad()
def card_points(model: InverseModel, rays: Rays) -> Float[Tensor, "points 3"]:
    """Return where rays meet the surface; those that meet none are left out."""
    rays = rays.select(rays.far > rays.near)
    if not len(rays):
        return rays.origins
    geometry = model.nerf.trace(rays, generator=None)
    share = geometry.weights / geometry.opacity.clamp_min(1e-6)[:, None]
    places = geometry.samples.positions.reshape(len(rays), -1, 3)
    return (share[..., None] * places).sum(dim=1)[geometry.opacity > SURFACE_OPACITY]


def albedo_at(
    points: Float[Tensor, "points 3"],
    positions: Float[Tensor, "elements 3"],
    size: float,
    albedo: Float[Tensor, "elements 3"],
) -> Float[Tensor, "samples 3"]:
    """Return the albedo of the element nearest to each point; points that have none near are left out."""
    if not len(points) or not len(positions):
        return albedo[:0]
    distance, index = cKDTree(positions.cpu().numpy()).query(points.cpu().numpy())
    near = np.atleast_1d(distance) <= REACH * size
    return albedo[torch.from_numpy(np.atleast_1d(index)[near]).to(albedo.device)]

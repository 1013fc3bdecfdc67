"""The uncertainty of materials given the photographs: a Gaussian approximation around the trained model.

The radiance that a surface point x sends to a camera depends on parameters of the point (`theta`) and of the
light (`beta`), which all points share. Linearised, with independent noise, the posterior is Gaussian, and the
light can be eliminated:

    A_x = J_theta' W J_theta + P,   B_x = J_theta' W J_beta,   G_x = A_x^-1 B_x
    S   = Q + s sum_x (J_beta' W J_beta - B_x' G_x)            information about the light
    cov(theta_x) = A_x^-1 + G_x S^-1 G_x'                      noise, and what the light leaves open

P and Q are the precisions of the priors. The parameters of a point are, in this order: log albedo (3),
metalness, perceptual roughness, tilt of the normal (2, radians), log scale of the light that other surfaces
send (3). docs/discussion/uncertainty.md has the derivation.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class Priors:
    """Standard deviations of the priors on materials, normals and light."""

    log_albedo: float = 1.0
    metalness: float = 0.3
    perceptual_roughness: float = 0.3
    tilt: float = 0.15
    """Error of a learned normal, radians."""
    log_near: float = 0.2
    """Error of the radiance that the cache returns for other surfaces."""
    log_light: float = 1.0
    """Of a patch of the environment."""
    independent_points: float = 200.0
    """Points whose residuals count as independent: the errors of neighbours are alike."""

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"prior {name} must be positive, got {getattr(self, name)}")

    def local(self, like: Tensor) -> Float[Tensor, "parameters"]:
        """Return the standard deviations of a point's parameters."""
        widths = [self.log_albedo] * 3 + [self.metalness, self.perceptual_roughness]
        return like.new_tensor(widths + [self.tilt] * 2 + [self.log_near] * 3)


@dataclass(frozen=True, slots=True, eq=False)
class LinearModel:
    """Derivatives of radiance at some points; a row is one colour channel of one photograph."""

    local: Float[Tensor, "points rows parameters"]
    light: Float[Tensor, "points rows patches"]
    weight: Float[Tensor, "points rows"]
    """1 / variance of the observation; zero where the point is not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """Contributions of points to the posterior, before they are combined."""

    inverse: Float[Tensor, "points parameters parameters"]
    """Covariance of a point's parameters under a known light."""
    gain: Float[Tensor, "points parameters patches"]
    """Response of a point's parameters to a change of the light, with the opposite sign."""
    information: Float[Tensor, "patches patches"]
    """Combined information of the points about the light."""
    observed: Float[Tensor, " points"]
    """1 for points that any photograph sees, else 0."""

    @staticmethod
    def join(parts: list["Elimination"]) -> "Elimination":
        """Return several batches of points as one."""
        return Elimination(
            torch.cat([part.inverse for part in parts]),
            torch.cat([part.gain for part in parts]),
            torch.stack([part.information for part in parts]).sum(dim=0),
            torch.cat([part.observed for part in parts]),
        )


def eliminate(model: LinearModel, priors: Priors) -> Elimination:
    """Return the parts of the posterior that each point contributes, in double precision."""
    local, light = model.local.double(), model.light.double()
    weight = model.weight.double()[..., None]
    precision = local.transpose(1, 2) @ (weight * local) + torch.diag(priors.local(local) ** -2)
    cross = local.transpose(1, 2) @ (weight * light)
    inverse = torch.linalg.inv(precision)
    gain = inverse @ cross
    flat = light.flatten(0, 1)
    total = flat.T @ (weight.flatten(0, 1) * flat) - (cross.transpose(1, 2) @ gain).sum(dim=0)
    return Elimination(inverse, gain, total, (model.weight.sum(dim=1) > 0.0).double())


@dataclass(frozen=True, slots=True, eq=False)
class MaterialUncertainty:
    """Posterior standard deviations of points' materials."""

    albedo: Float[Tensor, "points 3"]
    """Relative (of log albedo), without the factor per channel that no photograph determines."""
    albedo_from_light: Float[Tensor, "points 3"]
    """The part of it that is due to the unknown light."""
    metalness: Float[Tensor, " points"]
    perceptual_roughness: Float[Tensor, " points"]


def light_covariance(eliminated: Elimination, priors: Priors) -> Float[Tensor, "patches patches"]:
    """Return the posterior covariance of the light, given all points."""
    share = min(1.0, priors.independent_points / max(float(eliminated.observed.sum()), 1.0))
    known = torch.eye(eliminated.gain.shape[-1], dtype=eliminated.gain.dtype, device=eliminated.gain.device)
    return torch.linalg.inv(known / priors.log_light**2 + share * eliminated.information)


def material_uncertainty(eliminated: Elimination, priors: Priors) -> MaterialUncertainty:
    """Return the posterior of all points together.

    A factor on all albedo with its inverse on the light changes no photograph and is removed in every
    evaluation; so is the mean over the observed points of what the light does to albedo.
    """
    light = light_covariance(eliminated, priors)
    gain = eliminated.gain.clone()
    seen = eliminated.observed[:, None, None]
    common = (seen * gain[:, :3]).sum(dim=0) / seen.sum().clamp_min(1.0)
    gain[:, :3] -= seen * common
    from_light = ((gain @ light) * gain).sum(dim=-1).clamp_min(0.0)
    from_noise = eliminated.inverse.diagonal(dim1=1, dim2=2)
    total = (from_noise + from_light).sqrt().float()
    return MaterialUncertainty(
        albedo=total[:, :3],
        albedo_from_light=from_light[:, :3].sqrt().float(),
        metalness=total[:, 3],
        perceptual_roughness=total[:, 4],
    )

"""Errors of estimated cameras after alignment with the true ones by a similarity transform."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray


@dataclass(frozen=True, kw_only=True, slots=True)
class Similarity:
    """x -> scale * rotation x + shift."""

    scale: float
    rotation: Float[ndarray, "3 3"]
    shift: Float[ndarray, " 3"]

    def poses(self, estimated: Float[ndarray, "cameras 4 4"]) -> Float[ndarray, "cameras 4 4"]:
        """Return camera-to-world matrices in the other world; they stay rotations and positions."""
        moved = estimated.copy()
        moved[:, :3, :3] = self.rotation @ estimated[:, :3, :3]
        moved[:, :3, 3] = self.scale * estimated[:, :3, 3] @ self.rotation.T + self.shift
        return moved

    def inverse(self) -> "Similarity":
        """Return the way back."""
        back = self.rotation.T
        return Similarity(scale=1.0 / self.scale, rotation=back, shift=-back @ self.shift / self.scale)


def similarity(estimated: Float[ndarray, "points 3"], true: Float[ndarray, "points 3"]) -> Similarity:
    """Return the similarity that brings the found points closest to the true ones (least squares).

    Source: Umeyama 1991, least-squares estimation of transformation parameters, Eq. 40 to 42.
    """
    middle, target = estimated.mean(axis=0), true.mean(axis=0)
    covariance = (true - target).T @ (estimated - middle) / len(estimated)
    left, values, right = np.linalg.svd(covariance)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ sign @ right
    scale = (values * np.diag(sign)).sum() / ((estimated - middle) ** 2).sum(axis=1).mean()
    return Similarity(scale=float(scale), rotation=rotation, shift=target - scale * rotation @ middle)


def pose_errors(
    estimated: Float[ndarray, "cameras 4 4"], true: Float[ndarray, "cameras 4 4"]
) -> tuple[Float[ndarray, " cameras"], Float[ndarray, " cameras"]]:
    """Return the angle [deg] between found and true orientation, and the distance of the centres.

    Both are camera-to-world with the same camera axes. The similarity that brings the found centres closest
    to the true ones is applied first; distances are shares of the true cameras' median distance from their
    mean.
    """
    centres = true[:, :3, 3]
    moved = similarity(estimated[:, :3, 3], centres).poses(estimated)
    radius = np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=-1))
    relative = np.einsum("cji,cjk->cik", moved[:, :3, :3], true[:, :3, :3])
    cosine = np.clip(0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0), -1.0, 1.0)
    return np.degrees(np.arccos(cosine)), np.linalg.norm(moved[:, :3, 3] - centres, axis=-1) / radius

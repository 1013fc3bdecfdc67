"""Errors of estimated cameras after alignment with the true ones by a similarity transform."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def pose_errors(
    found: Float[ndarray, "cameras 4 4"], true: Float[ndarray, "cameras 4 4"]
) -> tuple[Float[ndarray, " cameras"], Float[ndarray, " cameras"]]:
    """Return the angle [deg] between found and true orientation, and the distance of the centres.

    Both are camera-to-world with the same camera axes. The similarity that brings the found centres closest
    to the true ones (least squares) is applied first; distances are shares of the true cameras' median
    distance from their mean.
    Source: Umeyama 1991, least-squares estimation of transformation parameters, Eq. 40 to 42.
    """
    mine, theirs = found[:, :3, 3], true[:, :3, 3]
    middle, target = mine.mean(axis=0), theirs.mean(axis=0)
    covariance = (theirs - target).T @ (mine - middle) / len(mine)
    left, values, right = np.linalg.svd(covariance)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ sign @ right
    scale = (values * np.diag(sign)).sum() / ((mine - middle) ** 2).sum(axis=1).mean()
    moved = scale * (mine - middle) @ rotation.T + target
    radius = np.median(np.linalg.norm(theirs - target, axis=-1))
    relative = np.einsum("cji,cjk->cik", rotation @ found[:, :3, :3], true[:, :3, :3])
    cosine = np.clip(0.5 * (np.trace(relative, axis1=1, axis2=2) - 1.0), -1.0, 1.0)
    return np.degrees(np.arccos(cosine)), np.linalg.norm(moved - theirs, axis=-1) / radius

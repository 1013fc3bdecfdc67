"""The graph of neighbouring surface elements, along which evidence is pooled and values are smoothed."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree
from torch import Tensor

from flashcache.polish.elements import Elements

NEIGHBOURS = 10
REACH = 2.5
"""Standard deviation of the weight by distance, in sizes of an element."""
FACING = 0.0
"""Cosine between normals from which elements are neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The nearest elements of each, and how near they are."""

    index: Int[Tensor, "elements neighbours"]
    weight: Float[Tensor, "elements neighbours"]
    """By distance, 0..1; zero where surfaces face away from each other."""

    @classmethod
    def of(cls, elements: Elements) -> "Neighbours":
        """Return the graph of elements; each has `NEIGHBOURS` others, or as many as there are."""
        places = elements.positions.numpy()
        count = min(NEIGHBOURS, max(len(places) - 1, 0))
        distance, index = cKDTree(places).query(places, count + 1)
        near = torch.from_numpy(np.reshape(index, (len(places), -1))[:, 1:])
        away = torch.from_numpy(np.reshape(distance, (len(places), -1))[:, 1:]).float()
        weight = torch.exp(-0.5 * (away / (REACH * elements.size)).square())
        alike = (elements.normal[near] * elements.normal[:, None]).sum(dim=-1) > FACING
        return cls(near, weight * alike)

    def among_alike(self, values: Float[Tensor, "elements channels"], width: float) -> "Neighbours":
        """Return the graph with weights that fall with the difference of `values`, over `width`."""
        apart = (values[self.index] - values[:, None]).square().sum(dim=-1)
        return Neighbours(self.index, self.weight * torch.exp(-0.5 * apart / width**2))

    def pooled(
        self, values: Float[Tensor, "elements channels"], amount: Float[Tensor, " elements"], times: int
    ) -> Float[Tensor, "elements channels"]:
        """Return means over neighbourhoods that `times` steps reach, weighted by `amount`."""
        step = self._step()
        both = torch.cat([values * amount[:, None], amount[:, None]], dim=-1).double().numpy()
        for _ in range(times):
            both = step @ both
        summed = torch.from_numpy(both)
        return (summed[:, :-1] / summed[:, -1:].clamp_min(1e-12)).to(values.dtype)

    def _step(self) -> csr_matrix:
        count, near = self.index.shape
        rows = np.repeat(np.arange(count), near)
        parts = (self.weight.reshape(-1).numpy(), (rows, self.index.reshape(-1).numpy()))
        step = csr_matrix(parts, shape=(count, count))
        step = step.maximum(step.T)
        step.setdiag(1.0)
        return csr_matrix(step.multiply(1.0 / np.asarray(step.sum(axis=1))))

"""Vertices moved to where the trained density's surface is.

Marching cubes finds where density is that of a level; a picture's ray ends where optical depth has reached a
value. The two differ by a fraction of a cell, more where density rises slowly.
"""

import numpy as np
import torch
from flashcache.evaluation.threads import on_all_cores
from flashcache.physical.model import InverseModel
from jaxtyping import Float
from numpy.typing import NDArray
from scipy import sparse
from torch import Tensor

from lambent_asset.mesh.atlas import angle_weighted_normals
from lambent_asset.mesh.mesh import Mesh, crosses_of, edges_of, joined

OUTSIDE_CELLS, INSIDE_CELLS = 1.5, 2.5
"""Search distance from the mesh, in cells."""
NUM_PLACES = 24
"""Density samples along that distance."""
END_DEPTH = 0.25
"""Optical depth along the normal at which the surface is.

Rays that meet the surface head on go deeper before half of their light is lost, those along the outline end
before. Of the values tried this one has median distances of a fifth of a pixel from the volume's and outlines
nearly as close to the volume's as those of the level of density (docs/benchmarks/asset.md).
"""
RISE = 1.5
"""Outside the mesh, density that is this many times the least between is another surface's."""
FAINT = 0.05
"""Least optical depth that can move a vertex."""
NUM_SMOOTHINGS = 2
"""Passes that even out the shifts of neighbours, each halfway to their mean."""
NUM_RELAXATIONS = 2
"""Steps by which vertices are spread evenly along the surface."""
CHUNK_POINTS = 8192


def settled_mesh(model: InverseModel, mesh: Mesh) -> Mesh:
    """Return the mesh with vertices moved along their normals to where rays end in the density.

    Vertices are first spread evenly along the surface, for marching cubes leaves slivers, which a shift turns
    over. Shifts are evened out between neighbours. A vertex stays where its shift would turn a triangle over.
    """
    mean = _mean_of_neighbours(len(mesh.vertices), mesh.faces)
    vertices: NDArray[np.floating] = np.asarray(mesh.vertices, np.float64)
    for _ in range(NUM_RELAXATIONS):
        vertices = _relaxed(vertices, mesh.faces, mean)
    normals = angle_weighted_normals(vertices, mesh.faces)
    shift = end_of_rays(model, vertices, normals, mesh.cell)
    for _ in range(NUM_SMOOTHINGS):
        shift = 0.5 * (shift + mean @ shift)
    moved = without_folds(vertices, vertices - shift[:, None] * normals, mesh.faces)
    return Mesh(moved.astype(np.float32), mesh.faces, mesh.cell)


@torch.no_grad()
def end_of_rays(
    model: InverseModel, points: NDArray[np.floating], outwards: NDArray[np.floating], cell: float
) -> NDArray[np.float64]:
    """Return how far below each point, against `outwards`, optical depth reaches `END_DEPTH`; scene units.

    Negative: above it. Where all of the matter on the way has less than twice that depth it is half of what
    there is; 0 where there is next to nothing. Matter above the point from which it is separated by a gap
    does not count, so that surfaces that nearly touch stay apart.
    """
    device = next(model.parameters()).device
    step = (OUTSIDE_CELLS + INSIDE_CELLS) * cell / NUM_PLACES
    below = (torch.arange(NUM_PLACES, device=device) + 0.5) * step - OUTSIDE_CELLS * cell

    def ends(start: int) -> Tensor:
        chunk = [
            torch.from_numpy(np.ascontiguousarray(values[start : start + CHUNK_POINTS], np.float32))
            for values in (points, outwards)
        ]
        place, direction = (values.to(device) for values in chunk)
        places = place[:, None] - below[:, None] * direction[:, None]
        density = model.nerf.density.density(places.reshape(-1, 3)).reshape(len(place), NUM_PLACES)
        return depth_reached(own_matter(density, int((below < 0.0).sum())) * step, below, step)

    parts = on_all_cores(ends, range(0, len(points), CHUNK_POINTS), device)
    return torch.cat(parts).cpu().numpy().astype(np.float64)


def own_matter(density: Float[Tensor, "rays samples"], num_above: int) -> Float[Tensor, "rays samples"]:
    """Return `density` without the matter above the mesh (the first `num_above` samples) beyond a gap."""
    outwards = density[:, :num_above].flip(-1)
    beyond = (outwards > RISE * outwards.cummin(dim=-1).values).cummax(dim=-1).values
    return torch.cat([(outwards * ~beyond).flip(-1), density[:, num_above:]], dim=-1)


def depth_reached(
    depth: Float[Tensor, "rays samples"], below: Float[Tensor, " samples"], step: float
) -> Float[Tensor, " rays"]:
    """Return the place at which the sum of `depth` is the wanted one.

    It grows linearly within a sample, whose width is `step`; `below` are their middles.
    """
    total = depth.cumsum(dim=-1)
    whole = total[:, -1:]
    wanted = (0.5 * whole).clamp_max(END_DEPTH)
    index = (total < wanted).sum(dim=-1, keepdim=True).clamp_max(depth.shape[-1] - 1)
    here = depth.gather(-1, index)
    share = (wanted - (total.gather(-1, index) - here)) / here.clamp_min(1e-12)
    place = below[index[:, 0]] + (share[:, 0].clamp(0.0, 1.0) - 0.5) * step
    return torch.where(whole[:, 0] > FAINT, place, torch.zeros_like(place))


def without_folds(
    before: NDArray[np.floating], after: NDArray[np.floating], faces: NDArray[np.integer]
) -> NDArray[np.floating]:
    """Return `after`, but the places `before` for vertices of triangles that would turn over."""
    before, moved = np.asarray(before, np.float64), np.array(after, np.float64)
    plain = crosses_of(before, faces)
    # Each round takes back at least one vertex, and most of what is wrong in the first two.
    for _ in range(8):
        over = (plain * crosses_of(moved, faces)).sum(-1) < 0.0
        if not over.any():
            return moved
        back = np.unique(faces[over])
        moved[back] = before[back]
    over = (plain * crosses_of(moved, faces)).sum(-1) < 0.0
    return moved if not over.any() else before


def _relaxed(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], mean: sparse.csr_array
) -> NDArray[np.floating]:
    """Return vertices halfway to the mean of their neighbours, but for the part along their normals."""
    normals = angle_weighted_normals(vertices, faces).astype(np.float64)
    step = 0.5 * (mean @ vertices - vertices)
    step -= (step * normals).sum(-1, keepdims=True) * normals
    return without_folds(vertices, vertices + step, faces)


def _mean_of_neighbours(num_vertices: int, faces: NDArray[np.integer]) -> sparse.csr_array:
    """Return the matrix that takes means over the neighbours of every vertex."""
    neighbours = joined(edges_of(faces), num_vertices)
    return sparse.diags_array(1.0 / np.maximum(neighbours.sum(axis=1), 1.0)) @ neighbours

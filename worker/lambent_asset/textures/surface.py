"""The surface of a trained model as charts on an atlas: a position and a normal for every covered texel.

The texels are those of baked transport and of what the model itself says, whose detail is coarser than the
photographs'; textures from photographs have a finer picture of the same charts.

The mesh has the atlas; texel positions are moved from it along the normal to the trained density,
so that materials and rays of a bake belong to the trained surface.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from flashcache.config import ExportConfig
from flashcache.evaluation.threads import on_all_cores
from flashcache.physical.model import InverseModel
from lambent_core.errors import WorkerError
from lambent_core.scene import View
from lambent_relight.baked.raster import interpolate, rasterise_uv
from numpy.typing import NDArray

from lambent_asset.mesh.atlas import angle_weighted_normals, size_within, unit, unwrap
from lambent_asset.mesh.mesh import Corner, crosses_of, occupied_box
from lambent_asset.mesh.mesh_shape import build_shape

OUTSIDE_CELLS, INSIDE_CELLS = 1.5, 2.5
"""Search distance from the mesh, in marching-cubes cells."""
NUM_PLACES = 16
"""Density samples along that distance."""
UPRIGHT = 0.2
"""A learned normal keeps at least about this cosine with the mesh's normal."""
FAINT = 1e-3
"""Weight of the place on the mesh itself, so that a ray through empty space stays there."""
CHUNK_POINTS = 8192


@dataclass(frozen=True, slots=True, eq=False)
class AtlasSurface:
    """A mesh with an atlas. World coordinates (z up); u right and v down from the atlas's top row."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32]
    normals: NDArray[np.float32]
    """Unit, outwards, per vertex."""
    size: int
    """Texels along each side of the atlas at the model's resolution, which is the transport's."""
    texel_index: NDArray[np.int32]
    """Row-major place of each covered texel, ascending."""
    positions: NDArray[np.float32]
    """Of covered texels, on the trained surface."""
    texel_normals: NDArray[np.float32]
    """Of covered texels, unit, outwards."""
    cell: float
    """Width of the cells that the mesh was found with, scene units."""
    unseen: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    """Of covered texels, whether no photograph shows them; empty where that is not known."""
    mesh_error: float = 0.0
    """Distance of the mesh from that before triangles were saved (`mesh_decimation.adapted`), scene units."""

    @property
    def texel_size(self) -> float:
        """Return the root of the mean area of a covered texel on the surface, scene units."""
        area = 0.5 * np.linalg.norm(crosses_of(self.vertices, self.faces), axis=1).sum()
        return float(np.sqrt(area / len(self.texel_index)))


def build_surface(
    model: InverseModel,
    config: ExportConfig,
    *,
    box: tuple[Corner, Corner] | None = None,
    pixel_size: float = 0.0,
    views: tuple[View, ...] = (),
) -> AtlasSurface:
    """Return the surface of `model` with an atlas of at most `config.transport_size` texels a side.

    `box` is where to look, by default the box around all matter; `pixel_size` is what a pixel of the
    photographs covers at the object (scene units, 0: unknown); `views` are the photographs of the training.
    What none of them shows is smooth: it has the mesh's places and normals, not those of the density. Raises
    WorkerError where there is no surface.
    """
    shape = build_shape(model, config, box or occupied_box(model), pixel_size=pixel_size, views=views)
    mesh = shape.mesh
    charts = unwrap(mesh, config.transport_size)
    size = size_within(charts, config.transport_size)
    vertices = mesh.vertices[charts.source]
    plain = angle_weighted_normals(mesh.vertices, mesh.faces)
    # Copies of a vertex on both sides of a seam must have one normal, or the seam shows.
    on_surface = settled(model, mesh.vertices, plain, mesh.cell)
    normals = upright(learned_normals(model, on_surface), plain)
    normals = np.where(shape.unseen[:, None], plain, normals)[charts.source]
    fragments = rasterise_uv(charts.uv, charts.faces, size)
    index = np.flatnonzero(fragments.covered).astype(np.int32)
    if not len(index):
        raise WorkerError("export.atlas", "no texel is covered by the surface; raise export.transport_size")
    outwards = unit(interpolate(fragments, charts.faces, plain[charts.source]))
    on_mesh = interpolate(fragments, charts.faces, vertices)
    unknown = shape.unseen[charts.source].astype(np.float32)[:, None]
    unseen = interpolate(fragments, charts.faces, unknown)[:, 0] > 0.5
    positions = np.where(unseen[:, None], on_mesh, settled(model, on_mesh, outwards, mesh.cell))
    learned = upright(learned_normals(model, positions), outwards)
    return AtlasSurface(
        vertices=vertices,
        faces=charts.faces,
        uv=charts.uv,
        normals=normals,
        size=size,
        texel_index=index,
        positions=positions,
        texel_normals=np.where(unseen[:, None], outwards, learned),
        unseen=unseen,
        mesh_error=shape.error,
        cell=mesh.cell,
    )


@torch.no_grad()
def settled(
    model: InverseModel,
    positions: NDArray[np.floating],
    outwards: NDArray[np.floating],
    cell: float,
) -> NDArray[np.float32]:
    """Return the mean place at which a short ray against `outwards` ends in the matter near each point.

    The mean is over the render weights (paper Eq. 3) divided by their sum; a ray that meets next to nothing
    stays at the point. `cell` is the width of the cells the points were found with, scene units.
    """
    device = next(model.parameters()).device
    length = (OUTSIDE_CELLS + INSIDE_CELLS) * cell
    inwards = ((torch.arange(NUM_PLACES, device=device) + 0.5) / NUM_PLACES) * length - OUTSIDE_CELLS * cell
    beside_mesh = FAINT * torch.exp(-2.0 * (inwards / cell).square())

    def end(chunk: tuple[torch.Tensor, ...]) -> torch.Tensor:
        points, direction = chunk
        places = points[:, None] - inwards[:, None] * direction[:, None]
        density = model.nerf.density.density(places.reshape(-1, 3)).reshape(len(points), NUM_PLACES)
        depth = density * (length / NUM_PLACES)
        before = torch.nn.functional.pad(depth[:, :-1].cumsum(dim=-1), (1, 0))
        weights = -torch.expm1(-depth) * torch.exp(-before) + beside_mesh
        shift = (weights * inwards).sum(dim=-1, keepdim=True) / weights.sum(dim=-1, keepdim=True)
        return points - shift * direction

    return torch.cat(on_all_cores(end, _chunks(device, positions, outwards), device)).cpu().numpy()


@torch.no_grad()
def learned_normals(model: InverseModel, positions: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the normals that shade the model at points."""
    device = next(model.parameters()).device

    def normals(chunk: tuple[torch.Tensor, ...]) -> torch.Tensor:
        return model.nerf.normals(chunk[0], model.nerf.density(chunk[0]).hidden)

    return torch.cat(on_all_cores(normals, _chunks(device, positions), device)).cpu().numpy()


def upright(learned: NDArray[np.float32], plain: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return unit learned normals, leaned towards the mesh's where they point away from it or are nothing."""
    learned = unit(learned)
    cosine = (learned * plain).sum(-1, keepdims=True)
    return unit(learned + np.maximum(0.0, UPRIGHT - cosine) * plain).astype(np.float32)


def _chunks(device: torch.device, *arrays: NDArray[np.floating]) -> Iterator[tuple[torch.Tensor, ...]]:
    for start in range(0, len(arrays[0]), CHUNK_POINTS):
        parts = (np.ascontiguousarray(values[start : start + CHUNK_POINTS], np.float32) for values in arrays)
        yield tuple(torch.from_numpy(part).to(device) for part in parts)

"""Atlas, positions, normals and materials of a given mesh, as of one that was extracted from the model.

Texture coordinates of the file are kept where they are an atlas: every place of it belongs to one place of
the surface. Otherwise the mesh is unwrapped, and the maps are looked up at their own coordinates. Parts
without a material take theirs from the trained model, from the nearest matter.
"""

from dataclasses import dataclass

import numpy as np
import torch
from flashcache.color import perceptual_roughness_from_alpha
from flashcache.config import ExportConfig
from flashcache.physical.model import InverseModel
from lambent_core.errors import UsageError
from lambent_relight.baked.raster import Fragments, interpolate, nearest_texel, rasterise_uv
from numpy.typing import NDArray

from lambent_asset.given_mesh.fine_albedo import albedo_size, fine_albedo
from lambent_asset.given_mesh.given_charts import charts_of
from lambent_asset.given_mesh.glb_file import GivenMesh
from lambent_asset.given_mesh.outwards import turned_outwards
from lambent_asset.mesh.atlas import (
    Unwrapped,
    angle_weighted_normals,
    size_within,
    tangents,
    unit,
)
from lambent_asset.mesh.mesh import Corner, crosses_of, data_resolution
from lambent_asset.textures.photo_albedo import LARGEST_SIZE
from lambent_asset.textures.surface import AtlasSurface, learned_normals, settled, upright
from lambent_asset.textures.textures import TextureSet, tangent_normals
from lambent_asset.transport.transport_bounce import Reflectors
from lambent_asset.transport.transport_rays import BakedSurface

LARGEST, SMALLEST = 3.0, 1.0 / 20.0
"""Diagonals of the trained object that a given mesh may have."""
CHUNK_POINTS = 32768


@dataclass(frozen=True, slots=True, eq=False)
class GivenSurface:
    """A given mesh on an atlas, with its materials."""

    surface: AtlasSurface
    reflectors: Reflectors
    """Of covered texels."""
    kept_uv: bool
    """Whether the atlas is the file's."""
    from_model: float
    """Share of the covered texels whose materials come from the trained model."""
    albedo: NDArray[np.float32]
    """The texture [size, size, 3], linear Rec. 709, of a size of its own."""
    num_turned: int
    """Closed pieces that were inside out, and are not any more."""

    @property
    def covered(self) -> BakedSurface:
        """Return the covered texels as a bake of transport takes them."""
        surface = self.surface
        normals = surface.texel_normals.astype(np.float32)
        return BakedSurface(surface.size, surface.texel_index, surface.positions, normals)

    def textures(self, occlusion: NDArray[np.float32]) -> TextureSet:
        """Return the textures, given the occlusion of covered texels (0..1)."""
        owner = nearest_texel(self.surface.texel_index, self.surface.size)
        return TextureSet(
            albedo=self.albedo,
            perceptual_roughness=self.reflectors.perceptual_roughness[owner],
            metalness=self.reflectors.metalness[owner],
            occlusion=np.clip(occlusion, 0.0, 1.0).astype(np.float32).reshape(-1, 1)[owner],
            tangent_normal=tangent_normals(self.surface)[owner],
        )


def check_place(given: GivenMesh, box: tuple[Corner, Corner], name: str) -> None:
    """Raise UsageError `mesh_file.place` for a mesh of another size or at another place than the object.

    `box` is around the trained object. A mesh may be up to three times as large, and as small as a twentieth;
    half of its vertices must lie in the box enlarged by half its diagonal on every side.
    """
    low, high = np.array(box[0]), np.array(box[1])
    diagonal = float(np.linalg.norm(high - low))
    ratio = float(np.linalg.norm(np.ptp(given.vertices, axis=0))) / diagonal
    if not SMALLEST <= ratio <= LARGEST:
        raise UsageError(
            "mesh_file.place",
            f'"{name}" is {ratio:.3g} times as large as the object; export it in the units of mesh/asset.glb '
            "(one scene unit is one metre, with transforms applied)",
        )
    inside = (given.vertices > low - 0.5 * diagonal) & (given.vertices < high + 0.5 * diagonal)
    share = float(inside.all(axis=1).mean())
    if share < 0.5:
        middle = ", ".join(f"{value:.3g}" for value in given.vertices.mean(axis=0))
        expected = ", ".join(f"{value:.3g}" for value in 0.5 * (low + high))
        raise UsageError(
            "mesh_file.place",
            f'"{name}" lies around ({middle}), the object around ({expected}), z up; move it back, and '
            "export it with +y up",
        )


def given_surface(
    model: InverseModel,
    given: GivenMesh,
    config: ExportConfig,
    *,
    box: tuple[Corner, Corner],
    pixel_size: float,
) -> GivenSurface:
    """Return `given` on an atlas of at most `config.transport_size` texels.

    Materials are its maps', or the model's where it has none. The albedo texture has `config.atlas_size`
    texels a side, or (0) as many as the file's pictures, up to what the tier allows (`LARGEST_SIZE`).

    Raises WorkerError `export.atlas` where it cannot be unwrapped.
    """
    given, num_turned = turned_outwards(given)
    geometric = _geometric_normals(given)
    missing = np.linalg.norm(given.normals, axis=1, keepdims=True) < 0.5
    normals = np.where(missing, geometric, given.normals)
    charts, kept = charts_of(given, config.transport_size)
    size = size_within(charts, config.transport_size)
    vertices, uv = given.vertices[charts.source], charts.uv
    fragments = rasterise_uv(uv, charts.faces, size)
    index = np.flatnonzero(fragments.covered).astype(np.int32)
    plain = unit(interpolate(fragments, charts.faces, normals[charts.source])).astype(np.float32)
    positions = interpolate(fragments, charts.faces, vertices)
    part = given.part_of_face[fragments.face[fragments.covered]]
    look = _Lookup(given, normals, charts, fragments, size)

    side = max(high - low for low, high in zip(*box, strict=True))
    cell = side / data_resolution(model, *box, pixel_size=pixel_size, limit=config.mesh_resolution)
    reflectors, shading = _from_maps(given, look, part, plain)
    bare = np.array([maps is None for maps in given.maps])[part]
    if bare.any():
        outwards = unit(interpolate(fragments, charts.faces, geometric[charts.source])).astype(np.float32)
        _fill_from_model(model, reflectors, shading, bare, positions, outwards, cell)
    facing = unit(crosses_of(vertices, charts.faces)[fragments.face[fragments.covered]]).astype(np.float32)
    surface = AtlasSurface(
        vertices=vertices,
        faces=charts.faces,
        uv=uv,
        normals=normals[charts.source],
        size=size,
        texel_index=index,
        positions=positions,
        texel_normals=upright(shading, facing),
        cell=cell,
    )
    albedo = reflectors.albedo[nearest_texel(index, size)]
    fine = config.atlas_size or albedo_size(
        given, kept_uv=kept, least=size, most=LARGEST_SIZE[config.transport_tier]
    )
    if fine != size:
        albedo = fine_albedo(given, charts, albedo, fine)
    return GivenSurface(surface, reflectors, kept, float(bare.mean()), albedo, num_turned)


def _geometric_normals(given: GivenMesh) -> NDArray[np.float32]:
    """Return the normals of the triangles as means at the vertices; vertices at one place have one normal."""
    places, number = np.unique(given.vertices, axis=0, return_inverse=True)
    number = number.reshape(-1)
    return angle_weighted_normals(places, number[given.faces].astype(np.int32))[number]


class _Lookup:
    """Where every covered texel lies in the file's own texture coordinates."""

    def __init__(
        self,
        given: GivenMesh,
        normals: NDArray[np.float32],
        charts: Unwrapped,
        fragments: Fragments,
        size: int,
    ) -> None:
        self.uv = interpolate(fragments, charts.faces, given.uv[charts.source])
        frame = tangents(given.vertices, given.faces, given.uv, normals)[charts.source]
        self._frame = interpolate(fragments, charts.faces, frame)
        self.size = size

    def world(
        self, local: NDArray[np.float32], plain: NDArray[np.float32], some: NDArray[np.bool_]
    ) -> NDArray:
        """Return tangent-space normals [texel, 3] of the texels `some` in world axes, unit."""
        frame = self._frame[some]
        along = unit(frame[:, :3])
        across = np.sign(frame[:, 3:]) * np.cross(plain[some], along)
        return unit(local[:, :1] * along + local[:, 1:2] * across + local[:, 2:] * plain[some])


def _from_maps(
    given: GivenMesh, look: _Lookup, part: NDArray[np.int32], plain: NDArray[np.float32]
) -> tuple[Reflectors, NDArray[np.float32]]:
    """Return materials and shading normals of the texels of parts that have maps; zeros elsewhere."""
    count = len(part)
    albedo, roughness, metalness = (np.zeros((count, n), np.float32) for n in (3, 1, 1))
    shading = plain.copy()
    for number, maps in enumerate(given.maps):
        some = part == number
        if maps is None or not some.any():
            continue
        fitting = maps.reduced(look.size)
        uv = look.uv[some]
        albedo[some] = fitting.albedo_at(uv)
        roughness[some], metalness[some] = fitting.gloss_at(uv)
        bent = fitting.normal_at(uv)
        if bent is not None:
            shading[some] = look.world(bent, plain, some)
    return Reflectors(albedo, roughness, metalness), shading


@torch.no_grad()
def _fill_from_model(
    model: InverseModel,
    reflectors: Reflectors,
    shading: NDArray[np.float32],
    bare: NDArray[np.bool_],
    positions: NDArray[np.float32],
    outwards: NDArray[np.float32],
    cell: float,
) -> None:
    """Write the model's materials and normals into the rows `bare`, from the nearest matter."""
    places = settled(model, positions[bare], outwards[bare], cell)
    shading[bare] = upright(learned_normals(model, places), outwards[bare])
    device = next(model.parameters()).device
    rows = np.flatnonzero(bare)
    for start in range(0, len(rows), CHUNK_POINTS):
        some = rows[start : start + CHUNK_POINTS]
        learned = model.materials(torch.from_numpy(places[start : start + CHUNK_POINTS]).to(device))
        reflectors.albedo[some] = learned.albedo.cpu().numpy()
        roughness = perceptual_roughness_from_alpha(learned.alpha).cpu().numpy()
        reflectors.perceptual_roughness[some] = roughness.reshape(-1, 1)
        reflectors.metalness[some] = learned.metalness.cpu().numpy().reshape(-1, 1)

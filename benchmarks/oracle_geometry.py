"""A closed surface with materials, fused from the true distances, normals and masks of a scene.

It stands in for the scene's own meshes where rays leave the surface. Pixels that see more than one surface
are left out: their distance is a mean. What no camera sees is taken to be solid as far as the silhouettes of
all views allow.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from lambent_core.scene import Camera, View
from numpy import ndarray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

CHUNK = 1 << 19
BLOCK = 8
"""Grid points along the side of a block in the first look at the outlines."""
CONSISTENT_NEIGHBOURS = 3
"""Neighbours that must lie on a pixel's tangent plane before the pixel counts as seeing one surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Proxy:
    """Triangles in world coordinates, counter-clockwise seen from outside, and the truth at vertices."""

    vertices: Float[ndarray, "vertices 3"]
    faces: Int[ndarray, "faces 3"]
    normals: Float[ndarray, "vertices 3"]
    albedo: Float[ndarray, "vertices 3"]
    perceptual_roughness: Float[ndarray, "vertices 1"]
    metalness: Float[ndarray, "vertices 1"]
    seen_share: float
    """Share of the vertices that a test view sees; the others have the material of the nearest seen one."""


def pixel_rays(camera: Camera) -> Float[ndarray, "height width 3"]:
    """Return unit world directions through all pixel centres."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = np.stack(
        [
            (columns - camera.centre_x) / camera.focal_x,
            -(rows - camera.centre_y) / camera.focal_y,
            -np.ones_like(rows),
        ],
        axis=-1,
    )
    world = local @ camera.camera_to_world[:3, :3].T
    return world / np.linalg.norm(world, axis=-1, keepdims=True)


def surface_points(view: View) -> Float[ndarray, "height width 3"]:
    """Return the points that a test view's pixel centres see; the camera's position where there is none."""
    return view.camera.position + view.truth["distance"] * pixel_rays(view.camera)


def single_surface(view: View) -> Bool[ndarray, "height width"]:
    """Return which pixels are covered wholly by one surface, judged by their neighbours' distances."""
    points, normal = surface_points(view), view.truth["normal"][..., :3]
    covered = view.truth["normal"][..., 3] > 0.99
    height, width = covered.shape
    pixel = view.truth["distance"][..., 0] / view.camera.focal_x
    facing = np.abs((normal * pixel_rays(view.camera)).sum(axis=-1))
    # A neighbour on a slightly curved surface leaves the plane by less than a quarter of its distance.
    bound = 0.25 * pixel / np.maximum(facing, 0.2)
    padded, inside = np.pad(points, ((1, 1), (1, 1), (0, 0))), np.pad(covered, 1)
    count = np.zeros(covered.shape, int)
    for row in range(3):
        for column in range(3):
            if row == column == 1:
                continue
            near = (slice(row, row + height), slice(column, column + width))
            off = np.abs((normal * (padded[near] - points)).sum(axis=-1))
            count += (off < bound) & inside[near]
    return covered & (count >= CONSISTENT_NEIGHBOURS)


def pixel_of(camera: Camera, points: Float[ndarray, "points 3"]) -> Int[ndarray, " points"]:
    """Return the flat index of the pixel in which each point lies, -1 outside the picture."""
    intrinsic = np.array(
        [
            [camera.focal_x, 0.0, -camera.centre_x],
            [0.0, -camera.focal_y, -camera.centre_y],
            [0.0, 0.0, -1.0],
        ]
    )
    matrix = (intrinsic @ camera.camera_to_world[:3, :3].T).astype(points.dtype)
    x, y, depth = matrix @ points.T - (matrix @ camera.position.astype(points.dtype))[:, None]
    depth = np.maximum(depth, 1e-9)
    column, row = np.floor(x / depth), np.floor(y / depth)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return np.where(inside, row * camera.width + column, -1.0).astype(np.int64)


def fuse(
    test: Sequence[View],
    silhouettes: Sequence[View],
    box_min: tuple[float, float, float],
    box_max: tuple[float, float, float],
    resolution: int = 256,
) -> Proxy:
    """Return the surface that the true maps of `test` and the outlines of `silhouettes` describe.

    `resolution` counts cells along the longest side of the box.
    """
    low, high = np.array(box_min), np.array(box_max)
    cell = float((high - low).max()) / resolution
    shape = np.ceil((high - low) / cell).astype(int) + 1
    active = _inside_all_outlines(silhouettes, low, cell, shape)
    truncation = 2.0 * cell
    field = np.full(shape.prod(), truncation, np.float32)
    field[active] = _signed_distance(test, low + cell * _grid_points(active, shape), truncation)
    # Space around the grid closes the surface where matter touches the box.
    padded = np.pad(field.reshape(shape), 1, constant_values=truncation)
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="descent")
    return _with_materials(low + (vertices - 1.0) * cell, faces, test, tolerance=2.0 * truncation)


def _grid_points(index: Int[ndarray, " points"], shape: Int[ndarray, "3"]) -> Float[ndarray, "points 3"]:
    return np.stack(np.unravel_index(index, shape), axis=-1).astype(np.float64)


def _chunks(count: int) -> Iterator[slice]:
    return (slice(start, start + CHUNK) for start in range(0, count, CHUNK))


def _inside_all_outlines(
    views: Sequence[View], low: Float[ndarray, "3"], cell: float, shape: Int[ndarray, "3"]
) -> Int[ndarray, " points"]:
    """Return the flat indices of the grid points that no view sees beside the object.

    Blocks of points are tried first, against outlines widened by the size of a block.
    """
    blocks = np.argwhere(np.ones(-(-shape // BLOCK), bool)) * BLOCK
    radius = 0.5 * np.sqrt(3.0) * BLOCK * cell
    blocks = blocks[_unseen_beside(views, low + cell * (blocks + 0.5 * (BLOCK - 1)), radius)]
    places = (blocks[:, None] + np.argwhere(np.ones((BLOCK,) * 3, bool))).reshape(-1, 3)
    places = places[(places < shape).all(axis=-1)]
    chunks = [places[part] for part in _chunks(len(places))]
    kept = [some[_unseen_beside(views, low + cell * some, 0.0)] for some in chunks]
    return np.ravel_multi_index(tuple(np.concatenate(kept).T), tuple(shape))


def _unseen_beside(
    views: Sequence[View], points: Float[ndarray, "points 3"], radius: float
) -> Int[ndarray, " kept"]:
    """Return the indices of the balls of `radius` that every view sees on the object, at least in part."""
    index = np.arange(len(points))
    for number in np.random.default_rng(0).permutation(len(views)):
        camera = views[number].camera
        outline = next(iter(views[number].images.values()))[..., 3] > 0.0
        if radius:
            closest = np.linalg.norm(points[index] - camera.position, axis=-1).min() - radius
            pixels = int(np.ceil(radius * camera.focal_x / closest)) + 1
            outline = binary_dilation(outline, np.ones((3, 3), bool), iterations=pixels)
        index = index[np.append(outline.reshape(-1), False)[pixel_of(camera, points[index])]]
    return index


def _signed_distance(
    views: Sequence[View], points: Float[ndarray, "points 3"], truncation: float
) -> Float[ndarray, " points"]:
    """Return distances to the surface, positive outside, limited to +-`truncation`.

    Views that see a point near their surface vote with its distance from the pixel's tangent plane. A point
    that any view sees clearly in front of a surface is outside, one that all see behind it is inside.
    """
    result = np.empty(len(points), np.float32)
    maps = [_view_maps(view) for view in views]
    for part in _chunks(len(points)):
        some = points[part]
        votes, total = np.zeros(len(some)), np.zeros(len(some))
        outside = np.zeros(len(some), bool)
        for view, (clean, nearest, surface, normal, facing) in zip(views, maps, strict=True):
            pixel = pixel_of(view.camera, some)
            distance = np.linalg.norm(some - view.camera.position, axis=-1)
            plane = (normal[pixel] * (some - surface[pixel])).sum(axis=-1)
            gap = np.linalg.norm(surface[pixel] - view.camera.position, axis=-1) - distance
            outside |= nearest[pixel] - distance > 2.0 * truncation
            outside |= clean[pixel] & (plane > truncation) & (gap > truncation)
            near = clean[pixel] & (np.abs(plane) <= truncation) & (np.abs(gap) <= 4.0 * truncation)
            weight = near * facing[pixel] ** 2
            votes += weight * plane
            total += weight
        mean = np.divide(votes, total, out=np.full(len(some), -truncation), where=total > 0.05)
        result[part] = np.where(outside, truncation, mean)
    return result


def _view_maps(view: View) -> tuple[ndarray, ndarray, ndarray, ndarray, ndarray]:
    """Return per pixel, with a last entry for "outside the picture": one surface, nearest distance of the
    neighbourhood, surface point, normal and cosine at the viewer."""
    distance = view.truth["distance"][..., 0]
    known = np.where(distance > 0.0, distance, np.inf)
    padded = np.pad(known, 1, constant_values=np.inf)
    height, width = distance.shape
    nearest = np.min(
        [padded[row : row + height, column : column + width] for row in range(3) for column in range(3)],
        axis=0,
    )
    normal = view.truth["normal"][..., :3]
    facing = np.abs((normal * pixel_rays(view.camera)).sum(axis=-1))
    return (
        np.append(single_surface(view).reshape(-1), False),
        # Where nothing is seen nearby the silhouettes have decided already.
        np.append(np.where(np.isinf(nearest), 0.0, nearest).reshape(-1), 0.0),
        np.concatenate([surface_points(view).reshape(-1, 3), np.zeros((1, 3))]),
        np.concatenate([normal.reshape(-1, 3), np.zeros((1, 3))]),
        np.append(facing.reshape(-1), 0.0),
    )


def _with_materials(
    vertices: Float[ndarray, "vertices 3"],
    faces: Int[ndarray, "faces 3"],
    test: Sequence[View],
    tolerance: float,
) -> Proxy:
    """Return the surface with means of the true maps over the views that see each vertex."""
    corners = vertices[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    own = np.zeros_like(vertices)
    np.add.at(own, faces.reshape(-1), np.repeat(area, 3, axis=0))
    own /= np.maximum(np.linalg.norm(own, axis=-1, keepdims=True), 1e-12)
    total, weights = np.zeros((len(vertices), 8)), np.zeros(len(vertices))
    for view in test:
        truth = view.truth
        values = [truth["normal"][..., :3], truth["albedo"][..., :3], truth["roughness"], truth["metallic"]]
        flat = np.concatenate(values, axis=-1).reshape(-1, 8)
        pixel = pixel_of(view.camera, vertices)
        distance = np.linalg.norm(vertices - view.camera.position, axis=-1)
        seen = single_surface(view).reshape(-1)[pixel] & (pixel >= 0)
        seen &= np.abs(truth["distance"].reshape(-1)[pixel] - distance) < tolerance
        agreement = (flat[pixel, :3] * own).sum(axis=-1)
        towards = (view.camera.position - vertices) / distance[:, None]
        weight = seen * agreement.clip(0.0) ** 2 * (flat[pixel, :3] * towards).sum(axis=-1).clip(0.0)
        total += weight[:, None] * flat[pixel]
        weights += weight
    known = weights > 0.05
    total[known] /= weights[known, None]
    _, nearest = cKDTree(vertices[known]).query(vertices[~known])
    total[~known] = total[known][nearest]
    total[~known, :3] = own[~known]
    normals = total[:, :3] / np.maximum(np.linalg.norm(total[:, :3], axis=-1, keepdims=True), 1e-12)
    return Proxy(
        vertices=vertices,
        faces=faces.astype(np.int64),
        normals=normals,
        albedo=total[:, 3:6].clip(0.0, 1.0),
        perceptual_roughness=total[:, 6:7].clip(0.01, 1.0),
        metalness=total[:, 7:8].clip(0.0, 1.0),
        seen_share=float(known.mean()),
    )

"""The sparse points of a capture: what cameras were found from tells where the object stands."""

from pathlib import Path

from lambent_proto.v1 import scene_pb2

from lambent_worker.masks.photograph import SparsePoints
from lambent_worker.scenes.colmap import model_folder
from lambent_worker.scenes.colmap_model import read_images
from lambent_worker.scenes.colmap_points import read_points
from lambent_worker.scenes.photographs import folder_of_pictures
from lambent_worker.scenes.world import world_matrix


def sparse_points(
    scene: Path, cameras: Path | None, manifest: scene_pb2.SceneManifest
) -> SparsePoints | None:
    """Return the points of the COLMAP model of a capture, in the coordinates of `manifest`.

    That is the model of the cameras that were found, or the capture's own. None where there is no model, or
    it has no points. Raises `ModelError` where they cannot be read.
    """
    root = cameras or scene
    place = model_folder(root)
    if place is None:
        return None
    folder = root / place
    suffix = ".bin" if (folder / "images.bin").is_file() else ".txt"
    points = read_points(folder)
    if points is None or not len(points.xyz):
        return None
    names = {image.number: image.name for image in read_images(folder / f"images{suffix}")}
    matrix = world_matrix(manifest)
    pictures = folder_of_pictures(scene)
    views = {
        (scene / image.path).relative_to(pictures).as_posix(): number
        for number, frame in enumerate(manifest.frames)
        for image in frame.images
    }
    seen_by = tuple(
        tuple(sorted(views[names[image]] for image in images if names.get(image) in views))
        for images in points.images
    )
    return SparsePoints(xyz=points.xyz @ matrix[:3, :3].T + matrix[:3, 3], seen_by=seen_by)

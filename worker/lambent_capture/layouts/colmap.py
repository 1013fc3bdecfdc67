"""Reads a COLMAP sparse model with its photographs.

    <scene>/sparse/0/ cameras.bin images.bin (or .txt)     or another of `colmap_places`
    <scene>/images/   photographs, named as in the model
    <scene>/masks/    optional: <name>.png or <stem>.png, white is the object

Poses are world-to-camera with OpenCV axes. The world has any scale and direction; see `world`.
"""

import math
from collections import defaultdict
from pathlib import Path, PurePosixPath

import numpy as np
from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Pose64
from lambent_capture.layouts.colmap_model import (
    UNDISTORT,
    ColmapCamera,
    ColmapImage,
    ModelError,
    read_cameras,
    read_images,
)
from lambent_capture.layouts.colmap_places import (
    GROUPS,
    chosen_model,
    images_file,
    model_folder,
    picture_folder,
)
from lambent_capture.layouts.named_files import find_file, find_picture_file, picture_names
from lambent_capture.layouts.transforms_json import scaled
from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import LIGHT, Capture, training_frame
from lambent_capture.scenes.frames import check_sizes, listed, name_frames
from lambent_capture.scenes.links import link_out, note_links
from lambent_capture.scenes.reading import ROOT, inside_folder, pose_from_world_to_camera

NAME = "colmap"

MASKS = "masks"


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return model_folder(folder) is not None


def read_capture(folder: Path, problems: Problems, at: PurePosixPath = ROOT) -> Capture:
    """Return all usable frames of `folder`, whose model is in its folder `at`; problems go to `problems`."""
    return read_model(folder, folder, problems, at=at)


def read_model(
    folder: Path, root: Path, problems: Problems, pictures: str | None = None, at: PurePosixPath = ROOT
) -> Capture:
    """Return the frames that the sparse model in `root`/`at` has for the pictures in `folder`/`pictures`.

    Without `pictures` they are looked for. All problems are added to `problems`. Masks are those in
    `folder`/`at`/masks, where that is a folder.
    """
    capture = Capture(name=folder.resolve().name, lights=[LIGHT], up_is_z=False)
    model = chosen_model(root, at, problems)
    if model is None:
        problems.error(
            "scene.file_missing",
            f"there is no images.bin or images.txt in {', '.join(GROUPS[:-1])} or a folder in one of "
            "these; add COLMAP's sparse model",
            "sparse/0/images.bin",
        )
        return capture
    entries = _read_model(root, model, problems)
    if entries is None:
        return capture
    cameras, images = entries
    if pictures is None:
        pictures = picture_folder(folder, at, model, [image.name for image in images]).as_posix()
    masks = (at / MASKS).as_posix() if (folder / at / MASKS).is_dir() else None
    by_camera = defaultdict(list)
    seen: set[str] = set()
    for image in sorted(images, key=lambda image: image.name):
        if image.name in seen:
            problems.error(
                "scene.frame_duplicate",
                f'{model}: the model registers "{image.name}" twice; keep one of the two',
                image.name,
            )
            continue
        seen.add(image.name)
        frame = _read_frame(folder, pictures, model, image, cameras, problems)
        if frame is not None:
            by_camera[image.camera].append(frame)
            capture.frames.append(frame)
    if masks is not None:
        _set_masks(folder, pictures, masks, capture, problems)
    for frames in by_camera.values():
        check_sizes(frames, problems)
    name_frames(capture.frames)
    return capture


def _read_model(
    folder: Path, model: str, problems: Problems
) -> tuple[dict[int, ColmapCamera], list[ColmapImage]] | None:
    suffix = images_file(folder / model).suffix
    paths = [(PurePosixPath(model) / f"{name}{suffix}").as_posix() for name in ("cameras", "images")]
    astray = next((path for path in paths if link_out(folder, PurePosixPath(path)) is not None), None)
    if astray is not None:
        note_links([folder / astray], folder, problems, needed=True)
        return None
    try:
        reading = paths[0]
        cameras = read_cameras(folder / paths[0])
        reading = paths[1]
        return cameras, read_images(folder / paths[1])
    except FileNotFoundError:
        problems.error("scene.file_missing", f"{reading} does not exist; copy COLMAP's whole model", reading)
    except ModelError as error:
        problems.error(error.code, f"{reading} {error}; {error.advice}", reading)
    except OSError:
        problems.error(
            "scene.metadata_unreadable", f"{reading} cannot be read; export the model again", reading
        )
    return None


def _read_frame(
    folder: Path,
    pictures: str,
    model: str,
    image: ColmapImage,
    cameras: dict[int, ColmapCamera],
    problems: Problems,
) -> scene_pb2.Frame | None:
    subject = f'{model} image "{image.name[:100]}"'
    clean = inside_folder(image.name, subject, problems)
    if clean is None:
        return None
    named = PurePosixPath(pictures) / clean
    if link_out(folder, named) is not None:
        problems.lost("scene.file_linked", f"{subject}: {named} lies behind a link out", named.as_posix())
        return None
    picture = (find_picture_file(folder, named) or named).as_posix()
    camera = cameras.get(image.camera)
    if camera is None:
        problems.error(
            "scene.camera_missing",
            f"{subject} was taken by camera {image.camera}, which the model does not describe; "
            "export the model again",
            picture,
        )
        return None
    try:
        size = picture_size(folder / picture)
    except PictureError as error:
        problems.lost(error.code, f"{subject}: {picture} {error}", picture)
        return None
    pose = _pose(image, subject, problems)
    figures = _figures(camera, subject, problems)
    if pose is None or figures is None:
        return None
    fitted = scaled(figures, size, picture, f"camera {image.camera} of the model", problems)
    if fitted is None:
        return None
    described = camera_with_lens(fitted, pose, subject, problems)
    if described is None:
        return None
    return training_frame(picture, described)


def _pose(image: ColmapImage, subject: str, problems: Problems) -> Pose64 | None:
    length = math.hypot(*image.rotation)
    if not 1e-6 <= length <= 1e6:  # no rotation: singular as a matrix, or no number
        matrix = np.full((3, 4), 0.0 if length < 1.0 else np.nan)
    else:
        w, x, y, z = (value / length for value in image.rotation)
        matrix = np.array(
            [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y), 0.0],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x), 0.0],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y), 0.0],
            ]
        )
    matrix[:, 3] = image.translation
    return pose_from_world_to_camera(matrix, subject, problems)


def _figures(camera: ColmapCamera, subject: str, problems: Problems) -> LensFigures | None:
    """Return a camera's parameters sorted by meaning, or None after noting a model that is not understood."""
    values = camera.parameters
    if camera.model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        focal_x, focal_y, (centre_x, centre_y), distortion = values[0], values[0], values[1:3], values[3:]
    elif camera.model in ("PINHOLE", "OPENCV", "FULL_OPENCV"):
        focal_x, focal_y, (centre_x, centre_y), distortion = values[0], values[1], values[2:4], values[4:]
    else:
        problems.error(
            "scene.lens_unsupported",
            f"{subject} has the camera model {camera.model}, which no pinhole can stand in for; {UNDISTORT}",
            subject,
        )
        return None
    return LensFigures(
        width=camera.width,
        height=camera.height,
        focal_x=focal_x,
        focal_y=focal_y,
        centre_x=centre_x,
        centre_y=centre_y,
        distortion=tuple(distortion),
    )


def _set_masks(folder: Path, pictures: str, masks: str, capture: Capture, problems: Problems) -> None:
    """Give the frames their masks; a few that have none are left out, else no masks are used."""
    lacking = []
    for frame in capture.frames:
        picture = PurePosixPath(frame.images[0].path)
        candidates = _mask_names(PurePosixPath(masks) / picture.relative_to(pictures))
        mask = find_file(folder, candidates)
        astray = next((each for each in candidates if mask is None and link_out(folder, each)), None)
        if astray is not None:
            problems.lost("scene.file_linked", f"{astray} lies behind a link out", astray.as_posix())
        elif mask is None:
            lacking.append((frame, candidates[0]))
        else:
            frame.mask = mask.as_posix()
    if 2 * len(lacking) > len(capture.frames):
        names = [frame.images[0].path for frame, _ in lacking]
        problems.warning(
            "scene.mask_unused",
            f"the masks in {masks} are not used, because {len(lacking)} of {len(capture.frames)} photographs "
            f"have none there: {listed(names)}; give one for each, or remove the folder",
            masks,
        )
        for frame in capture.frames:
            frame.mask = ""
        return
    for frame, name in lacking:
        problems.lost(
            "scene.mask_file_missing",
            f"{frame.images[0].path} has no mask {name}, as the others have",
            frame.images[0].path,
        )
    capture.frames = [frame for frame in capture.frames if frame.mask]


def _mask_names(clean: PurePosixPath) -> list[PurePosixPath]:
    return [clean.with_name(f"{clean.name}.png"), clean.with_suffix(".png"), *picture_names(clean)]

"""Reads the NeRF-Blender layout: `transforms_{train,test,val}.json` beside the pictures they name.

Each frame has `file_path` (with or without a suffix) and `transform_matrix`, camera-to-world with camera axes
x right, y up, looking along -z. The lens is `camera_angle_x`, or `fl_x` (`fl_y`, `cx`, `cy`), for the file or
per frame. Ground truth, where it exists, lies beside a picture as `<stem>_albedo.png` and so on.
"""

from pathlib import Path
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_worker.scenes.capture import Capture
from lambent_worker.scenes.pictures import PICTURE_SUFFIXES, PictureError, picture_size
from lambent_worker.scenes.problems import Problems
from lambent_worker.scenes.reading import (
    finite_number,
    finite_numbers,
    focal_from_angle,
    inside_folder,
    pose_from_numbers,
    read_json_object,
)

NAME = "nerf_blender"
LIGHT = "capture"
"""This layout knows one light and has no name for it."""

TRUTH_SUFFIXES = {
    "albedo": "_albedo.png",
    "normal": "_normal.png",
    "roughness": "_roughness.png",
    "metallic": "_metallic.png",
    "distance": "_distance.exr",
}
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return (folder / "transforms_train.json").is_file()


def read_capture(folder: Path, problems: Problems) -> Capture:
    """Return all usable frames of `folder`; everything that is wrong goes to `problems`."""
    capture = Capture(name=folder.resolve().name, lights=[LIGHT])
    if not (folder / "transforms_train.json").is_file():
        problems.error(
            "scene.file_missing",
            "transforms_train.json does not exist; it holds the cameras of the training photographs",
            "transforms_train.json",
        )
        return capture
    splits = [("transforms_train.json", scene_pb2.SPLIT_TRAIN)]
    # Validation frames stand in where there is no test split; otherwise nothing uses them.
    for name in ("transforms_test.json", "transforms_val.json"):
        if (folder / name).is_file():
            splits.append((name, scene_pb2.SPLIT_TEST))
            break
    seen: set[str] = set()
    for name, split in splits:
        transforms = read_json_object(folder, name, problems)
        if transforms is not None:
            _read_split(folder, name, transforms, split, capture, seen, problems)
    return capture


def _read_split(
    folder: Path,
    name: str,
    transforms: dict[str, Any],
    split: scene_pb2.Split,
    capture: Capture,
    seen: set[str],
    problems: Problems,
) -> None:
    entries = transforms.get("frames")
    if not isinstance(entries, list):
        problems.error("scene.metadata_unreadable", f'{name} has no list called "frames"; add it', name)
        return
    for index, entry in enumerate(entries):
        subject = f"{name} frame {index}"
        if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str):
            problems.error(
                "scene.file_path_missing",
                f'{subject} has no "file_path"; name the picture it is about',
                subject,
            )
            continue
        subject = f'{subject} ("{entry["file_path"][:100]}")'
        picture = _find_picture(folder, entry["file_path"], subject, problems)
        if picture is None:
            continue
        if picture in seen:
            problems.error(
                "scene.frame_duplicate",
                f"{subject}: {picture} is named by an earlier frame already; remove one of the two",
                picture,
            )
            continue
        seen.add(picture)
        camera = _read_camera(folder, picture, {**transforms, **entry}, subject, problems)
        if camera is not None:
            capture.frames.append(_frame(folder, picture, split, camera))


def _frame(folder: Path, picture: str, split: scene_pb2.Split, camera: scene_pb2.Camera) -> scene_pb2.Frame:
    stem = picture.rsplit(".", maxsplit=1)[0]
    encoding = "linear" if picture.lower().endswith(".exr") else "srgb"
    frame = scene_pb2.Frame(
        name=stem.replace("/", "_"),
        split=split,
        camera=camera,
        images=[scene_pb2.Image(light=LIGHT, path=picture, encoding=encoding)],
    )
    for kind, suffix in TRUTH_SUFFIXES.items():
        if (folder / (stem + suffix)).is_file():
            frame.truth[kind] = stem + suffix
    return frame


def _find_picture(folder: Path, file_path: str, subject: str, problems: Problems) -> str | None:
    clean = inside_folder(file_path, subject, problems)
    if clean is None:
        return None
    candidates = [clean.as_posix()] if clean.suffix.lower() in PICTURE_SUFFIXES else []
    candidates += [clean.as_posix() + suffix for suffix in PICTURE_SUFFIXES]
    for candidate in candidates:
        if (folder / candidate).is_file():
            return candidate
    problems.error(
        "scene.file_missing",
        f"{subject}: there is no {candidates[0]} (nor another supported picture of this name); add it or "
        "remove the frame",
        clean.as_posix(),
    )
    return None


def _read_camera(
    folder: Path, picture: str, settings: dict[str, Any], subject: str, problems: Problems
) -> scene_pb2.Camera | None:
    if "transform_matrix" not in settings:
        problems.error(
            "scene.camera_missing",
            f'{subject} has no camera; add "transform_matrix" or remove the frame',
            picture,
        )
        return None
    pose = pose_from_numbers(settings["transform_matrix"], subject, problems)
    if any(finite_number(settings.get(key)) not in (None, 0.0) for key in DISTORTION):
        problems.error(
            "scene.lens_distorted",
            f"{subject} states lens distortion ({', '.join(k for k in DISTORTION if settings.get(k))}); "
            "undistort the photographs first and set the coefficients to 0",
            picture,
        )
    try:
        width, height = picture_size(folder / picture)
    except PictureError as error:
        problems.error(error.code, f"{subject}: {picture} {error}", picture)
        return None
    lens = _read_lens(settings, width, height, subject, problems)
    if pose is None or lens is None:
        return None
    return scene_pb2.Camera(
        width=width,
        height=height,
        focal_x=lens[0],
        focal_y=lens[1],
        centre_x=lens[2],
        centre_y=lens[3],
        camera_to_world=pose.ravel().tolist(),
    )


def _read_lens(
    settings: dict[str, Any], width: int, height: int, subject: str, problems: Problems
) -> tuple[float, float, float, float] | None:
    """Return focal lengths and centre in pixels of the actual picture; it may be smaller than `w` x `h`."""
    if "fl_x" not in settings and "camera_angle_x" not in settings:
        problems.error(
            "scene.camera_missing", f'{subject} has no lens; add "camera_angle_x" or "fl_x"', subject
        )
        return None
    if "fl_x" not in settings:
        focal = focal_from_angle(settings["camera_angle_x"], width, subject, problems)
        return None if focal is None else (focal, focal, 0.5 * width, 0.5 * height)
    w, h = settings.get("w", width), settings.get("h", height)
    fl_x = settings["fl_x"]
    sizes = finite_numbers([w, h, fl_x, settings.get("fl_y", fl_x)], 4)
    if sizes is None or min(sizes) <= 0.0:
        centre = None
    else:
        centre = finite_numbers([settings.get("cx", 0.5 * sizes[0]), settings.get("cy", 0.5 * sizes[1])], 2)
    if sizes is None or centre is None:
        problems.error(
            "scene.lens_invalid",
            f"{subject}: w, h, fl_x, fl_y must be positive numbers and cx, cy finite ones, in pixels",
            subject,
        )
        return None
    across, down = width / sizes[0], height / sizes[1]
    return sizes[2] * across, sizes[3] * down, centre[0] * across, centre[1] * down

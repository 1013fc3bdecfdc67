"""Reads the TensoIR-synthetic layout: one folder per view with `metadata.json` and `rgba_<light>.png`.

    <scene>/train_000/ metadata.json rgba_<light>.png albedo.png normal.png
    <scene>/test_000/  the same, with the lights to relight to, optionally roughness, metallic, distance,
                       and material.png, which says where albedo is uniform and is not read
    <scene>/scene.json optional: train_env, rotations, test_envs, near_far, bbox

`cam_transform_mat` is camera-to-world with camera axes x right, y up, looking along -z; world z up.
"""

import re
from collections import Counter
from pathlib import Path

from lambent_proto.v1 import scene_pb2

from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.pictures import PictureError, picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import Capture
from lambent_capture.scenes.reading import (
    finite_number,
    finite_numbers,
    focal_from_angle,
    pose_from_numbers,
    read_json_object,
)

NAME = "tensoir_synthetic"

# The order decides the default light; the names are those of the published data set.
TRAIN_LIGHTS = ("sunset", "sunset_000", "sunset_120", "sunset_240", "snow", "courtyard")
RELIGHT_LIGHTS = ("bridge", "city", "fireplace", "forest", "night")

TRUTH_FILES = {
    "albedo": "albedo.png",
    "normal": "normal.png",
    "roughness": "roughness.png",
    "metallic": "metallic.png",
    "distance": "distance.exr",
}

_VIEW = re.compile(r"(train|test)_\d+$")


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return any(_VIEW.match(p.name) and (p / "metadata.json").is_file() for p in folder.iterdir())


def read_capture(folder: Path, problems: Problems) -> Capture:
    """Return all usable frames of `folder`; all problems are added to `problems`."""
    capture = Capture(name=folder.resolve().name, object_only=True)
    views = sorted(p.name for p in folder.iterdir() if p.is_dir() and _VIEW.match(p.name))
    _check_numbers(views, problems)
    lights_of = {view: _lights(folder / view) for view in views}
    _choose_lights(folder, capture, lights_of, problems)
    for view in views:
        frame = _read_frame(folder, view, capture, lights_of[view], problems)
        if frame is not None:
            capture.frames.append(frame)
    return capture


def _check_numbers(views: list[str], problems: Problems) -> None:
    """Note folders that name one view twice, such as train_3 and train_003."""
    first: dict[tuple[str, int], str] = {}
    for view in views:
        split, _, number = view.partition("_")
        other = first.setdefault((split, int(number)), view)
        if other != view:
            problems.error(
                "scene.frame_duplicate",
                f"{view} and {other} are the same view of the layout; keep one of the two",
                view,
            )


def _lights(folder: Path) -> set[str]:
    return {p.stem.removeprefix("rgba_") for p in folder.glob("rgba_*.png")}


def _choose_lights(
    folder: Path, capture: Capture, lights_of: dict[str, set[str]], problems: Problems
) -> None:
    trained = _common_lights({v: lights for v, lights in lights_of.items() if v.startswith("train_")})
    tested = _common_lights({v: lights for v, lights in lights_of.items() if v.startswith("test_")})
    known = {name: i for i, name in enumerate((*TRAIN_LIGHTS, *RELIGHT_LIGHTS))}
    in_order = sorted(trained, key=lambda light: (known.get(light, len(known)), light))
    capture.lights = [light for light in in_order if light not in RELIGHT_LIGHTS] or in_order
    if (folder / "scene.json").is_file():
        _read_scene_json(folder, capture, trained, problems)
    others = (tested | trained) - set(capture.lights)
    capture.relight_lights = sorted(others & tested)
    for view in lights_of:
        capture.other_files |= {f"{view}/{path.name}" for path in (folder / view).glob("radiance_*")}
        capture.other_files |= {f"{view}/rgba_{light}.png" for light in trained | tested}
        capture.other_files.add(f"{view}/material.png")


def _common_lights(lights_of: dict[str, set[str]]) -> set[str]:
    """Return the lights that at least half of the views show; others are pictures that got in by mistake."""
    counts = Counter(light for lights in lights_of.values() for light in lights)
    return {light for light, count in counts.items() if 2 * count >= len(lights_of)}


def _read_scene_json(folder: Path, capture: Capture, trained: set[str], problems: Problems) -> None:
    info = read_json_object(folder, "scene.json", problems)
    if info is None:
        return
    if isinstance(info.get("scene"), str):
        capture.name = info["scene"]
    environment, rotations = info.get("train_env"), info.get("rotations")
    if isinstance(environment, str):
        turns = rotations if isinstance(rotations, list) else ["000"]
        named = [f"{environment}_{turn}" for turn in turns]
        for light in named:
            if light not in trained:
                problems.error(
                    "scene.light_missing",
                    f'scene.json names the training light "{light}", but no training view has '
                    f"rgba_{light}.png; add the pictures or correct scene.json",
                    "scene.json",
                )
        capture.lights = [light for light in named if light in trained] or capture.lights
    capture.near_far = _near_far(info.get("near_far"), problems)
    capture.box = _box(info.get("bbox"), problems)


def _near_far(value: object, problems: Problems) -> tuple[float, float] | None:
    if value is None:
        return None
    numbers = finite_numbers(value, 2)
    if numbers is not None and 0.0 <= numbers[0] < numbers[1]:
        return numbers[0], numbers[1]
    problems.error(
        "scene.extent_invalid",
        "scene.json: near_far must be two numbers, 0 <= near < far, in scene units",
        "scene.json",
    )
    return None


def _box(
    value: object, problems: Problems
) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
    if value is None:
        return None
    corners = value if isinstance(value, list) and len(value) == 2 else [None, None]
    low, high = (finite_numbers(corner, 3) for corner in corners)
    if low is not None and high is not None and all(a < b for a, b in zip(low, high, strict=True)):
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])
    problems.error(
        "scene.extent_invalid",
        "scene.json: bbox must be two corners of three numbers, the lower one first, in scene units",
        "scene.json",
    )
    return None


def _read_frame(
    folder: Path, view: str, capture: Capture, lights: set[str], problems: Problems
) -> scene_pb2.Frame | None:
    is_train = view.startswith("train_")
    frame = scene_pb2.Frame(name=view, split=scene_pb2.SPLIT_TRAIN if is_train else scene_pb2.SPLIT_TEST)
    wanted = capture.lights if is_train else [*capture.lights, *capture.relight_lights]
    for light in wanted:
        path = f"{view}/rgba_{light}.png"
        if light in lights:
            frame.images.append(scene_pb2.Image(light=light, path=path, encoding="srgb"))
        else:
            problems.error(
                "scene.file_missing",
                f'frame "{view}" has no {path}, but other frames have this light; add it or remove the light',
                path,
            )
    for kind, name in TRUTH_FILES.items():
        if (folder / view / name).is_file():
            frame.truth[kind] = f"{view}/{name}"
    if not (folder / view / "metadata.json").is_file():
        problems.error(
            "scene.camera_missing",
            f'frame "{view}" has no metadata.json, so no camera; add it or remove the folder',
            view,
        )
        return None
    metadata = read_json_object(folder, f"{view}/metadata.json", problems)
    if metadata is None:
        return None
    camera = _read_camera(folder, frame, metadata, problems)
    if camera is None or not frame.images:
        return None
    frame.camera.CopyFrom(camera)
    return frame


def _read_camera(
    folder: Path, frame: scene_pb2.Frame, metadata: dict[str, object], problems: Problems
) -> scene_pb2.Camera | None:
    subject = f"{frame.name}/metadata.json"
    size = _frame_size(folder, frame, metadata, subject, problems)
    numbers = metadata.get("cam_transform_mat")
    if isinstance(numbers, str):
        try:
            numbers = [float(part) for part in numbers.split(",")]
        except ValueError:
            numbers = metadata.get("cam_transform_mat")
    pose = pose_from_numbers(numbers, subject, problems)
    if size is None:
        return None
    focal = focal_from_angle(metadata.get("cam_angle_x"), size[0], subject, problems)
    if pose is None or focal is None:
        return None
    return camera_with_lens(LensFigures.centred(size, focal), pose, subject, problems)


def _frame_size(
    folder: Path, frame: scene_pb2.Frame, metadata: dict[str, object], subject: str, problems: Problems
) -> tuple[int, int] | None:
    """Return the size of the frame's pictures after checking that they all agree with the metadata."""
    stated = tuple(finite_number(metadata.get(key)) for key in ("imw", "imh"))
    common: tuple[int, int] | None = None
    for image in frame.images:
        try:
            size = picture_size(folder / image.path)
        except PictureError as error:
            problems.error(error.code, f"{image.path} {error}", image.path)
            continue
        expected = common or (stated if None not in stated else size)
        if size != expected:
            problems.error(
                "scene.image_size",
                f"{image.path} has {size[0]} x {size[1]} pixels, {subject} and the frame's other pictures "
                f"say {expected[0]:g} x {expected[1]:g}; use one size in each frame",
                image.path,
            )
        common = common or size
    return common

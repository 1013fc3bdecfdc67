"""Finds cameras that lie a folder deeper or higher than expected, and those that cannot be read.

Cameras that are passed over without a word would be solved again, from photographs that may not allow it.
"""

import fnmatch
from pathlib import Path, PurePosixPath

from lambent_core.layouts import LAYOUTS

from lambent_capture.layouts.colmap_places import folders_below, images_file, names_in
from lambent_capture.layouts.readers import reader_of
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.reading import ROOT
from lambent_capture.scenes.rig import MIN_TRAIN_FRAMES

_ABOVE = (
    *("transforms.json", "transforms_train.json", "poses_bounds.npy"),
    *("sparse/0/images.bin", "sparse/0/images.txt", "sparse/images.bin", "sparse/images.txt"),
    *("corrected_cameras", "colmap/sparse/0/images.bin", "colmap/sparse/0/images.txt"),
)
_PICTURES = frozenset({"images", "image", "input", "imgs", "photos", "rgb", "train", "corrected_images"})

_UNREAD = {
    "poses_bounds.npy": "LLFF",
    "cameras_sphere.npz": "IDR and NeuS",
    "cameras.npz": "IDR and NeuS",
    "cameras.xml": "Metashape",
    "*.sfm": "Meshroom",
    "sfm.json": "Meshroom",
    "*.nvm": "VisualSFM",
    "bundle.out": "Bundler",
    "reconstruction.json": "OpenSfM",
    "shots.geojson": "OpenDroneMap",
    "transforms_test.json": "NeRF-Blender, without transforms_train.json",
    "transforms_val.json": "NeRF-Blender, without transforms_train.json",
    "cameras.json": "another program",
    "frame_00000.json": "3D Scanner App",
    "*.r3d": "Record3D",
    "*.p4p": "Pix4D",
    "*_calibrated_camera_parameters.txt": "Pix4D",
}
"""Files with cameras that are not read, and whose they are."""


def place_of(folder: Path, layout: str) -> PurePosixPath:
    """Return the folder of the capture in `folder` that has its cameras, as `layout` keeps them.

    It is the capture's own where these have them, or where no folder is the only one.
    """
    if not LAYOUTS[layout].nested or reader_of(layout).is_layout(folder):
        return ROOT
    places = [place for place, name in deeper(folder) if name == layout]
    return places[0] if len(places) == 1 else ROOT


def deeper_layout(folder: Path) -> str | None:
    """Return the layout of the only folder in `folder` that has cameras of its photographs, or None."""
    places = deeper(folder)
    if len(places) != 1:
        return None
    place, layout = places[0]
    capture = reader_of(layout).read_capture(folder, Problems(), place)
    return layout if len(capture.frames) >= MIN_TRAIN_FRAMES else None


def deeper(folder: Path) -> list[tuple[PurePosixPath, str]]:
    """Return the folders in `folder` that have cameras, with their layout; of nested ones the outer one."""
    places: list[tuple[PurePosixPath, str]] = []
    for place in folders_below(folder):
        if any(place.is_relative_to(other) for other, _ in places) or _is_of_a_run(folder / place):
            continue
        nested = (name for name, known in LAYOUTS.items() if known.nested)
        layout = next((name for name in nested if reader_of(name).is_layout(folder / place)), None)
        if layout is not None:
            places.append((place, layout))
    return places


def _is_of_a_run(folder: Path) -> bool:
    """Return whether a folder has cameras that a run found, which it finds anew where they are stale."""
    return (folder / "cameras.json").is_file() and (folder / "sparse").is_dir()


def note_deeper(place: PurePosixPath, layout: str, problems: Problems) -> None:
    """Note that the cameras of a capture are those in its folder `place`, unless that is its own."""
    if place != ROOT:
        problems.warning(
            "scene.cameras_in_folder",
            f"the cameras are those of {layout} in {place}, the only ones here; give that folder itself, or "
            "take it away if other cameras are meant",
            place.as_posix(),
        )


def note_passed_over(folder: Path, problems: Problems) -> None:
    """Note cameras in and around a folder of photographs that are not used, and what to do to use them."""
    places = deeper(folder)
    if len(places) > 1:
        names = [f"{place} ({layout})" for place, layout in places]
        problems.warning(
            "scene.cameras_unused",
            f"several folders have cameras, and none is used: {listed(names)}; give one of them",
            places[0][0].as_posix(),
        )
    for place, layout in places if len(places) == 1 else []:
        faults = Problems()
        reader_of(layout).read_capture(folder, faults, place)
        reason = next((finding.message for finding in faults.findings()), "they are too few")
        problems.warning(
            "scene.cameras_unused",
            f"{place} has cameras ({layout}) that cannot be used with these photographs: {reason}",
            place.as_posix(),
        )
    above = folder.resolve().parent
    outer = next((name for name in _ABOVE if (above / name).exists()), None)
    if outer is not None and folder.resolve().name.lower() in _PICTURES:
        problems.warning(
            "scene.cameras_unused",
            f'there are cameras beside this folder ({outer}); give the folder "{above.name}" to use them',
            outer,
        )
    _note_unread(folder, problems)


def _note_unread(folder: Path, problems: Problems) -> None:
    unread = []
    for place in (ROOT, *folders_below(folder)):
        for name in names_in(folder / place):
            pattern = next((each for each in _UNREAD if fnmatch.fnmatch(name.lower(), each)), None)
            if pattern is not None and not _is_of_a_run(folder / place):
                unread.append(((place / name).as_posix(), _UNREAD[pattern]))
            elif name == "cameras.bin" and not images_file(folder / place).is_file():
                unread.append(((place / name).as_posix(), "COLMAP, without images.bin"))
    if unread:
        said = listed([f"{name} ({whose})" for name, whose in unread])
        problems.warning(
            "scene.cameras_unused",
            f"cameras in a form that is not read are not used: {said}; export them as COLMAP's model or as a "
            "transforms.json, or let Lambent find them again",
            unread[0][0],
        )

"""Finds the photographs of a folder, and their masks."""

from dataclasses import dataclass
from pathlib import Path

from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Grey32, Region
from lambent_capture.layouts.mask_folder import attach_masks, masks_beside
from lambent_capture.layouts.photographs import folder_of_pictures
from lambent_capture.layouts.picture_files import MIN_PHOTOGRAPHS, photographs_in
from lambent_capture.pictures.coverage import alpha_of, photograph_mask
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_size, read_picture
from lambent_capture.poses.features import COVERED
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import frame_names, listed

IMAGES, MASKS = "images", "masks"
MIN_READABLE = 0.5
"""Share of the files that must be pictures; the others are left out."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Photographs:
    """Photographs of one object, with their masks."""

    folder: Path
    names: tuple[str, ...]
    """Paths below `folder`, in order."""
    masks: dict[str, Path]
    """Mask file of each; empty where there are none."""
    cut_out: bool
    """Whether their own alpha is the mask."""

    @property
    def masked(self) -> bool:
        """Return whether there are masks, be they files or alpha."""
        return self.cut_out or bool(self.masks)

    def path(self, name: str) -> Path:
        """Return the file of a photograph."""
        return self.folder / name

    def coverage(self, name: str) -> Grey32:
        """Return what its mask or its alpha says of a photograph's stored pixels, 0..1.

        Raises `PictureError`.
        """
        if name in self.masks:
            return photograph_mask(self.masks[name], self.path(name)).coverage
        return read_picture(self.path(name)).coverage()


def find_photographs(folder: Path, masks_dir: Path | None, problems: Problems) -> Photographs | None:
    """Return the photographs in `folder`, or in its `images/`, with masks; None after noting what is wrong.

    Masks are the files in `masks_dir`, else those beside the photographs, else the photographs' own alpha.
    All photographs have a mask, or none. Files that are not pictures are left out with a warning while most
    are.
    """
    root = folder_of_pictures(folder)
    files = (root / name for name in photographs_in(root, problems, within=folder))
    paths = [path for path in files if masks_dir is None or not path.is_relative_to(masks_dir)]
    if not problems.usable:
        return None
    beside = {} if masks_dir is not None else _masks_beside(paths, folder, problems)
    names, cut_out = _readable(root, paths, problems, look_at_alpha=masks_dir is None and not beside)
    if len(names) < MIN_PHOTOGRAPHS:
        problems.error(
            "scene.too_few_images",
            f'"{folder}" has {len(names)} photographs; {MIN_PHOTOGRAPHS} are needed at least, 40 are good',
        )
        return None
    lacking = [name for name in names if not cut_out[name]]
    if 0 < len(lacking) < len(names):
        problems.error(
            "scene.mask_file_missing",
            f"{len(names) - len(lacking)} of {len(names)} photographs have a transparent background, but "
            f"not {listed(lacking)}; cut the object out of all or of none",
            lacking[0],
        )
    masks = {name: beside[root / name] for name in names} if beside else {}
    if masks_dir is not None:
        masks = _masks(names, root, masks_dir, problems)
    if not problems.usable:
        return None
    return Photographs(folder=root, names=names, masks=masks, cut_out=bool(cut_out) and all(cut_out.values()))


def covered_pixels(photographs: Photographs, name: str) -> Region:
    """Return which stored pixels of a photograph show the object, as its mask or alpha says.

    Raises `PictureError` where the mask cannot be read, has another size, or shows nothing.
    """
    file = photographs.masks.get(name, photographs.path(name))
    coverage = photographs.coverage(name)
    width, height = picture_size(photographs.path(name))
    if coverage.shape != (height, width):
        raise PictureError(
            "scene.mask_size",
            f"has {width} x {height} pixels, and its mask {file.name} {coverage.shape[1]} x "
            f"{coverage.shape[0]}; make them one size",
        )
    if not (coverage > COVERED).any():
        raise PictureError(
            "scene.mask_empty", f"does not show the object, says its mask {file.name}; fix the mask"
        )
    return coverage > COVERED


def _readable(
    root: Path, paths: list[Path], problems: Problems, *, look_at_alpha: bool
) -> tuple[tuple[str, ...], dict[str, bool]]:
    """Return the names of the files that are pictures, and which of these are cut out by their alpha."""
    cut_out: dict[str, bool] = {}
    faults: dict[str, PictureError] = {}
    for path in paths:
        name = path.relative_to(root).as_posix()
        try:
            picture_size(path)
            cut_out[name] = look_at_alpha and _is_cut_out(path)
        except PictureError as error:
            faults[name] = error
    note = problems.warning if len(cut_out) >= MIN_READABLE * len(paths) else problems.error
    for name, fault in faults.items():
        note(fault.code, f"{name} {fault}; it was left out", name)
    return tuple(cut_out), cut_out


def _is_cut_out(path: Path) -> bool:
    alpha = alpha_of(path)
    return alpha is not None and bool((alpha < alpha.max()).any())


def _masks_beside(paths: list[Path], folder: Path, problems: Problems) -> dict[Path, Path]:
    names = [path.relative_to(folder).as_posix() for path in paths]
    masks = masks_beside(folder, names, problems)
    return {folder / name: folder / mask for name, mask in masks.items()}


def _masks(names: tuple[str, ...], root: Path, masks_dir: Path, problems: Problems) -> dict[str, Path]:
    called = frame_names(list(names))
    frames = [scene_pb2.Frame(name=called[name], images=[scene_pb2.Image(path=name)]) for name in names]
    manifest = scene_pb2.SceneManifest(frames=frames)
    attach_masks(manifest, root, masks_dir, problems)
    return {frame.images[0].path: root / frame.mask for frame in manifest.frames if frame.mask}

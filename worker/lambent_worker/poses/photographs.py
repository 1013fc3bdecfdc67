"""Gathers photographs and their masks, and lays them out the way COLMAP reads them."""

import shutil
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from lambent_proto.v1 import scene_pb2
from PIL import Image

from lambent_worker.scenes.float_pictures import FLOAT_SUFFIXES
from lambent_worker.scenes.frames import frame_names, listed
from lambent_worker.scenes.mask_folder import attach_masks
from lambent_worker.scenes.picture_error import PictureError
from lambent_worker.scenes.pictures import (
    PICTURE_SUFFIXES,
    has_alpha,
    opened,
    picture_size,
    read_coverage,
    read_pixels,
)
from lambent_worker.scenes.problems import Problems

IMAGES, MASKS = "images", "masks"
COLMAP_SUFFIXES = (".jpg", ".jpeg", ".png")
MIN_PHOTOGRAPHS = 3


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
    one_size: bool
    """Whether all have the same number of pixels."""

    def path(self, name: str) -> Path:
        """Return the file of a photograph."""
        return self.folder / name


def find_photographs(folder: Path, masks_dir: Path | None, problems: Problems) -> Photographs | None:
    """Return the photographs in `folder`, or in its `images/`, with masks; None after noting what is wrong.

    Masks are the files in `masks_dir`, else those in `folder`/masks next to `images/`, else the photographs'
    own alpha. All photographs have a mask, or none.
    """
    root = folder / IMAGES if (folder / IMAGES).is_dir() else folder
    if masks_dir is None and root != folder and (folder / MASKS).is_dir():
        masks_dir = folder / MASKS
    paths = sorted(
        path
        for path in (root.rglob("*") if root.is_dir() else [])
        if path.suffix.lower() in PICTURE_SUFFIXES
        and not (masks_dir is not None and path.is_relative_to(masks_dir))
    )
    if len(paths) < MIN_PHOTOGRAPHS:
        problems.error(
            "scene.too_few_images",
            f'"{folder}" has {len(paths)} photographs; {MIN_PHOTOGRAPHS} are needed at least, 40 are good',
        )
        return None
    names = tuple(path.relative_to(root).as_posix() for path in paths)
    sizes, cut_out = set(), {}
    for name in names:
        try:
            sizes.add(picture_size(root / name))
            cut_out[name] = masks_dir is None and has_alpha(root / name) and _is_cut_out(root / name)
        except PictureError as error:
            problems.error(error.code, f"{name} {error}", name)
            continue
        if name.lower().endswith(FLOAT_SUFFIXES):
            problems.error(
                "scene.poses_format", f"{name}: cameras are found in JPEG, PNG, WebP or HEIC; export it", name
            )
    lacking = [name for name, cut in cut_out.items() if not cut]
    if 0 < len(lacking) < len(cut_out):
        problems.error(
            "scene.mask_file_missing",
            f"{len(cut_out) - len(lacking)} of {len(cut_out)} photographs have a transparent background, but "
            f"not {listed(lacking)}; cut the object out of all or of none",
            lacking[0],
        )
    masks = {} if masks_dir is None else _masks(names, root, masks_dir, problems)
    if not problems.usable:
        return None
    return Photographs(
        folder=root,
        names=names,
        masks=masks,
        cut_out=bool(cut_out) and all(cut_out.values()),
        one_size=len(sizes) == 1,
    )


def lay_out(photographs: Photographs, out: Path, problems: Problems) -> dict[str, str]:
    """Fill `out`/images and `out`/masks; return the name each photograph has there.

    JPEG and PNG are copied, WebP becomes PNG, HEIC becomes JPEG. A mask is named as COLMAP wants it, with
    `.png` after the photograph's name. Masks of another size and empty ones go to `problems`.
    """
    given: dict[str, str] = {}
    for name in photographs.names:
        source, target = photographs.path(name), PurePosixPath(name)
        if target.suffix.lower() not in COLMAP_SUFFIXES:
            target = target.with_suffix(".png" if target.suffix.lower() == ".webp" else ".jpg")
        if target.as_posix() in given.values() or (
            target.as_posix() != name and target.as_posix() in photographs.names
        ):
            target = PurePosixPath(name + target.suffix)
        given[name] = target.as_posix()
        path = out / IMAGES / target
        path.parent.mkdir(parents=True, exist_ok=True)
        if target.as_posix() == name:
            shutil.copyfile(source, path)
        else:
            with opened(source) as image:
                keep = {"exif": image.info["exif"]} if image.info.get("exif") else {}
                image.convert("RGBA" if path.suffix == ".png" else "RGB").save(path, quality=95, **keep)
        if photographs.masks or photographs.cut_out:
            _write_mask(photographs, name, out / MASKS / f"{target.as_posix()}.png", problems)
    return given


def _is_cut_out(path: Path) -> bool:
    pixels = read_pixels(path)
    return pixels.shape[-1] in (2, 4) and bool((pixels[..., -1] < pixels[..., -1].max()).any())


def _masks(names: tuple[str, ...], root: Path, masks_dir: Path, problems: Problems) -> dict[str, Path]:
    called = frame_names(list(names))
    frames = [scene_pb2.Frame(name=called[name], images=[scene_pb2.Image(path=name)]) for name in names]
    manifest = scene_pb2.SceneManifest(frames=frames)
    attach_masks(manifest, root, masks_dir, problems)
    return {frame.images[0].path: root / frame.mask for frame in manifest.frames if frame.mask}


def _write_mask(photographs: Photographs, name: str, target: Path, problems: Problems) -> None:
    file = photographs.masks.get(name, photographs.path(name))
    try:
        coverage = read_coverage(file)
    except PictureError as error:
        problems.error(error.code, f"{file.name} (the mask of {name}) {error}", name)
        return
    width, height = picture_size(photographs.path(name))
    if coverage.shape != (height, width):
        problems.error(
            "scene.mask_size",
            f"{file.name} has {coverage.shape[1]} x {coverage.shape[0]} pixels, {name} has {width} x "
            f"{height}; make them one size",
            name,
        )
    elif not (coverage > 0.0).any():
        problems.error(
            "scene.mask_empty", f"{file.name} says that the object is not in {name}; fix the mask", name
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(255.0 * coverage).astype(np.uint8)).save(target)

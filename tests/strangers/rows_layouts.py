"""Rows of the corpus about layouts: where cameras, photographs and masks lie, and how they are named."""

import json
import os
import unicodedata
from pathlib import Path

import numpy as np
from strangers.ball import (
    ANGLE,
    BALL,
    COUNT,
    COVER,
    FOCAL,
    SIDE,
    disc,
    names_of,
    save_png,
    save_rgba,
    view_light,
    write_masks,
    write_photographs,
    write_transforms,
)
from strangers.masks import MASKS
from strangers.models import write_model
from strangers.pictures import enlarged
from strangers.rows import Make, jpeg, posed, row
from support.captures import ring
from support.raw_files import write_dng

# Layouts: transforms files.
row("a00 base", posed(), light=BALL)
row("a00b blender", posed(save_rgba, file="transforms_train.json"), light=BALL, alpha=COVER)
row("a01 backslash", posed(named=lambda name: name.replace("/", "\\")), light=BALL)
row("a01b dot backslash", posed(named=lambda name: ".\\" + name.replace("/", "\\")))
row("a01c dot slash", posed(named=lambda name: "./" + name))
row(
    "a01d backslash mask",
    lambda folder: (
        write_transforms(folder, frame={"mask_path": lambda index: f"masks\\{index:03d}.png"}),
        write_masks(folder, names_of(folder="masks/"), MASKS["255"][1]),
    )[0],
    alpha=COVER,
)
_CENTRE = {"camera_angle_x": ANGLE, "cx": 36.0, "cy": 30.0, "w": SIDE, "h": SIDE}
row("a05 angle with cx", posed(lens=_CENTRE), centre=(36, 30))
row("a05b blender angle with cx", posed(lens=_CENTRE, file="transforms_train.json"), centre=(36, 30))
row("a05c centre per frame", posed(frame={"cx": 36.0, "cy": 30.0}), centre=(36, 30))
row(
    "a05d size twice as large",
    posed(lens={"fl_x": 2 * FOCAL, "fl_y": 2 * FOCAL, "cx": 72, "cy": 60, "w": 128, "h": 128}),
    centre=(36, 30),
)
row(
    "a05e angle with cx of a picture twice as large",
    posed(lens={"camera_angle_x": ANGLE, "cx": 72, "cy": 60, "w": 128, "h": 128}),
    centre=(36, 30),
)
row(
    "a06 angle of the frame over the file's length",
    posed(
        lens={"fl_x": 80.0, "fl_y": 80.0, "cx": 32, "cy": 32, "w": SIDE, "h": SIDE},
        frame={"camera_angle_x": ANGLE},
    ),
)
row("a06b length of the frame over the file's angle", posed(frame={"fl_x": 120.0}), focal=(120, 120))
row(
    "a06c both in the file",
    posed(lens={"fl_x": 120.0, "camera_angle_x": ANGLE}),
    focal=(120, 120),
)
row(
    "a06d both in the frame",
    posed(frame={"fl_x": 120.0, "fl_y": 110.0, "camera_angle_x": 1.2}),
    focal=(120, 110),
)
_ANGLE_Y = 2.0 * np.arctan(SIDE / 2 / 120.0)
row(
    "a07 angle y",
    posed(lens={"camera_angle_x": ANGLE, "camera_angle_y": _ANGLE_Y}),
    focal=(FOCAL, 120),
)
row("a07b angle y alone", posed(lens={"camera_angle_y": _ANGLE_Y}), focal=(120, 120))
row("a07c fl_y beside angle x", posed(lens={"camera_angle_x": ANGLE, "fl_y": 120.0}), focal=(FOCAL, 120))


def _bom(folder: Path) -> None:
    write_transforms(folder)
    file = folder / "transforms.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())


row("a15 byte order mark", _bom, light=BALL)


def _bom_blender(folder: Path) -> None:
    write_transforms(folder, file="transforms_train.json")
    file = folder / "transforms_train.json"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())


row("a15b byte order mark of blender", _bom_blender)
row(
    "a17 case of the suffix",
    posed(suffix=".png", named=lambda name: name[:-3] + "PNG"),
    or_said=("000.png",),
)
row("a17b case of the file", posed(suffix=".PNG", named=lambda name: name[:-3] + "png"), or_said=("000.PNG",))
row(
    "a17c case of the folder",
    posed(named=lambda name: name.replace("images", "Images")),
    or_said=("images/000.png",),
)


def _accents(folder: Path) -> None:
    names = [f"images/été {index}.png" for index in range(COUNT)]
    write_transforms(
        folder,
        [unicodedata.normalize("NFD", name) for name in names],
        named=lambda name: unicodedata.normalize("NFC", name),
    )


row("a17d decomposed letters", _accents)
row("a17e no suffix", posed(named=lambda name: name[:-4]))
row(
    "a17f doubled suffix",
    lambda folder: write_transforms(folder, names_of(".png.png"), named=lambda name: name[:-4]),
)
row(
    "a17g suffix of another format",
    posed(suffix=".png", named=lambda name: name[:-3] + "jpg"),
    or_said=("000.png",),
)


def _three_rows(folder: Path) -> None:
    write_transforms(folder)
    file = folder / "transforms.json"
    record = json.loads(file.read_text())
    for frame in record["frames"]:
        frame["transform_matrix"] = frame["transform_matrix"][:3]
    file.write_text(json.dumps(record))


row("a19 matrices of three rows", _three_rows)


def _shifted(offset: tuple[float, float, float]) -> Make:
    def make(folder: Path) -> None:
        write_transforms(folder, frame={"mask_path": lambda index: f"masks/{index:03d}.png"})
        write_masks(folder, names_of(folder="masks/"), MASKS["255"][1])
        file = folder / "transforms.json"
        record = json.loads(file.read_text())
        for frame in record["frames"]:
            for axis in range(3):
                frame["transform_matrix"][axis][3] += offset[axis]
        file.write_text(json.dumps(record))

    return make


row("a51 a little aside", _shifted((100.0, -20.0, 3.0)), alpha=COVER)
row("a51b UTM", _shifted((4.5e5, 5.1e6, 120.0)), alpha=COVER, lacks=("scene.silhouettes_disagree",))
row("a51c ECEF", _shifted((4_186_000.0, 834_000.0, 4_723_000.0)), alpha=COVER)


def _below(folder: Path) -> None:
    write_transforms(folder / "capture")


row("a59 one folder too high", _below, or_said=("transforms.json",))

# Layouts: COLMAP.


def _colmap(place: str, *, images: str = "images/", model: dict | None = None) -> Make:
    def make(folder: Path) -> None:
        names = names_of(folder="")
        write_photographs(folder, [images + name for name in names])
        write_model(folder / place, names, **(model or {}))

    return make


def _two_models(folder: Path) -> None:
    _colmap("sparse/1")(folder)
    write_model(folder / "sparse" / "0", names_of(folder="")[:3])


row("a18 new camera model", _colmap("sparse/0", model={"model": 12}), refused=("undistort",))
row(
    "a18b new camera model as text",
    _colmap("sparse/0", model={"binary": False, "kind": "SIMPLE_DIVISION"}),
    refused=("undistort",),
)
row("a20 two models", _two_models, or_said=("sparse/1",))
row("a20b the second model alone", _colmap("sparse/1"))
row("a20c model in sparse", _colmap("sparse"))
row("a20d colmap/sparse/0", _colmap("colmap/sparse/0"))
row("a20e model at the root", _colmap(".", model={"binary": False}))
row("a20f sparse/0", _colmap("sparse/0"), light=BALL)

# Layouts: photographs with the files beside them.


def _polycam(folder: Path) -> None:

    frames = folder / "keyframes"
    stems = [str(1_000_000 + 37 * index) for index in range(COUNT)]
    for kind in ("images", "corrected_images", "depth", "confidence"):
        suffix = ".jpg" if "images" in kind else ".png"
        write_photographs(
            frames / kind, [stem + suffix for stem in stems], jpeg() if "images" in kind else save_png
        )
    for kind in ("cameras", "corrected_cameras"):
        (frames / kind).mkdir()
        for stem, pose in zip(stems, ring(COUNT), strict=True):
            record = {"fx": FOCAL, "fy": FOCAL, "cx": 32, "cy": 32, "width": SIDE, "height": SIDE}
            record |= {f"t_{row}{column}": pose[row, column] for row in range(3) for column in range(4)}
            (frames / kind / f"{stem}.json").write_text(json.dumps(record))
    (folder / "mesh_info.json").write_text("{}")
    write_photographs(folder, ["thumbnail.jpg"], jpeg())


def _raw_beside(photograph: str, raw: str) -> Make:
    """Return a writer of shots that a camera saved twice; raw files are read at half their size."""

    def make(folder: Path) -> None:
        for index in range(COUNT):
            colours = view_light(index)
            jpeg()(folder / photograph.format(index), colours, disc())
            write_dng(folder / raw.format(index), enlarged(colours, 2))

    return make


def _with_masks(pictures: str, masks: str, *, mask: str = "255") -> Make:
    """Return a writer of photographs and masks; `{}` in the names becomes their number."""

    def make(folder: Path) -> None:
        save = save_png if pictures.endswith("png") else jpeg()
        numbers = [f"{index:03d}" for index in range(COUNT)]
        write_photographs(folder, [pictures.format(number) for number in numbers], save)
        write_masks(folder, [masks.format(number) for number in numbers], MASKS[mask][1])

    return make


row("a22 polycam", _polycam)
_PIXEL = "PXL_20240101_1200{:02d}000.RAW-0"
row(
    "a23 pixel raw",
    _raw_beside(_PIXEL + "1.COVER.jpg", _PIXEL + "2.ORIGINAL.dng"),
    has_cameras=False,
    needs=("scene.saved_twice",),
)
row(
    "a23b raw and jpeg",
    _raw_beside("IMG_{:04d}.JPG", "IMG_{:04d}.dng"),
    has_cameras=False,
    needs=("scene.saved_twice",),
)
_MASKED = {"alpha": COVER, "has_cameras": False}
row("a40 masks beside", _with_masks("IMG_{}.jpg", "masks/IMG_{}.png"), **_MASKED)
row("a40b image and mask", _with_masks("image/IMG_{}.jpg", "mask/IMG_{}.png"), **_MASKED)
row("a40c images and masks", _with_masks("images/IMG_{}.jpg", "masks/IMG_{}.png"), **_MASKED)
row("a40d suffix _mask", _with_masks("IMG_{}.jpg", "IMG_{}_mask.png"), **_MASKED)
row("a40e images_masks", _with_masks("images/IMG_{}.jpg", "images_masks/IMG_{}.png"), **_MASKED)
row("a40f mask beside", _with_masks("IMG_{}.jpg", "mask/IMG_{}.png"), **_MASKED)
row("a40g masks of 0 and 1", _with_masks("images/IMG_{}.jpg", "masks/IMG_{}.png", mask="01"), **_MASKED)


def _linked_folder(folder: Path) -> None:
    write_transforms(folder)
    (folder / "images").rename(folder / "photographs")
    (folder / "images").symlink_to("photographs")


def _linked_files(folder: Path) -> None:
    write_transforms(folder)
    (folder / "images").rename(folder / "store")
    (folder / "images").mkdir()
    for path in (folder / "store").iterdir():
        (folder / "images" / path.name).symlink_to(Path("..") / "store" / path.name)


def _linked_outside(folder: Path) -> None:
    write_transforms(folder)
    outside = folder.with_name(folder.name + "-outside")
    (folder / "images").rename(outside)
    (folder / "images").symlink_to(os.path.relpath(outside, folder))


row("a42 linked folder", _linked_folder)
row("a42d linked files", _linked_files)
row("a42e linked from outside", _linked_outside, refused=("link",))

"""Captures that people hand over and that are bad: one folder each, with what is to be said of it.

Mirrored photographs, several objects, fisheyes without EXIF, rolling shutter, and photographs that do not fit
together only show when cameras are solved: `NEED_CAMERAS` names them, `write_needing_cameras` makes them.
"""

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy import ndarray
from PIL import Image, ImageDraw
from PIL.TiffImagePlugin import IFDRational
from scipy import ndimage
from support.hostile_files import huge_png
from support.raw_files import write_dng

WIDTH, HEIGHT = 192, 144
NUM_VIEWS = 5


@dataclass(frozen=True, slots=True)
class BadCapture:
    """How to write a bad capture, and which codes are to be found in it."""

    write: Callable[[Path], None]
    codes: tuple[str, ...]
    is_error: bool


CAPTURES: dict[str, BadCapture] = {}
NEED_CAMERAS = ("mirrored", "two objects", "fisheye without EXIF", "rolling shutter", "unrelated photographs")


def bad(name: str, *codes: str, error: bool = False) -> Callable[[Callable[[Path], None]], Callable]:
    """Register a bad capture."""

    def register(write: Callable[[Path], None]) -> Callable[[Path], None]:
        assert name not in CAPTURES
        CAPTURES[name] = BadCapture(write, codes, error)
        return write

    return register


@cache
def _canvas() -> ndarray:
    rng = np.random.default_rng(7)
    coarse = [ndimage.gaussian_filter(rng.uniform(0, 255, (400, 900)), 12.0) for _ in range(3)]
    colours = np.stack([(c - c.mean()) * 14.0 + 120.0 for c in coarse], axis=-1)
    fine = ndimage.gaussian_filter(rng.normal(0.0, 60.0, (400, 900, 1)), (0.8, 0.8, 0.0))
    return np.clip(colours + fine, 5, 245).astype(np.uint8)


def view(index: int, width: int = WIDTH, height: int = HEIGHT) -> Image.Image:
    """Return a textured photograph, another for every index."""
    rows, columns = 17 * index % (400 - HEIGHT), 97 * index % (900 - WIDTH)
    image = Image.fromarray(_canvas()[rows : rows + HEIGHT, columns : columns + WIDTH])
    return image if (width, height) == (WIDTH, HEIGHT) else image.resize((width, height))


def exif(**changes: object) -> bytes:
    """Return the EXIF of an ordinary photograph; `changes` replaces focal length, time and sizes."""
    facts = {
        "focal": 28.0,
        "focal35": 42,
        "time": IFDRational(1, 60),
        "lens": "28mm F2",
        "size": (WIDTH, HEIGHT),
    }
    facts.update(changes)
    tags = Image.Exif()
    tags.update({0x010F: "Camera", 0x0110: "One", 0x0112: facts.get("orientation", 1)})
    tags.get_ifd(0x8769).update(
        {
            0x829A: facts["time"],
            0x829D: IFDRational(8, 1),
            0x8827: 100,
            0x920A: IFDRational(round(10 * float(facts["focal"])), 10),
            0xA405: facts["focal35"],
            0xA434: facts["lens"],
            0xA002: facts["size"][0],
            0xA003: facts["size"][1],
        }
    )
    return tags.tobytes()


def write_views(
    folder: Path, count: int = NUM_VIEWS, suffix: str = ".jpg", first: int = 0, **options: object
) -> None:
    """Write `count` sound photographs."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(first, first + count):
        if suffix == ".jpg":
            view(index).save(folder / f"IMG_{index:04d}.jpg", quality=90, **({"exif": exif()} | options))
        else:
            view(index).save(folder / f"IMG_{index:04d}{suffix}", **options)


def heif() -> None:
    """Teach Pillow to write HEIC."""
    import pillow_heif

    pillow_heif.register_heif_opener()


# --- Too little --------------------------------------------------------------------------------------------


@bad("an empty folder", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()


@bad("one photograph", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    write_views(folder, 1)


@bad("two photographs", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    write_views(folder, 2)


@bad("a text file only", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    (folder / "readme.txt").write_text("photographs follow")


@bad("a video only", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    (folder / "clip.MOV").write_bytes(b"\0\0\0\x14ftypqt  " + b"\0" * 100)


@bad("GIFs only", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"{index}.gif")


@bad("TIFFs only", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"{index}.tif")


@bad("a zip in the folder", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    (folder / "photographs.zip").write_bytes(b"PK\x05\x06" + b"\0" * 18)


@bad("thumbnails of the system only", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0" + b"\0" * 60)
    (folder / ".DS_Store").write_bytes(b"\0\0\0\1Bud1" + b"\0" * 60)
    for index in range(5):
        (folder / f"._IMG_{index}.jpg").write_bytes(b"\0\5\x16\7" + b"\0" * 60)


@bad("masks in a folder of masks only", "scene.only_masks", error=True)
def _(folder: Path) -> None:
    (folder / "masks").mkdir(parents=True)
    for index in range(5):
        _mask(index).save(folder / "masks" / f"{index}.png")


@bad("masks for photographs", "scene.only_masks", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(5):
        _mask(index).save(folder / f"{index}.png")


def _mask(index: int) -> Image.Image:
    image = Image.new("L", (WIDTH, HEIGHT))
    ImageDraw.Draw(image).ellipse((20 + 9 * index, 30, 90 + 9 * index, 110), fill=255)
    return image


@bad("masks among the photographs", "scene.mask_among_photographs")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "reference").mkdir()
    for index in range(5):
        _mask(index).save(folder / "reference" / f"{index}.png")


# --- The same again ----------------------------------------------------------------------------------------


@bad("copies of one photograph", "scene.photographs_same", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(6):
        view(0).save(folder / f"{index}.jpg", exif=exif())


@bad("one photograph saved at several qualities", "scene.photographs_same", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(6):
        view(0).save(folder / f"{index}.jpg", quality=95 - 4 * index)


@bad("a burst from a tripod", "scene.photographs_same", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    rng = np.random.default_rng(3)
    for index in range(6):
        noisy = np.asarray(view(0)) + rng.normal(0.0, 2.0, (HEIGHT, WIDTH, 3))
        Image.fromarray(noisy.clip(0, 255).astype(np.uint8)).save(folder / f"{index}.jpg", quality=95)


@bad("two views many times", "scene.photographs_same", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(8):
        view(index % 2).save(folder / f"{index}.jpg", quality=90 - index)


@bad("a few copies", "scene.image_duplicate")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "copy of IMG_0002.jpg").write_bytes((folder / "IMG_0002.jpg").read_bytes())


@bad("a photograph saved again", "scene.photographs_alike")
def _(folder: Path) -> None:
    write_views(folder)
    view(2).save(folder / "edited.jpg", quality=60)


@bad("photographs from almost one place", "scene.photographs_alike")
def _(folder: Path) -> None:
    folder.mkdir()
    whole = Image.fromarray(_canvas())
    for index in range(8):
        whole.crop((index, 0, index + WIDTH, HEIGHT)).save(folder / f"{index}.jpg", quality=90, exif=exif())


@bad("each photograph twice, as PNG and JPEG", "scene.saved_twice")
def _(folder: Path) -> None:
    write_views(folder)
    write_views(folder, suffix=".png")


@bad("raw and JPEG of each", "scene.saved_twice")
def _(folder: Path) -> None:
    write_views(folder, 4)
    for index in range(4):
        linear = (np.asarray(view(index), dtype=np.float64) / 255.0) ** 2.2
        write_dng(folder / f"IMG_{index:04d}.dng", linear)


# --- Damaged files -----------------------------------------------------------------------------------------


@bad("all JPEGs cut off", "scene.image_broken", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    write_views(folder)
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@bad("one JPEG cut off", "scene.image_broken")
def _(folder: Path) -> None:
    write_views(folder)
    path = folder / "IMG_0001.jpg"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@bad("more than half cut off", "scene.image_broken", error=True)
def _(folder: Path) -> None:
    write_views(folder, 7)
    for index in range(4):
        path = folder / f"IMG_{index:04d}.jpg"
        path.write_bytes(path.read_bytes()[:-900])


@bad("a file of zero bytes", "scene.image_not_a_picture")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "IMG_0002.jpg").write_bytes(b"")


@bad("files of zeros after a full disk", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(5):
        (folder / f"{index}.jpg").write_bytes(b"\0" * 5000)


@bad("text files named .jpg", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(5):
        (folder / f"{index}.jpg").write_text("404 not found")


@bad("web pages named .jpg among photographs", "scene.image_not_a_picture")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "IMG_0001.jpg").write_text("<!DOCTYPE html><html></html>")


@bad("GIFs named .jpg", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"{index}.jpg", format="GIF")


@bad("TIFFs named .png", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"{index}.png", format="TIFF")


@bad("videos named .jpg", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        (folder / f"{index}.jpg").write_bytes(b"\0\0\0\x18ftypmp42" + b"\0" * 400)


@bad("pointers of Git LFS", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        (folder / f"{index}.jpg").write_text(f"version https://git-lfs.github.com/spec/v1\nsize {index}\n")


@bad("a PNG with a wrong checksum", "scene.image_broken")
def _(folder: Path) -> None:
    write_views(folder, suffix=".png")
    content = bytearray((folder / "IMG_0001.png").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (folder / "IMG_0001.png").write_bytes(content)


@bad("a PNG without its end", "scene.image_broken")
def _(folder: Path) -> None:
    write_views(folder, suffix=".png")
    path = folder / "IMG_0003.png"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


@bad("a damaged WebP", "scene.image_not_a_picture")
def _(folder: Path) -> None:
    write_views(folder, suffix=".webp")
    path = folder / "IMG_0000.webp"
    path.write_bytes(path.read_bytes()[:-400])


@bad("a damaged HEIC", "scene.image_not_a_picture")
def _(folder: Path) -> None:
    heif()
    write_views(folder, suffix=".heic")
    path = folder / "IMG_0002.heic"
    path.write_bytes(path.read_bytes()[:200])


@bad("a HEIC that ends too early", "scene.image_broken")
def _(folder: Path) -> None:
    heif()
    write_views(folder, suffix=".heic")
    path = folder / "IMG_0002.heic"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


@bad("raw files that are none", "scene.image_not_a_picture", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        (folder / f"DSC_{index}.NEF").write_bytes(b"II*\0" + struct.pack("<I", 8) + b"\0" * 300)


@bad("a folder named like a photograph", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    write_views(folder, 2)
    (folder / "IMG_0009.jpg").mkdir()


# --- Sizes -------------------------------------------------------------------------------------------------


@bad("photographs of one pixel", "scene.image_tiny", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(5):
        Image.new("RGB", (1, 1), (50 * index, 0, 0)).save(folder / f"{index}.png")


@bad("a thumbnail among photographs", "scene.image_tiny")
def _(folder: Path) -> None:
    write_views(folder)
    view(9).resize((60, 45)).save(folder / "small.jpg")


@bad("a panorama of 20 000 pixels", "scene.image_too_large")
def _(folder: Path) -> None:
    write_views(folder)
    huge_png(folder / "panorama.png", 20000)


@bad("panoramas only", "scene.panorama")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index, 500, 150).save(folder / f"PANO_{index}.jpg", exif=exif(size=(500, 150)))


@bad("a picture that says it is a sphere", "scene.panorama")
def _(folder: Path) -> None:
    write_views(folder)
    xmp = b"<x:xmpmeta><GPano:ProjectionType>equirectangular</GPano:ProjectionType></x:xmpmeta>"
    view(8, 300, 150).save(folder / "sphere.jpg", xmp=xmp)


@bad("a bomb of a header", "scene.image_too_large", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        huge_png(folder / f"{index}.png", 60000 + index)


# --- Content -----------------------------------------------------------------------------------------------


@bad("the lens cap on", "scene.image_blank", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    rng = np.random.default_rng(5)
    for index in range(5):
        dark = rng.normal(3.0, 0.7, (HEIGHT, WIDTH, 3)).clip(0, 255).astype(np.uint8)
        Image.fromarray(dark).save(folder / f"{index}.jpg", exif=exif())


@bad("one black photograph", "scene.image_blank")
def _(folder: Path) -> None:
    write_views(folder)
    Image.new("RGB", (WIDTH, HEIGHT)).save(folder / "black.jpg", exif=exif())


@bad("overexposed photographs", "scene.image_clipped")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(5):
        bright = np.asarray(view(index), dtype=np.int32) * 3
        Image.fromarray(bright.clip(0, 255).astype(np.uint8)).save(folder / f"{index}.jpg", exif=exif())


@bad("blurred photographs among sharp ones", "scene.image_blurred")
def _(folder: Path) -> None:
    write_views(folder, 6)
    for index in (6, 7):
        soft = ndimage.gaussian_filter(np.asarray(view(index)), (2.0, 2.0, 0.0))
        Image.fromarray(soft).save(folder / f"IMG_{index:04d}.jpg", quality=95, exif=exif())


@bad("exposure from night to day", "scene.exposure_spread")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(6):
        darker = (np.asarray(view(index)) * (0.3 + 0.14 * index)).astype(np.uint8)
        Image.fromarray(darker).save(folder / f"{index}.jpg", exif=exif())


@bad("screenshots", "scene.screenshot", "scene.photographs_alike")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        screen = Image.new("RGB", (180, 390), (250, 250, 252))
        screen.paste(view(index, 170, 128), (5, 60))
        ImageDraw.Draw(screen).rectangle((0, 300, 180, 340), fill=(20 * index, 90, 200))
        screen.save(folder / f"capture {index}.png")


@bad("files that are called screenshots", "scene.screenshot")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"Screenshot_2024-05-0{index}.jpg")


@bad("frames of a video", "scene.video_frames")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(6):
        view(index, 1280, 720).save(folder / f"frame_{index:04d}.jpg", quality=70)


@bad("animations", "scene.animation")
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"{index}.webp", save_all=True, append_images=[view(index + 9)])


# --- EXIF --------------------------------------------------------------------------------------------------


@bad("cropped photographs with the EXIF of the whole", "scene.exif_wrong")
def _(folder: Path) -> None:
    write_views(folder, exif=exif(size=(6000, 3000)))


@bad("an impossible focal length", "scene.exif_wrong")
def _(folder: Path) -> None:
    write_views(folder, exif=exif(focal=65000.0, focal35=65000))


@bad("an exposure of a day", "scene.exif_wrong")
def _(folder: Path) -> None:
    write_views(folder, exif=exif(time=IFDRational(86400, 1)))


@bad("a fisheye by its name", "scene.fisheye")
def _(folder: Path) -> None:
    write_views(folder, exif=exif(lens="8-15mm f/4L FISH-EYE USM"))


@bad("an extremely wide lens", "scene.fisheye")
def _(folder: Path) -> None:
    write_views(folder, exif=exif(focal=1.5, focal35=12))


# --- Names and places --------------------------------------------------------------------------------------


@bad("a name that is no text", "scene.name_unusable")
def _(folder: Path) -> None:
    write_views(folder)
    content = (folder / "IMG_0000.jpg").read_bytes()
    Path(os.fsdecode(os.fsencode(folder) + b"/bad\xff\xfename.jpg")).write_bytes(content + b"x")


@bad("a name with a line break", "scene.name_unusable")
def _(folder: Path) -> None:
    write_views(folder)
    view(8).save(folder / "a\nb.jpg")


@bad("a link out of the folder", "scene.file_linked")
def _(folder: Path) -> None:
    write_views(folder)
    outside = folder.parent / "outside"
    outside.mkdir()
    view(8).save(outside / "secret.jpg")
    (folder / "linked.jpg").symlink_to(outside / "secret.jpg")


@bad("a link to a folder, in a circle", "scene.file_linked")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "again").symlink_to(folder, target_is_directory=True)


@bad("a link that leads nowhere", "scene.file_linked")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "gone.jpg").symlink_to(folder / "missing.jpg")


@bad("links only", "scene.file_linked", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    outside = folder.parent / "outside"
    write_views(outside)
    folder.mkdir()
    for path in outside.iterdir():
        (folder / path.name).symlink_to(path)


# --- What only cameras show --------------------------------------------------------------------------------


def write_needing_cameras(name: str, folder: Path, photographs: list[Path]) -> None:
    """Write one of `NEED_CAMERAS`, made from sound photographs of one object.

    "two objects" and "unrelated photographs" take the second half of them from the texture of this module.
    """
    folder.mkdir(parents=True)
    for index, path in enumerate(sorted(photographs)):
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"))
        foreign = np.asarray(view(index, pixels.shape[1], pixels.shape[0]))
        if name == "mirrored":
            pixels = pixels[:, ::-1] if index % 2 else pixels
        elif name == "two objects":
            pixels = foreign if index >= len(photographs) // 2 else pixels
        elif name == "unrelated photographs":
            pixels = foreign
        elif name == "fisheye without EXIF":
            pixels = _as_fisheye(pixels)
        elif name == "rolling shutter":
            pixels = _sheared(pixels, 0.12 if index % 2 else -0.12)
        else:
            raise KeyError(name)
        Image.fromarray(np.ascontiguousarray(pixels)).save(folder / f"{index:03d}.jpg", quality=92)


def _as_fisheye(pixels: ndarray) -> ndarray:
    """Return the picture that an equidistant lens of 150 degrees makes of a photograph of 75 degrees."""
    height, width = pixels.shape[:2]
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    across, down = columns - 0.5 * width, rows - 0.5 * height
    radius = np.hypot(across, down) / (0.5 * width)
    factor = (
        np.tan(np.minimum(radius * np.radians(37.5), 1.3))
        / np.tan(np.radians(37.5))
        / np.maximum(radius, 1e-6)
    )
    places = (down * factor + 0.5 * height, across * factor + 0.5 * width)
    planes = [ndimage.map_coordinates(pixels[..., c], places, order=1, mode="nearest") for c in range(3)]
    return np.stack(planes, axis=-1)


def _sheared(pixels: ndarray, slope: float) -> ndarray:
    """Return the picture of a shutter that moves down while the camera moves sideways."""
    rows = np.arange(pixels.shape[0])
    shift = np.round(slope * (rows - 0.5 * len(rows))).astype(int)
    columns = (np.arange(pixels.shape[1])[None] + shift[:, None]).clip(0, pixels.shape[1] - 1)
    return pixels[rows[:, None], columns]

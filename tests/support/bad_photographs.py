"""Captures that show too little, the same again, or something else than an object."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from PIL.TiffImagePlugin import IFDRational
from scipy import ndimage
from support.bad_captures import bad
from support.photographs import HEIGHT, WIDTH, canvas, exif, view, write_views
from support.raw_files import write_dng

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


@bad("BMPs only", "scene.too_few_images", error=True)
def _(folder: Path) -> None:
    folder.mkdir()
    for index in range(4):
        view(index).save(folder / f"{index}.bmp")


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


@bad("two captures in one folder", "scene.photographs_in_folders")
def _(folder: Path) -> None:
    write_views(folder / "jug", 8)
    write_views(folder / "bowl", 8, first=8)


@bad("photographs from almost one place", "scene.photographs_alike")
def _(folder: Path) -> None:
    folder.mkdir()
    whole = Image.fromarray(canvas())
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

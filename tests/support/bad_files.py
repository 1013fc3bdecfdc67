"""Captures whose files, sizes, names or links are bad."""

import os
import struct
from pathlib import Path

from PIL import Image
from support.bad_captures import bad
from support.hostile_files import huge_png
from support.photographs import exif, heif, view, write_views

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


@bad("TIFFs named .png")
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


# --- Names and places --------------------------------------------------------------------------------------


@bad("a name that is not a text", "scene.name_unusable")
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


@bad("a link to a folder elsewhere", "scene.file_linked")
def _(folder: Path) -> None:
    write_views(folder)
    (folder / "again").symlink_to(folder, target_is_directory=True)  # nothing new, so no finding
    (folder / "above").symlink_to(folder.parent, target_is_directory=True)


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

"""Every kind of picture opens to the same pixels, and what is none is refused with a reason."""

import numpy as np
import pytest
from lambent_capture.pictures.mask_levels import NERO_DEPTH, read_mask
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import (
    MAX_PIXELS,
    encoding_of,
    picture_facts,
    picture_format,
    picture_size,
    read_levels,
    read_picture,
)
from PIL import Image

GREY = np.linspace(0, 255, 20 * 30).reshape(20, 30).astype(np.uint8)
COLOUR = np.stack([GREY, GREY[::-1], GREY[:, ::-1]], axis=-1)


def write_hdr(path, pixels):
    """Write linear pixels as flat RGBE, so that the reader under test shares no code with the writer."""
    largest = pixels.max(axis=-1, keepdims=True)
    exponent = np.ceil(np.log2(np.maximum(largest, 1e-30)) + 1e-9)
    mantissa = np.clip(np.floor(pixels / 2.0**exponent * 256.0), 0, 255)
    stored = np.concatenate([mantissa, exponent + 128], axis=-1).astype(np.uint8)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n-Y {pixels.shape[0]} +X {pixels.shape[1]}\n"
    path.write_bytes(head.encode() + stored.tobytes())


@pytest.mark.parametrize("suffix", [".png", ".webp", ".jpg", ".heic", ".JPEG"])
def test_an_eight_bit_picture_opens_whatever_its_format(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    options = {"lossless": True} if suffix == ".webp" else {"quality": 100}
    if suffix == ".heic":
        import pillow_heif

        pillow_heif.register_heif_opener()
    Image.fromarray(COLOUR).save(path, **({} if suffix == ".png" else options))
    assert picture_size(path) == (30, 20)
    assert encoding_of(path.name) == "srgb"
    pixels = read_levels(path)
    assert pixels.dtype == np.uint8
    difference = np.abs(pixels[..., :3].astype(int) - COLOUR).mean()
    assert difference < (0.01 if suffix in (".png", ".webp") else 10.0)
    assert not picture_facts(path).has_background


@pytest.mark.parametrize(("named", "kind"), [("a.jpg", "HEIF"), ("a.png", "JPEG"), ("a.HEIC", "PNG")])
def test_a_picture_is_read_by_its_content_whatever_its_suffix(tmp_path, named, kind):
    import pillow_heif

    pillow_heif.register_heif_opener()
    Image.fromarray(COLOUR).save(tmp_path / named, format=kind, quality=100)
    assert picture_format(tmp_path / named) == kind
    assert np.abs(read_levels(tmp_path / named)[..., :3].astype(int) - COLOUR).mean() < 10.0


NO_PICTURES = {
    b"": "it is empty",
    b"GIF89a" + b"\0" * 20: "it is a GIF",
    b"8BPS" + b"\0" * 20: "it is a Photoshop file",
    b"\0\0\0\x18ftypqt  " + b"\0" * 8: "it is a video",
    b"%PDF-1.7 ........": "it is a PDF",
    b"no picture at all": "it is text",
    b"\0" * 40: "it holds zeros only",
    b"\x80\x04\x95" + b"\xff" * 20: "it begins like no picture",
}


@pytest.mark.parametrize(("content", "what"), NO_PICTURES.items(), ids=NO_PICTURES.values())
def test_what_is_no_picture_is_called_what_it_is(tmp_path, content, what):
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(PictureError, match=what) as refused:
        read_levels(tmp_path / "a.jpg")
    assert refused.value.code == "scene.image_not_a_picture"


def test_what_phones_add_to_a_jpeg_does_not_disturb(tmp_path):
    gain_map = Image.fromarray(GREY[::2, ::2]).convert("RGB")
    Image.fromarray(COLOUR).save(
        tmp_path / "mpo.jpg", "MPO", save_all=True, append_images=[gain_map], quality=100
    )
    whole = (tmp_path / "mpo.jpg").read_bytes()
    (tmp_path / "tail.jpg").write_bytes(whole + b"MotionPhoto_Data" * 100)
    Image.fromarray(COLOUR).save(tmp_path / "progressive.jpg", progressive=True, quality=100)
    damaged = whole.replace(b"MPF\0", b"MPF\0\xff\xff\xff", 1)
    (tmp_path / "damaged.jpg").write_bytes(damaged)
    for name in ("mpo.jpg", "tail.jpg", "progressive.jpg", "damaged.jpg"):
        assert picture_size(tmp_path / name) == (30, 20)
        assert np.abs(read_levels(tmp_path / name).astype(int) - COLOUR).mean() < 10.0


def test_sixteen_bit_colours_keep_their_precision(tmp_path):
    import cv2

    deep = COLOUR.astype(np.uint16) * 257 - (COLOUR > 0)
    cv2.imwrite(str(tmp_path / "a.png"), deep[..., ::-1])
    np.testing.assert_array_equal(read_levels(tmp_path / "a.png"), deep)
    assert np.abs(read_picture(tmp_path / "a.png").srgb().astype(int) - COLOUR).max() <= 1


def test_a_radiance_picture_is_linear_and_divided_by_its_exposure(tmp_path):
    radiance = np.random.default_rng(0).uniform(0.1, 4.0, (7, 9, 3))
    write_hdr(tmp_path / "a.hdr", radiance)
    assert picture_size(tmp_path / "a.hdr") == (9, 7)
    assert encoding_of("a.HDR") == "linear"
    np.testing.assert_allclose(read_levels(tmp_path / "a.hdr"), radiance / 2.0, rtol=0.1, atol=0.02)
    assert picture_facts(tmp_path / "a.hdr").is_finite


DAMAGED = {
    "truncated": (lambda data: data[:-40], "scene.image_broken"),
    "without a size": (lambda data: data.replace(b"-Y 7 +X 9", b"-Y q +X 9"), "scene.image_broken"),
    "of another kind": (lambda data: b"GIF89a" + data, "scene.image_not_a_picture"),
    "in CIE XYZ": (lambda data: data.replace(b"rle_rgbe", b"rle_xyze"), "scene.image_broken"),
    "too large": (lambda data: data.replace(b"-Y 7 +X 9", b"-Y 70000 +X 9999"), "scene.image_too_large"),
}


@pytest.mark.parametrize(("damage", "code"), DAMAGED.values(), ids=DAMAGED.keys())
def test_a_damaged_radiance_picture_is_refused_with_a_reason(tmp_path, damage, code):
    path = tmp_path / "a.hdr"
    write_hdr(path, np.ones((7, 9, 3)))
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(PictureError) as refused:
        read_levels(path)
    assert refused.value.code == code


def test_sixteen_bit_grey_keeps_its_precision_as_a_mask_and_as_a_photograph(tmp_path):
    level = np.array([[0, 257, 32896, 65535]], dtype=np.uint16)
    Image.fromarray(level).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_mask(tmp_path / "a.png").coverage, level / 65535.0, atol=1e-6)
    np.testing.assert_array_equal(read_levels(tmp_path / "a.png")[..., 0], level)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png").srgb()[0, :, 1], [0, 1, 128, 255])


def test_a_depth_picture_covers_what_is_nearer_than_the_background(tmp_path):
    depth = np.array([[2.0, 14.4, 14.6, 15.0]])
    Image.fromarray(np.round(depth / 15.0 * 65535.0).astype(np.uint16)).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png", NERO_DEPTH).coverage, [[1.0, 1.0, 0.0, 0.0]])


def test_the_suffix_of_something_else_is_refused_with_those_that_are_read(tmp_path):
    (tmp_path / "a.gif").write_bytes(b"GIF89a")
    with pytest.raises(PictureError, match="use JPEG, HEIC, PNG, WebP, AVIF, TIFF, EXR, HDR or"):
        picture_size(tmp_path / "a.gif")


def test_more_pixels_than_the_limit_are_refused_by_the_header(tmp_path):
    Image.new("1", (16384, MAX_PIXELS // 16384 + 1)).save(tmp_path / "a.png")
    with pytest.raises(PictureError) as refused:
        read_levels(tmp_path / "a.png")
    assert refused.value.code == "scene.image_too_large"

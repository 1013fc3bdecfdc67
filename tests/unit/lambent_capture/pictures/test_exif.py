"""A camera's EXIF is read wherever it is, and damaged or absent EXIF says nothing."""

import numpy as np
import pytest
from lambent_capture.pictures.exif import ExifFacts, exif_facts
from lambent_capture.pictures.pictures import picture_size, read_levels
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from strangers.profiles import chunk, png

IMAGE = Image.fromarray(np.random.default_rng(0).integers(0, 255, (30, 40, 3), dtype=np.uint8))


def phone_exif(orientation=6):
    exif = Image.Exif()
    exif.update(
        {0x010F: "Apple", 0x0110: "Apple iPhone 13", 0x0112: orientation, 0x0132: "2024:05:01 10:11:12"}
    )
    exif.get_ifd(0x8769).update(
        {
            0x829A: IFDRational(1, 100),
            0x829D: IFDRational(16, 10),
            0x8827: 64,
            0x9003: "2024:05:01 10:11:13",
            0x9204: IFDRational(-1, 3),
            0x920A: IFDRational(57, 10),
            0xA002: 4032,
            0xA003: 3024,
            0xA403: 0,
            0xA405: 26,
            0xA434: "iPhone 13 back camera",
        }
    )
    return exif


def test_all_facts_of_a_phones_photograph(tmp_path):
    IMAGE.save(tmp_path / "a.jpg", exif=phone_exif())
    facts = exif_facts(tmp_path / "a.jpg")
    assert facts == ExifFacts(
        make="Apple",
        model="Apple iPhone 13",
        lens="iPhone 13 back camera",
        focal_mm=5.7,
        focal_35mm=26.0,
        orientation=6,
        time_s=0.01,
        f_number=1.6,
        iso=64.0,
        bias_ev=pytest.approx(-1 / 3),
        white_balance="auto",
        taken="2024-05-01T10:11:13",
        stated_size=(4032, 3024),
    )
    assert facts.camera == "Apple iPhone 13"
    assert facts.focal_pixels(4032, 3024) == pytest.approx(26.0 / 43.2666 * 5040.0, rel=1e-4)


@pytest.mark.parametrize("suffix", [".png", ".webp"])
def test_other_formats_tell_the_same(tmp_path, suffix):
    IMAGE.save(tmp_path / f"a{suffix}", exif=phone_exif())
    assert exif_facts(tmp_path / f"a{suffix}").focal_35mm == 26.0


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_of_heic_header_pixels_and_orientation_agree(tmp_path, orientation):
    import pillow_heif

    pillow_heif.register_heif_opener()
    corner = np.zeros((32, 48, 3), dtype=np.uint8)
    corner[:16, :24] = 255
    Image.fromarray(corner).save(tmp_path / "a.heic", quality=95, exif=phone_exif(orientation).tobytes())
    upright = np.rot90(corner, {1: 0, 3: 2, 6: 3, 8: 1}[orientation])
    assert picture_size(tmp_path / "a.heic") == upright.shape[1::-1]
    assert np.abs(read_levels(tmp_path / "a.heic")[..., :3].astype(int) - upright).mean() < 8.0
    assert exif_facts(tmp_path / "a.heic").orientation == 1


def test_stored_pixels_of_a_turned_jpeg_stay_as_they_are_stored(tmp_path):
    IMAGE.save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=phone_exif(6))
    assert picture_size(tmp_path / "a.jpg") == (40, 30)
    assert np.abs(read_levels(tmp_path / "a.jpg").astype(int) - np.asarray(IMAGE)).mean() < 3.0


def test_no_exif_and_broken_exif_say_nothing(tmp_path):
    IMAGE.save(tmp_path / "plain.jpg")
    IMAGE.save(tmp_path / "broken.jpg", exif=b"Exif\0\0II*\0\xff\xff\xff\xff")
    for name in ("plain.jpg", "broken.jpg"):
        facts = exif_facts(tmp_path / name)
        assert facts.is_silent
        assert facts.orientation == 1
        assert facts.focal_pixels(40, 30) == 0.0


def test_impossible_numbers_are_not_taken_over(tmp_path):
    exif = phone_exif(orientation=42)
    exif.get_ifd(0x8769).update(
        {0x829A: IFDRational(1, 0), 0x920A: IFDRational(0, 0), 0x9003: "yesterday", 0x8827: (100, 200)}
    )
    IMAGE.save(tmp_path / "a.jpg", exif=exif)
    facts = exif_facts(tmp_path / "a.jpg")
    assert (facts.orientation, facts.time_s, facts.focal_mm, facts.iso) == (1, 0.0, 0.0, 100.0)
    assert facts.taken == ""


def test_exif_behind_the_pixels_of_a_png_counts(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    (tmp_path / "a.png").write_bytes(
        png(np.zeros((4, 6, 3), dtype=np.uint8), bits=8).replace(
            chunk(b"IEND", b""),
            chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0")) + chunk(b"IEND", b""),
        )
    )
    assert exif_facts(tmp_path / "a.png").orientation == 6

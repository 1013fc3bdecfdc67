"""Reads what a camera wrote about a photograph: EXIF of JPEG, PNG, WebP and HEIC, and of raw files.

Tags: CIPA DC-008 (Exif 2.32). Everything is optional, and everything may be wrong: programs that scale or
crop keep the tags of the original.
"""

import io
import math
import warnings
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from lambent_core.layouts import RAW_SUFFIXES
from PIL import Image

from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.picture_statements import MIRRORED
from lambent_capture.pictures.pictures import PILLOW_FORMATS, opened, picture_format
from lambent_capture.pictures.png_header import late_exif
from lambent_capture.pictures.raw_pictures import raw_settings

MAKE, MODEL, ORIENTATION, DATE = 0x010F, 0x0110, 0x0112, 0x0132
EXIF_FOLDER = 0x8769
TIME, F_NUMBER, ISO, TAKEN, BIAS = 0x829A, 0x829D, 0x8827, 0x9003, 0x9204
FOCAL, COMMENT, ACROSS, DOWN = 0x920A, 0x9286, 0xA002, 0xA003
WHITE_BALANCE, ZOOM, FOCAL_35MM, LENS = 0xA403, 0xA404, 0xA405, 0xA434
_UNMIRRORED = {2: 1, 4: 3, 5: 8, 7: 6}
"""What is left of an orientation once left and right are exchanged."""
PLANE_X, PLANE_UNIT = 0xA20E, 0xA210
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_DIAGONAL_35MM = 43.267
"""Of 36 x 24 mm, which the equivalent focal length in EXIF refers to (CIPA DCG-001)."""
_TIFF_STARTS = (b"II*\0", b"MM\0*")
_TIFF_LIKE_STARTS = (b"IIRO", b"IIRS", b"IIU\0")
"""ORF and RW2: TIFF but for their first four bytes."""
_MAX_RAW_BYTES = 256 * 2**20


@dataclass(frozen=True, kw_only=True, slots=True)
class ExifFacts:
    """How a photograph was taken; "" and 0 stand for what the file does not say."""

    make: str = ""
    model: str = ""
    lens: str = ""
    focal_mm: float = 0.0
    focal_35mm: float = 0.0
    """Focal length that gives the same diagonal field of view on 36 x 24 mm, millimetres; includes digital
    zoom."""
    digital_zoom: float = 0.0
    orientation: int = 1
    """1, 3, 6 or 8; how pixels as `read_picture` gives them are to be turned for a person."""
    is_mirrored: bool = False
    """Whether the file stores a mirror image, which `read_picture` mirrors back."""
    time_s: float = 0.0
    f_number: float = 0.0
    iso: float = 0.0
    bias_ev: float | None = None
    """Exposure compensation that the photographer chose, in EV."""
    white_balance: str = ""
    """"auto" or "manual"."""
    taken: str = ""
    """Date and local time, ISO 8601."""
    stated_size: tuple[int, int] = (0, 0)
    """Width and height in pixels that the camera wrote."""
    plane_per_mm: float = 0.0
    """Pixels of the photograph as taken for each millimetre of the sensor."""
    comment: str = ""

    @property
    def camera(self) -> str:
        """Return make and model, or "" where neither is known."""
        named = (
            self.model if self.model.lower().startswith(self.make.lower()) else f"{self.make} {self.model}"
        )
        return named.strip()

    @property
    def is_silent(self) -> bool:
        """Return whether the file says nothing about a camera, as after a messenger or a screenshot."""
        return not (self.camera or self.lens or self.focal_mm or self.focal_35mm or self.time_s or self.iso)

    def focal_pixels(self, width: int, height: int) -> float:
        """Return the focal length in pixels of a picture of that size, or 0 where only a guess would do.

        From the focal length in 35 mm terms, which compares diagonals, or from the sensor's pixels; wrong for
        cropped pictures. Source: EXIF 2.32, FocalLengthIn35mmFilm, FocalPlaneXResolution.
        """
        if self.focal_35mm:
            return self.focal_35mm / _DIAGONAL_35MM * math.hypot(width, height)
        # The resolution counts pixels of the photograph as taken; it may have been reduced since.
        scale = max(width, height) / max(self.stated_size) if any(self.stated_size) else 1.0
        return self.focal_mm * self.plane_per_mm * scale


def exif_facts(path: Path) -> ExifFacts:
    """Return what a picture's EXIF says; reads the header only, or all of a raw file that is not a TIFF.

    Of HEIC the orientation is 1: libheif has applied it. Damaged EXIF says nothing. Raises `PictureError` for
    a file that cannot be opened.
    """
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        return _of_raw(path)
    if suffix not in PILLOW_FORMATS:
        return ExifFacts()
    return _facts(*exif_tags(path))


def exif_tags(path: Path) -> tuple[dict[int, Any], dict[int, Any]]:
    """Return the tags of an encoded picture's first folder and of its EXIF folder; nothing where damaged.

    Raises `PictureError` for a file that cannot be opened.
    """
    is_tiff = picture_format(path) == "TIFF"
    either: Any = path.open("rb") if is_tiff else opened(path)
    with either as source:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                if not is_tiff and source.format == "PNG" and "exif" not in source.info:
                    # Behind the pixels; Pillow would decode them all to find it.
                    exif = Image.Exif()
                    exif.load(late_exif(path))
                else:
                    exif = _of_tiff(source) if is_tiff else source.getexif()
                return dict(exif), dict(exif.get_ifd(EXIF_FOLDER))
        except Exception:  # damaged EXIF says nothing, and the picture is still a picture
            return {}, {}


def _of_tiff(file: Any) -> Image.Exif:
    exif = Image.Exif()
    exif.load_from_fp(file)
    return exif


def _of_raw(path: Path) -> ExifFacts:
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start = file.read(4)
        try:
            exif = Image.Exif()
            if start in _TIFF_STARTS:
                file.seek(0)
                exif.load_from_fp(file)
            elif start in _TIFF_LIKE_STARTS:
                exif.load_from_fp(io.BytesIO(b"II*\0" + file.read(_MAX_RAW_BYTES)))
            facts = _facts(dict(exif), dict(exif.get_ifd(EXIF_FOLDER)))
        except Exception:  # as in `exif_facts`
            facts = ExifFacts()
    if not facts.is_silent and facts.time_s:
        return facts
    known = raw_settings(path)
    return ExifFacts(
        make=facts.make,
        model=facts.model,
        lens=known["lens"],
        focal_mm=_positive(known["focal_mm"]),
        orientation={0: 1, 3: 3, 5: 8, 6: 6}.get(known["flip"], 1),
        time_s=_positive(known["time_s"]),
        f_number=_positive(known["f_number"]),
        iso=_positive(known["iso"]),
        taken=known["taken"].isoformat() if known["taken"].year > 1990 else "",
    )


def _facts(exif: dict[int, Any], tags: dict[int, Any]) -> ExifFacts:
    orientation = exif.get(ORIENTATION, 1)
    return ExifFacts(
        make=_text(exif.get(MAKE)),
        model=_text(exif.get(MODEL)),
        lens=_text(tags.get(LENS)),
        focal_mm=_positive(tags.get(FOCAL)),
        focal_35mm=_positive(tags.get(FOCAL_35MM)),
        digital_zoom=_positive(tags.get(ZOOM)),
        orientation=_UNMIRRORED.get(orientation, orientation) if orientation in range(1, 9) else 1,
        is_mirrored=orientation in MIRRORED,
        time_s=_positive(tags.get(TIME)),
        f_number=_positive(tags.get(F_NUMBER)),
        iso=_positive(tags.get(ISO)),
        bias_ev=_number(tags.get(BIAS)),
        white_balance={0: "auto", 1: "manual"}.get(tags.get(WHITE_BALANCE, -1), ""),
        taken=_date(tags.get(TAKEN) or exif.get(DATE)),
        stated_size=(int(_positive(tags.get(ACROSS))), int(_positive(tags.get(DOWN)))),
        plane_per_mm=_positive(tags.get(PLANE_X)) / _UNIT_MM.get(int(_positive(tags.get(PLANE_UNIT))), 25.4),
        comment=_text(tags.get(COMMENT)),
    )


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.removeprefix(b"ASCII\0\0\0").removeprefix(b"UNICODE\0").decode("latin-1")
    printable = "".join(letter for letter in str(value or "") if letter.isprintable())
    return " ".join(printable.split())[:100]


def _date(value: Any) -> str:
    try:
        return datetime.strptime(_text(value)[:19], "%Y:%m:%d %H:%M:%S").isoformat()
    except ValueError:
        return ""


def _number(value: Any) -> float | None:
    """Return an EXIF number, the first of several, or None where it is none; those above 1e9 mean nothing."""
    if isinstance(value, tuple | list):
        value = value[0] if value else None
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if abs(number) < 1e9 else None


def _positive(value: Any) -> float:
    """Return an EXIF number, or 0 where it is none above 0."""
    return max(_number(value) or 0.0, 0.0)

"""Colour spaces of photographs, and their way to linear Rec. 709.

A picture states its colours by an ICC profile, by code points of ITU-T H.273 (PNG's cICP, the nclx box of
HEIC and AVIF), by a gamma with primaries (PNG's gAMA and cHRM), or by EXIF. Profiles are converted by Little
CMS, which does not clip colours beyond 1; the others need a curve and a matrix.
"""

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import imagecodecs
import numpy as np
from jaxtyping import Float32, Float64
from lambent_core.colour import linear_from_srgb, rec709_matrix, srgb_from_linear
from numpy import ndarray
from PIL import Image, ImageCms

from lambent_capture.arrays import Channels32, Colours32, Levels, Rgb
from lambent_capture.pictures.picture_error import PictureError, reason_of

SAME_LEVELS = 2
"""Greatest difference of an 8-bit value up to which a profile counts as sRGB; writers round its curve."""
_PROBE_STEPS = 9
_D65 = (0.3127, 0.3290)
_REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06)
_ROWS_AT_ONCE = 256

Curve = Callable[[Float64[ndarray, "*shape"]], Float64[ndarray, "*shape"]]


@dataclass(frozen=True, slots=True)
class ColourSpace:
    """What the levels of a picture mean: integers of 8 or 16 bits, or floats of which 1 is full scale."""

    name: str
    curve: Curve | None = None
    """From encoded to linear values, both 0..1; None for linear levels, or with a profile."""
    matrix: tuple[tuple[float, ...], ...] | None = None
    """From its linear red, green, blue to those of Rec. 709; None for the same primaries."""
    profile: bytes = b""
    """An ICC profile in place of the two."""

    def linear(self, levels: Levels) -> Float32[ndarray, "height width colours"]:
        """Return linear Rec. 709 values of one (grey) or three channels; never below 0, unless stored so.

        Colours outside Rec. 709 have a negative channel, which no light has: it becomes 0. Floats without
        primaries of their own are returned as they are.
        """
        if self.profile:
            return np.maximum(_through_profile(self.profile, levels), 0.0)
        if levels.dtype.kind == "f" and self.curve is None:
            values = levels.astype(np.float32)
        else:
            values = _decoded(levels, self.curve)
        if self.matrix is None or values.shape[-1] != 3:
            return values
        return np.maximum(values @ np.array(self.matrix, dtype=np.float32).T, 0.0)

    def srgb(self, levels: Levels) -> Rgb:
        """Return 8-bit sRGB colours, clipped to what it can show."""
        if self == SRGB and levels.dtype == np.uint8:
            colours = levels
        else:
            channels = 3 if self.profile else levels.shape[-1]
            colours = np.empty((*levels.shape[:2], channels), dtype=np.uint8)
            for start in range(0, levels.shape[0], _ROWS_AT_ONCE):
                rows = slice(start, start + _ROWS_AT_ONCE)
                colours[rows] = np.round(255.0 * srgb_from_linear(self.linear(levels[rows])))
        return np.ascontiguousarray(np.broadcast_to(colours, (*colours.shape[:2], 3)))


def of_profile(profile: bytes, channels: int) -> tuple[ColourSpace, str]:
    """Return the space that an ICC profile describes and "", or sRGB and why, as the end of a sentence.

    A profile of colours also fits a grey picture: its channels are equal then. Raises `PictureError` for the
    profiles of PQ and HLG, whose levels are not shares of one white.
    """
    for code, name in _TRANSFERS_REFUSED.items():
        if _cicp_of_profile(profile)[1:2] == bytes([code]):
            raise _refused_transfer(name)
    space, fault = _known_profile(profile)
    if not fault and channels == 3 and space.name == "grey profile":
        space, fault = SRGB, "it describes GRAY colours, the picture is RGB"
    doubt = f"has a colour profile that cannot be used ({fault}), so its colours are taken for sRGB"
    return space, doubt if fault else ""


def of_code_points(primaries: int, transfer: int) -> ColourSpace:
    """Return the space that two code points name; 2 means "not stated" and leaves the rule of sRGB.

    Raises `PictureError` for PQ, HLG, and code points that no photograph has. Source: ITU-T H.273, tables 2
    and 3.
    """
    if transfer in _TRANSFERS_REFUSED:
        raise _refused_transfer(_TRANSFERS_REFUSED[transfer])
    if primaries not in _PRIMARIES or transfer not in _TRANSFERS:
        raise PictureError(
            "scene.colour_space",
            f"states colours by the code points {primaries} (primaries) and {transfer} (transfer), which are "
            "not supported; export it as sRGB",
        )
    corners, white = _PRIMARIES[primaries]
    return _made(f"H.273 {primaries}/{transfer}", _TRANSFERS[transfer], (*corners, *white))


def of_gamma(gamma: float, chromaticities: tuple[float, ...] | None) -> ColourSpace:
    """Return the space of PNG's gAMA and cHRM: levels are linear light to the power of `gamma`.

    `chromaticities` are x and y of white, red, green, blue, as cHRM orders them. Raises `PictureError` for
    values that mean nothing.
    """
    corners = (*_REC709, *_D65) if chromaticities is None else (*chromaticities[2:], *chromaticities[:2])
    if not 0.1 <= gamma <= 10.0:
        raise PictureError(
            "scene.colour_space", f"states a gamma of {gamma:g}, which cannot be; export it as sRGB"
        )
    curve = None if abs(gamma - 1.0) < 1e-3 else (lambda values: values ** (1.0 / gamma))
    return _made(f"gamma {gamma:g}", curve, corners)


def of_chromaticities(corners: tuple[float, ...]) -> ColourSpace:
    """Return the linear space with these x and y of red, green, blue and white, as EXR states them."""
    return _made("linear", None, corners)


def _made(name: str, curve: Curve | None, corners: tuple[float, ...]) -> ColourSpace:
    try:
        matrix = rec709_matrix(corners)
    except ValueError as error:
        raise PictureError(
            "scene.colour_space",
            f"states primaries that cannot be ({error}); export it as linear Rec. 709",
        ) from error
    rows = None if matrix is None else tuple(tuple(float(value) for value in row) for row in matrix)
    return ColourSpace(name, curve, rows)


def _decoded(levels: Levels, curve: Curve | None) -> Channels32:
    if levels.dtype.kind == "f":
        return np.asarray(curve(np.maximum(levels, 0.0)) if curve else levels, dtype=np.float32)
    return _table(curve, levels.dtype.itemsize)[levels]


@lru_cache(maxsize=16)
def _table(curve: Curve | None, num_bytes: int) -> Float32[ndarray, " levels"]:
    encoded = np.linspace(0.0, 1.0, 256**num_bytes)
    return (encoded if curve is None else curve(encoded)).astype(np.float32)


def _through_profile(profile: bytes, levels: Levels) -> Colours32:
    grey = _is_grey(profile)
    if not grey and levels.shape[-1] == 1:
        levels = np.broadcast_to(levels, (*levels.shape[:2], 3))
    source = np.ascontiguousarray(levels[..., 0] if grey else levels)
    converted = imagecodecs.cms_transform(
        source,
        profile,
        _linear_rec709_profile(),
        colorspace="gray" if grey else "rgb",
        outcolorspace="rgb",
        outdtype=np.float32,
        intent=int(ImageCms.Intent.RELATIVE_COLORIMETRIC),
    )
    return np.asarray(converted, dtype=np.float32)


@lru_cache(maxsize=1)
def _linear_rec709_profile() -> bytes:
    corners = [value for x, y in np.reshape(_REC709, (3, 2)).tolist() for value in (x, y, 1.0)]
    return bytes(imagecodecs.cms_profile("rgb", whitepoint=(*_D65, 1.0), primaries=corners, gamma=1.0))


@lru_cache(maxsize=16)
def _known_profile(profile: bytes) -> tuple[ColourSpace, str]:
    try:
        given = ImageCms.ImageCmsProfile(io.BytesIO(profile)).profile.xcolor_space.strip()
        if given not in ("RGB", "GRAY"):
            return SRGB, f"it describes {given or 'unknown'} colours, the picture is RGB or grey"
        space = ColourSpace("grey profile" if given == "GRAY" else "profile", profile=profile)
        levels = np.linspace(0, 255, _PROBE_STEPS).round().astype(np.uint8)
        probe = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(9, -1, 3)
        probe = probe if given == "RGB" else np.ascontiguousarray(levels[None, :, None])
        changed = space.srgb(probe).astype(np.int16) - probe
    except Exception as error:  # Little CMS has errors of two libraries, and the profile may hold anything
        return SRGB, reason_of(error)
    return (SRGB if np.abs(changed).max() <= SAME_LEVELS else space), ""


def _is_grey(profile: bytes) -> bool:
    return profile[16:20] == b"GRAY"


def _cicp_of_profile(profile: bytes) -> bytes:
    """Return the four code points in an ICC profile, or nothing. Source: ICC.1:2022, 9.2.17 and 10.3."""
    count = int.from_bytes(profile[128:132], "big")
    for at in range(132, 132 + 12 * min(count, 200), 12):
        if profile[at : at + 4] == b"cicp":
            start = int.from_bytes(profile[at + 4 : at + 8], "big")
            return profile[start + 8 : start + 12]
    return b""


def cmyk_as_rgb(image: Image.Image) -> Image.Image:
    """Return a picture for print in sRGB, by its profile or, without a usable one, by Pillow's formula."""
    profile = image.info.get("icc_profile")
    if profile:
        try:
            given = ImageCms.ImageCmsProfile(io.BytesIO(bytes(profile)))
            converted = ImageCms.profileToProfile(
                image,
                given,
                ImageCms.createProfile("sRGB"),
                renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
                outputMode="RGB",
            )
        except (ImageCms.PyCMSError, OSError, TypeError, ValueError):
            converted = None
        if converted is not None:
            return converted
    return image.convert("RGB")


def _from_rec709(encoded: Float64[ndarray, "*shape"]) -> Float64[ndarray, "*shape"]:
    """Return light in front of the camera. Source: ITU-R BT.709-6, item 1.2, inverted."""
    return np.where(encoded < 0.081, encoded / 4.5, ((encoded + 0.099) / 1.099) ** (1.0 / 0.45))


def _gamma_22(encoded: Float64[ndarray, "*shape"]) -> Float64[ndarray, "*shape"]:
    return encoded**2.2


def _gamma_28(encoded: Float64[ndarray, "*shape"]) -> Float64[ndarray, "*shape"]:
    return encoded**2.8


def _adobe_gamma(encoded: Float64[ndarray, "*shape"]) -> Float64[ndarray, "*shape"]:
    return encoded ** (563.0 / 256.0)


def _srgb_curve(encoded: Float64[ndarray, "*shape"]) -> Float64[ndarray, "*shape"]:
    return np.asarray(linear_from_srgb(encoded))


def _refused_transfer(name: str) -> PictureError:
    return PictureError(
        "scene.colour_space",
        f"is a high dynamic range picture in {name}, which does not say how much light it shows; "
        "export it as sRGB or Display P3, or as EXR",
    )


_DCI = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060)
_PRIMARIES: dict[int, tuple[tuple[float, ...], tuple[float, float]]] = {
    1: (_REC709, _D65),
    2: (_REC709, _D65),
    4: ((0.67, 0.33, 0.21, 0.71, 0.14, 0.08), (0.310, 0.316)),
    5: ((0.64, 0.33, 0.29, 0.60, 0.15, 0.06), _D65),
    6: ((0.630, 0.340, 0.310, 0.595, 0.155, 0.070), _D65),
    7: ((0.630, 0.340, 0.310, 0.595, 0.155, 0.070), _D65),
    9: ((0.708, 0.292, 0.170, 0.797, 0.131, 0.046), _D65),
    11: (_DCI, (0.314, 0.351)),
    12: (_DCI, _D65),
}
_TRANSFERS: dict[int, Curve | None] = {
    1: _from_rec709,
    2: _srgb_curve,
    4: _gamma_22,
    5: _gamma_28,
    6: _from_rec709,
    8: None,
    13: _srgb_curve,
    14: _from_rec709,
    15: _from_rec709,
}
_TRANSFERS_REFUSED = {16: "PQ (SMPTE ST 2084)", 18: "HLG (ARIB STD-B67)"}

SRGB = ColourSpace("sRGB", _srgb_curve)
LINEAR = ColourSpace("linear")
ADOBE_RGB = _made("Adobe RGB (1998)", _adobe_gamma, (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *_D65))

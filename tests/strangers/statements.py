"""Statements of colours in files of each format, and their meaning."""

from dataclasses import dataclass

from strangers import profiles
from strangers.colours import SPACES, Space


@dataclass(frozen=True, kw_only=True, slots=True)
class Statement:
    """A statement of colours; every member that is set is written to the file."""

    means: tuple[Space, ...]
    """Readings that are right; more than one where the standard is read in several ways. None: refused."""
    icc: bytes = b""
    chunks: tuple[bytes, ...] = ()
    """Of a PNG, before its pixels."""
    colour_space: int | None = None
    """Tag of EXIF."""
    interoperability: str = ""
    nclx: tuple[int, int] | None = None
    """Code points of primaries and transfer in HEIC and AVIF."""
    header: tuple[str, ...] = ()
    """Lines of a Radiance file."""
    rows: str = "-Y +X"
    """Order of pixels in a Radiance file."""
    chromaticities: Space | None = None
    """Of an EXR."""
    grey: bool = False


def _of(*names: str, **what: object) -> Statement:
    return Statement(means=tuple(SPACES[name] for name in names), **what)  # type: ignore[arg-type]


_PROFILES = ("srgb", "p3", "adobe", "rec2020", "prophoto", "linear")
_ICC = {f"icc {name}": _of(name, icc=profiles.rgb_profile(SPACES[name])) for name in _PROFILES}
_ICC |= {
    "icc pq": _of(icc=profiles.rgb_profile(SPACES["rec2020"], (9, 16))),
    "icc broken": _of("srgb", icc=profiles.rgb_profile(SPACES["p3"])[:150]),
    "icc grey in colours": _of("srgb", icc=profiles.grey_profile(1.0)),
}
_GREY = {
    "grey none": _of("srgb", grey=True),
    "grey icc gamma22": _of("gamma22", icc=profiles.grey_profile(2.2), grey=True),
    "grey icc linear": _of("linear", icc=profiles.grey_profile(1.0), grey=True),
}
_R03 = {"colour_space": 0xFFFF, "interoperability": "R03"}
_NONE = {"none": _of("srgb")}


def _png(*chunks: bytes, means: tuple[str, ...]) -> Statement:
    return _of(*means, chunks=chunks)


def _iccp(name: str) -> bytes:
    return profiles.iccp(profiles.rgb_profile(SPACES[name]))


_LINEAR_CHUNKS = (profiles.gama(1.0),)
_P3_CHRM = profiles.chrm(SPACES["p3"])
# Whether the curve of BT.2020 says what a camera did or what a screen is to do is argued.
_BT2020 = ("rec2020", "rec2020-srgb", "rec2020-24")
SPACES |= {
    "rec2020-srgb": Space("rec2020-srgb", SPACES["rec2020"].primaries),
    "rec2020-24": Space("rec2020-24", SPACES["rec2020"].primaries, curve=2.4),
    "p3-gamma22": Space("p3-gamma22", SPACES["p3"].primaries, curve=2.2),
}

PNG = {
    **_NONE,
    **{f"iccp {name}": _png(_iccp(name), means=(name,)) for name in _PROFILES},
    "iccp pq": _of(chunks=(profiles.iccp(profiles.rgb_profile(SPACES["rec2020"], (9, 16))),)),
    "iccp broken": _png(profiles.iccp(b"no profile"), means=("srgb",)),
    "iccp broken over srgb": _png(profiles.iccp(b"no profile"), profiles.srgb(), means=("srgb",)),
    "srgb": _png(profiles.srgb(), means=("srgb",)),
    "gama 1": _png(profiles.gama(1.0), means=("linear",)),
    "gama 1/1.8": _png(profiles.gama(1 / 1.8), means=("gamma18",)),
    "gama 1/2.2": _png(profiles.gama(0.45455), means=("gamma22", "srgb")),
    "gama chrm adobe": _png(profiles.gama(256 / 563), profiles.chrm(SPACES["adobe"]), means=("adobe",)),
    "gama chrm p3": _png(profiles.gama(0.45455), _P3_CHRM, means=("p3-gamma22", "p3")),
    "gama chrm linear 2020": _png(
        profiles.gama(1.0), profiles.chrm(SPACES["rec2020"]), means=("rec2020-linear",)
    ),
    "cicp p3": _png(profiles.cicp(12, 13), means=("p3",)),
    "cicp srgb": _png(profiles.cicp(1, 13), means=("srgb",)),
    "cicp linear": _png(profiles.cicp(1, 8), means=("linear",)),
    "cicp 2020": _png(profiles.cicp(9, 14), means=_BT2020),
    "cicp pq": _png(profiles.cicp(9, 16), means=()),
    "cicp hlg": _png(profiles.cicp(9, 18), means=()),
    "cicp over all": _png(
        profiles.cicp(12, 13), _iccp("adobe"), profiles.srgb(), *_LINEAR_CHUNKS, means=("p3",)
    ),
    "cicp srgb over iccp": _png(profiles.cicp(1, 13), _iccp("adobe"), means=("srgb",)),
    "iccp over srgb": _png(_iccp("p3"), profiles.srgb(), *_LINEAR_CHUNKS, means=("p3",)),
    "iccp srgb over gama": _png(_iccp("srgb"), *_LINEAR_CHUNKS, _P3_CHRM, means=("srgb",)),
    "srgb over gama": _png(profiles.srgb(), *_LINEAR_CHUNKS, _P3_CHRM, means=("srgb",)),
    "grey gama 1": _of("linear", chunks=_LINEAR_CHUNKS, grey=True),
    "grey none": _of("srgb", grey=True),
    "grey iccp linear": _of("linear", chunks=(profiles.iccp(profiles.grey_profile(1.0)),), grey=True),
}
JPEG = {
    **_NONE,
    **_ICC,
    **_GREY,
    "exif srgb": _of("srgb", colour_space=1),
    "exif r03": _of("adobe", **_R03),
    "exif 2": _of("adobe", colour_space=2),
    # Neither is stated; a reader that takes Adobe RGB says so in a finding.
    "exif uncalibrated": _of("srgb", "adobe", colour_space=0xFFFF),
    "icc p3 over r03": _of("p3", icc=profiles.rgb_profile(SPACES["p3"]), **_R03),
    "icc srgb over r03": _of("srgb", icc=profiles.rgb_profile(SPACES["srgb"]), **_R03),
}
HEIF = {
    **_NONE,
    **_ICC,
    "nclx p3": _of("p3", nclx=(12, 13)),
    "nclx linear": _of("linear", nclx=(1, 8)),
    "nclx 2020": _of(*_BT2020, nclx=(9, 14)),
    "nclx unspecified": _of("srgb", nclx=(2, 2)),
    "nclx pq": _of(nclx=(9, 16)),
    "nclx hlg": _of(nclx=(9, 18)),
    "icc adobe over nclx p3": _of("adobe", icc=profiles.rgb_profile(SPACES["adobe"]), nclx=(12, 13)),
}
EXR = {
    "none": _of("linear"),
    **{
        name: _of(name, chromaticities=SPACES[name])
        for name in ("linear", "p3-linear", "rec2020-linear", "ap0", "ap1")
    },
    "grey none": _of("linear", grey=True),
}


def _primaries(name: str) -> tuple[str]:
    space = SPACES[name]
    return ("PRIMARIES= " + " ".join(f"{value:.4f}" for value in (*space.primaries, *space.white)),)


HDR = {
    "none": _of("linear"),
    **{f"order {rows}": _of("linear", rows=rows) for rows in ("+Y +X", "-Y -X", "+Y -X", "+X -Y", "-X +Y")},
    **{name: _of(name, header=_primaries(name)) for name in ("linear", "p3-linear", "rec2020-linear", "ap1")},
}
STATEMENTS: dict[str, dict[str, Statement]] = {
    "png": PNG,
    "jpeg": JPEG,
    "webp": {**_NONE, **_ICC},
    "tiff": {**_NONE, **_ICC, **_GREY},
    "avif": HEIF,
    "heic": HEIF,
    "exr": EXR,
    "hdr": HDR,
}

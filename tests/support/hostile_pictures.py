"""Captures with pictures that attack their decoder, with codes of which one has to be found."""

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image
from support.archives import make_zip
from support.captures import write_blender
from support.photographs import heif, view, write_views

NOT, BROKEN, LARGE = {"scene.image_not_a_picture"}, {"scene.image_broken"}, {"scene.image_too_large"}
FINITE = {"scene.image_not_finite"}
DAMAGED = NOT | BROKEN
FORMAT = {"scene.image_format", "scene.too_few_images", "scene.image_not_a_picture"}

CAPTURES: dict[str, tuple[Callable[[Path], None], set[str]]] = {}
"""Without codes the capture can be used."""


def _among(name: str, suffix: str, codes: set[str], make: Callable[[], bytes]) -> None:
    """Register six sound photographs and one file."""

    def write(folder: Path) -> None:
        write_views(folder)
        (folder / f"hostile{suffix}").write_bytes(make())

    CAPTURES[name] = (write, codes)


def _of(format_: str, image: Image.Image | None = None, **options: object) -> bytes:
    heif()
    buffer = io.BytesIO()
    (image or view(8)).save(buffer, format=format_, **options)
    return buffer.getvalue()


# ---- PNG ----------------------------------------------------------------------


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG with a right checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, *chunks: bytes, depth: int = 8, colour: int = 2) -> bytes:
    """Return a PNG of these chunks."""
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + b"".join(chunks) + chunk(b"IEND", b"")


def data_of(count: int) -> bytes:
    """Return a chunk of pixels of zeros, very small."""
    return chunk(b"IDAT", zlib.compress(bytes(count), 9))


_among("PNG of 60 000 x 60 000", ".png", LARGE, lambda: png(60_000, 60_000, data_of(1)))
_among("PNG of 2^31 x 2^31", ".png", DAMAGED | LARGE, lambda: png(2**31 - 1, 2**31 - 1, data_of(1)))
_among("PNG of 0 x 0", ".png", DAMAGED, lambda: png(0, 0, data_of(1)))
_among(
    "PNG bomb of 60 million pixels",
    ".png",
    LARGE | BROKEN | {"scene.image_blank", "scene.panorama"},
    lambda: png(8000, 7500, data_of(7500 * 24001)),
)
_among("PNG without pixels", ".png", DAMAGED, lambda: png(100, 100))
_among("PNG with too few pixels", ".png", DAMAGED, lambda: png(300, 300, data_of(100)))
_among("PNG of an impossible depth", ".png", DAMAGED, lambda: png(100, 100, data_of(99), depth=7))
_among(
    "PNG with a text bomb",
    ".png",
    DAMAGED | LARGE | {"scene.image_blank"},
    lambda: png(200, 200, chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(80_000_000), 9)), data_of(200 * 601)),
)
_among(
    "PNG with a profile bomb",
    ".png",
    DAMAGED | LARGE | {"scene.image_blank", "scene.colour_profile"},
    lambda: png(200, 200, chunk(b"iCCP", b"a\0\0" + zlib.compress(bytes(80_000_000), 9)), data_of(200 * 601)),
)
_among("PNG with a wrong checksum", ".png", DAMAGED, lambda: _of("PNG").replace(b"IDAT", b"IDAU", 1))
_among(
    "PNG with a chunk of 2 GiB",
    ".png",
    DAMAGED,
    lambda: png(100, 100, struct.pack(">I", 2**31 - 1) + b"IDAT"),
)
_among(
    "animated PNG of many pictures",
    ".png",
    {"scene.animation"},
    lambda: _of("PNG", view(8), save_all=True, append_images=[view(n) for n in range(5)]),
)

# ---- JPEG ----------------------------------------------------------------------


def _jpeg_of_size(width: int, height: int) -> bytes:
    data = bytearray(_of("JPEG"))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


_among("JPEG that says 65 000 x 65 000", ".jpg", LARGE, lambda: _jpeg_of_size(65_000, 65_000))
_among(
    "JPEG that says 8000 x 8000",
    ".jpg",
    DAMAGED | LARGE | {"scene.image_blank"},
    lambda: _jpeg_of_size(8000, 8000),
)
_among("JPEG of nothing but its start", ".jpg", NOT, lambda: b"\xff\xd8\xff\xe0")
_among("JPEG cut off", ".jpg", DAMAGED, lambda: _of("JPEG")[:900])
_among(
    "JPEG with EXIF of an endless chain",
    ".jpg",
    {"scene.exif_wrong", "scene.saved_twice", *DAMAGED} | {""},
    lambda: _of("JPEG", exif=b"Exif\0\0II*\0\x08\0\0\0\x00\x00\x08\0\0\0"),
)
_among(
    "JPEG with EXIF that is noise",
    ".jpg",
    {""},
    lambda: _of("JPEG", exif=b"Exif\0\0" + bytes(range(256)) * 20),
)
_among("JPEG in CMYK", ".jpg", {""}, lambda: _of("JPEG", view(8).convert("CMYK")))
_among("JPEG with a script behind it", ".jpg", {""}, lambda: _of("JPEG") + b"<script>alert(1)</script>" * 50)
_among("JPEG with a zip behind it", ".jpg", {""}, lambda: _of("JPEG") + make_zip({"../a.png": b"x"}))
for _turn in range(1, 10):
    _among(f"JPEG with orientation {_turn}", ".jpg", {""}, lambda turn=_turn: _turned(turn))


def _turned(turn: int) -> bytes:
    image = view(8)
    tags = image.getexif()
    tags[0x0112] = turn
    return _of("JPEG", image, exif=tags.tobytes())


# ---- other formats ----------------------------------------------------------------------


def _webp_of_size(side: int) -> bytes:
    # A lossless stream: 14 bits of width - 1 and height - 1 after the signature.
    bits = (side - 1) | (side - 1) << 14
    stream = b"\x2f" + struct.pack("<I", bits) + bytes(20)
    body = b"WEBPVP8L" + struct.pack("<I", len(stream)) + stream + b"\0" * (len(stream) % 2)
    return b"RIFF" + struct.pack("<I", len(body)) + body


_among("WebP that says 16 384 x 16 384", ".webp", DAMAGED | LARGE, lambda: _webp_of_size(16_384))
_among("WebP cut off", ".webp", DAMAGED, lambda: _of("WEBP")[:200])
_among(
    "WebP whose length lies",
    ".webp",
    DAMAGED,
    lambda: _of("WEBP")[:4] + b"\xff\xff\xff\x7f" + _of("WEBP")[8:500],
)
_among(
    "animated WebP",
    ".webp",
    {"scene.animation"},
    lambda: _of("WEBP", save_all=True, append_images=[view(n) for n in range(5)]),
)
_among("HEIC cut off", ".heic", DAMAGED, lambda: _of("HEIF")[:300])
_among("HEIC whose boxes lie", ".heic", DAMAGED, lambda: _of("HEIF").replace(b"meta", b"mete", 1))
_among("AVIF named HEIC", ".heic", NOT, lambda: b"\0\0\0\x20ftypavif\0\0\0\0avifmif1miafMA1B" + bytes(300))
_among("TIFF named PNG that ends early", ".png", DAMAGED, lambda: _of("TIFF")[:-500])
_among(
    "SVG named PNG",
    ".png",
    NOT,
    lambda: b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>',
)
_among("PostScript named JPEG", ".jpg", NOT, lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n(%pipe%id) (w) file\n")
_among("a program named JPEG", ".jpg", NOT, lambda: b"\x7fELF" + bytes(400))
_among("a pickle named JPEG", ".jpg", NOT, lambda: b"\x80\x04cos\nsystem\n(S'id'\ntR.")
_among(
    "raw file of lies",
    ".dng",
    DAMAGED | LARGE | {"scene.raw_unsupported"},
    lambda: (
        b"II*\0\x08\0\0\0"
        + struct.pack("<H", 3)
        + b"".join(
            struct.pack("<HHII", tag, 4, 1, value)
            for tag, value in ((256, 2**31), (257, 2**31), (273, 2**31))
        )
        + bytes(8)
    ),
)

# ---- floating point ----------------------------------------------------------------------


def attribute(name: bytes, kind: bytes, data: bytes) -> bytes:
    """Return an attribute of an EXR header."""
    return name + b"\0" + kind + b"\0" + struct.pack("<i", len(data)) + data


def exr_header(
    width: int,
    height: int,
    *,
    names: str = "BGR",
    version: int = 2,
    compression: int = 0,
    more: bytes = b"",
    left: int = 0,
    top: int = 0,
) -> bytes:
    """Return the header of an EXR file of half floats."""
    channels = b"".join(name.encode() + b"\0" + struct.pack("<iiii", 1, 0, 1, 1) for name in names) + b"\0"
    box = struct.pack("<iiii", left, top, left + width - 1, top + height - 1)
    return (
        b"\x76\x2f\x31\x01"
        + struct.pack("<I", version)
        + b"".join(
            (
                attribute(b"channels", b"chlist", channels),
                attribute(b"compression", b"compression", bytes([compression])),
                attribute(b"dataWindow", b"box2i", box),
                attribute(b"displayWindow", b"box2i", box),
                attribute(b"lineOrder", b"lineOrder", b"\0"),
                attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1.0)),
                attribute(b"screenWindowCenter", b"v2f", bytes(8)),
                attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
                more,
                b"\0",
            )
        )
    )


def exr(pixels: np.ndarray) -> bytes:
    """Return an uncompressed EXR of half floats of [height, width, 3]."""
    height, width, _ = pixels.shape
    head = exr_header(width, height)
    rows = [pixels[row, :, ::-1].T.astype("<f2").tobytes() for row in range(height)]
    size = 8 + len(rows[0])
    start = len(head) + 8 * height
    table = struct.pack(f"<{height}Q", *(start + size * row for row in range(height)))
    return head + table + b"".join(struct.pack("<ii", row, len(data)) + data for row, data in enumerate(rows))


def _sound(value: float = 0.5) -> np.ndarray:
    pixels = np.random.default_rng(1).random((120, 160, 3)) * 0.8
    pixels[5, 5] = value
    return pixels


TILES = attribute(b"tiles", b"tiledesc", struct.pack("<IIB", 2**31 - 1, 2**31 - 1, 0))
_among("EXR of 200 000 x 200 000", ".exr", LARGE | BROKEN, lambda: exr_header(200_000, 200_000) + bytes(64))
_among("EXR from -2^31 to 2^31", ".exr", LARGE | BROKEN, lambda: exr_header(2**31 - 1, 2**31 - 1) + bytes(64))
_among("EXR of 4000 x 4000 without pixels", ".exr", BROKEN, lambda: exr_header(4000, 4000) + bytes(64))
_among("EXR with offsets beyond the end", ".exr", BROKEN, lambda: exr_header(100, 100) + b"\xff" * 800)
_among(
    "EXR whose rows lie about their size",
    ".exr",
    BROKEN,
    lambda: exr(_sound()).replace(struct.pack("<ii", 3, 960), struct.pack("<ii", 3, 2**31 - 1)),
)
_among("deep EXR", ".exr", BROKEN, lambda: exr_header(100, 100, version=2 | 0x800) + bytes(900))
_among(
    "EXR of tiles of 2^31",
    ".exr",
    BROKEN | LARGE,
    lambda: exr_header(100, 100, version=2 | 0x200, more=TILES) + bytes(64),
)
_among(
    "EXR of many parts",
    ".exr",
    BROKEN | LARGE,
    lambda: (
        exr_header(160, 120, version=2 | 0x1000)[:-1]
        + b"\0"
        + exr_header(9000, 9000)[8:] * 200
        + b"\0"
        + bytes(64)
    ),
)
_among(
    "EXR of 1000 channels",
    ".exr",
    BROKEN | LARGE,
    lambda: exr_header(4000, 4000, names="ABCDEFGHIJKLMNOPQRSTUVWXYZ" * 38) + bytes(64),
)
_among(
    "EXR of an unknown compression",
    ".exr",
    BROKEN,
    lambda: exr_header(100, 100, compression=200) + bytes(900),
)
_among(
    "EXR with an attribute of -1 bytes",
    ".exr",
    BROKEN | NOT,
    lambda: b"\x76\x2f\x31\x01\x02\0\0\0a\0int\0" + b"\xff" * 4 + bytes(64),
)
_among("EXR cut off", ".exr", BROKEN, lambda: exr(_sound())[:9000])
for _word, _value in {"NaN": np.nan, "infinity": np.inf, "minus infinity": -np.inf}.items():
    _among(f"EXR with {_word}", ".exr", FINITE, lambda value=_value: exr(_sound(value)))
_among("sound EXR", ".exr", {""}, lambda: exr(_sound()))
HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
_among("HDR of 99 999 x 99 999", ".hdr", LARGE, lambda: HDR + b"-Y 99999 +X 99999\n" + bytes(64))
_among("HDR with too few pixels", ".hdr", BROKEN, lambda: HDR + b"-Y 100 +X 100\n" + bytes(64))
_among(
    "HDR with runs beyond the row",
    ".hdr",
    BROKEN,
    lambda: HDR + b"-Y 100 +X 100\n" + b"\2\2\0\x64" + b"\xff\1" * 400,
)
_among("HDR of 0 x 0", ".hdr", BROKEN, lambda: HDR + b"-Y 0 +X 0\n")
_among(
    "HDR with a header of a megabyte",
    ".hdr",
    BROKEN | NOT,
    lambda: b"#?RADIANCE\n" + b"A=" + b"x" * 10**6 + b"\n\n-Y 1 +X 1\n" + bytes(4),
)
_among(
    "HDR with an exposure of 1e300",
    ".hdr",
    BROKEN | FINITE | {"scene.image_blank", "scene.image_tiny"},
    lambda: HDR[:-1] + b"EXPOSURE=1e-300\n\n-Y 100 +X 100\n" + b"\x80\x80\x80\x80" * 10_000,
)


# ---- captures with cameras ----------------------------------------------------------------------


@(lambda write: CAPTURES.__setitem__("16-bit PNG among views", (write, {""})))
def _(folder: Path) -> None:
    write_blender(folder)
    Image.fromarray(np.full((12, 12), 30_000, dtype=np.uint16)).save(folder / "train" / "r_1.png")


@(lambda write: CAPTURES.__setitem__("a palette bomb among views", (write, {"scene.pictures_left_out"})))
def _(folder: Path) -> None:
    write_blender(folder)
    (folder / "train" / "r_1.png").write_bytes(
        png(40_000, 40_000, chunk(b"PLTE", bytes(768)), data_of(1), colour=3)
    )

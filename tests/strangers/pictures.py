"""Photographs as strangers save them, each with the light it shows.

Pictures are `WIDTH` x `HEIGHT` stored pixels: patches of 8 x 8 pixels of one colour, which lossy
formats keep, with a ramp over each where a format loses nothing.
"""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray
from PIL import Image
from strangers import floats, profiles
from strangers.colours import SPACES, Space, levels_of, light_of, to_rec709, uncertainty
from strangers.statements import STATEMENTS, Statement

WIDTH, HEIGHT, PATCH = 32, 24, 8
SUFFIXES = {
    "png": ".png",
    "jpeg": ".jpg",
    "webp": ".webp",
    "tiff": ".tif",
    "avif": ".avif",
    "heic": ".heic",
    "exr": ".exr",
    "hdr": ".hdr",
}
LEVELS_LOST = {"jpeg": 5.0, "avif": 4.0, "heic": 3.0}
"""Levels of 255 by which a lossy format may miss; JPEG's colours move by 4 where one patch meets another."""
HALF_STEP = 0.6
"""Half a step of the file's own levels, and what rounding adds."""
MIRRORED = (2, 4, 5, 7)


@dataclass(frozen=True, kw_only=True, slots=True)
class Spec:
    """How a photograph is saved."""

    format: str
    depth: str = "8"
    """Bits of a channel, or half and float."""
    colour: str = "none"
    """A name in `STATEMENTS` of the format."""
    alpha: str = "none"
    """none, straight, premultiplied, palette or key."""
    orientation: int = 1
    """EXIF; the picture is stored as it is, and shown turned."""
    scale: int = 1
    """How often each pixel is repeated in rows and columns."""

    @property
    def statement(self) -> Statement:
        """Return what the file says of its colours."""
        return STATEMENTS[self.format][self.colour]

    def __str__(self) -> str:
        """Return the members that are not usual."""
        return f"{self.format} {self.depth} [{self.colour}] alpha={self.alpha} orientation={self.orientation}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """A right reading of a photograph: light, how far it may be missed, and coverage."""

    light: ndarray
    margin: ndarray
    alpha: ndarray
    alpha_margin: float = 0.006
    shown: int = 1
    """EXIF orientation by which it is turned; 1 for the rows of the file."""

    def turned(self, orientation: int) -> "Reading":
        """Return the reading as a person sees it."""
        return Reading(
            light=turned(self.light, orientation),
            margin=turned(self.margin, orientation),
            alpha=turned(self.alpha, orientation),
            alpha_margin=self.alpha_margin,
            shown=orientation,
        )


def turned(pixels: ndarray, orientation: int) -> ndarray:
    """Return stored pixels as they are to be shown. Source: EXIF 2.32, 4.6.4, Orientation."""
    rows = {
        1: pixels,
        2: pixels[:, ::-1],
        3: pixels[::-1, ::-1],
        4: pixels[::-1],
        5: pixels.swapaxes(0, 1),
        6: pixels[::-1].swapaxes(0, 1),
        7: pixels[::-1, ::-1].swapaxes(0, 1),
        8: pixels[:, ::-1].swapaxes(0, 1),
    }
    return np.ascontiguousarray(rows[orientation])


def enlarged(pixels: ndarray, scale: int) -> ndarray:
    """Return a picture with each pixel repeated."""
    return pixels.repeat(scale, 0).repeat(scale, 1)


def object_alpha(*, soft: bool) -> ndarray:
    """Return the coverage of an object that no turn maps on itself; `soft` has an edge of half."""
    alpha = np.zeros((HEIGHT, WIDTH))
    alpha[4:20, 8:16] = 1.0
    alpha[12:20, 16:27] = 1.0
    alpha[5:8, 16:20] = 1.0
    if soft:
        alpha[4:20, 7] = 128 / 255
    return alpha


def write_photograph(path: Path, spec: Spec, seed: int, *, outlined: ndarray | None = None) -> list[Reading]:
    """Write a photograph and return its right readings; none where it is to be refused.

    What `outlined` does not cover is dark, so that the outline of a mask can be seen.
    """
    choice = np.random.default_rng(seed)
    statement = spec.statement
    space = statement.means[0] if statement.means else SPACES["rec2020-srgb"]
    alpha = object_alpha(soft=spec.alpha not in ("none", "key"))
    levels = _levels(choice, space, spec, statement)
    if outlined is not None:
        levels = np.where(outlined[..., None] > 0, np.maximum(levels, 0.35), 0.12)
    if spec.format == "exr":  # an outline has the colours of what it is the outline of
        levels[:, 7] = levels[:, 8]
    levels, alpha = enlarged(levels, spec.scale), enlarged(alpha, spec.scale)
    if spec.format == "exr":
        return _exr(path, levels, alpha, spec, statement)
    if spec.format == "hdr":
        return _hdr(path, levels, space, statement, coded=bool(seed % 2))
    full = 65535 if spec.depth == "16" else 255
    stored = np.round(levels * full).astype(np.uint16 if full > 255 else np.uint8)
    if spec.alpha == "palette":
        tile = PATCH * spec.scale
        stored = enlarged(stored[::tile, ::tile], tile)
    if spec.alpha == "key":
        stored = np.where(alpha[..., None] > 0, np.maximum(stored, 1), 0).astype(stored.dtype)
    shown = stored / full
    if spec.alpha == "premultiplied":
        stored = np.round(stored * alpha[..., None]).astype(stored.dtype)
        shown = stored / full / np.maximum(alpha, 1e-9)[..., None]
    shown = np.broadcast_to(shown, (*alpha.shape, 3))
    save_levels(path, stored, alpha, spec, statement)
    lossless = spec.format not in LEVELS_LOST
    step = HALF_STEP / full if lossless else LEVELS_LOST[spec.format] / 255
    if outlined is not None and not lossless:  # which is not an edge of patches
        step *= 3.0
    weight = np.maximum(alpha, 0.4)[..., None] if spec.alpha == "premultiplied" else 1.0
    found = []
    for each in statement.means:
        light = light_of(shown, each)
        margin = uncertainty(shown, each, step) / weight + 6e-4 + 2e-3 * np.abs(light)
        if full == 255:  # a reader may go through levels of 8 bits once more
            again = np.clip(levels_of(np.maximum(light, 0.0), SPACES["srgb"]), 0.0, 1.0)
            margin = margin + uncertainty(again, SPACES["srgb"], HALF_STEP / 255)
        has_alpha = spec.alpha != "none"
        found.append(
            Reading(
                light=np.broadcast_to(light, (*alpha.shape, 3)),
                margin=np.broadcast_to(margin, (*alpha.shape, 3)),
                alpha=alpha if has_alpha else np.ones_like(alpha),
                alpha_margin=0.006 if lossless else 0.02,
            )
        )
    return _as_shown(found, spec)


def _as_shown(found: list[Reading], spec: Spec) -> list[Reading]:
    """Return readings turned where the format turns, or may.

    The turn of HEIC is part of the picture (ISO/IEC 23008-12), EXIF's and TIFF's are not, and rows are those
    of the file; of AVIF readers differ. A mirrored photograph may be mirrored back, upright or as it lies.
    """
    if spec.orientation == 1:
        return found
    upright = [each.turned(spec.orientation) for each in found]
    if spec.format == "heic":
        return upright
    if spec.orientation in MIRRORED:
        return [*found, *upright, *(each.turned(2) for each in found)]
    return [*found, *upright] if spec.format == "avif" else found


def _levels(choice: np.random.Generator, space: Space, spec: Spec, statement: Statement) -> ndarray:
    """Return levels, 0..1, of patches within Rec. 709, but for one that is strong in `space`."""
    count = HEIGHT // PATCH, WIDTH // PATCH
    light = choice.uniform(0.02, 0.95, (*count, 1 if statement.grey else 3))
    if statement.grey:
        levels = np.clip(levels_of(np.repeat(light, 3, -1), Space("grey", curve=space.curve)), 0, 1)[..., :1]
    else:
        levels = np.clip(levels_of(light, space), 0.0, 1.0)
        levels[1, 1] = choice.permutation([0.92, 0.15, 0.2])
    levels = np.repeat(np.repeat(levels, PATCH, 0), PATCH, 1)
    if spec.format not in LEVELS_LOST and spec.alpha != "palette":
        ramp = np.linspace(-0.04, 0.04, PATCH)
        levels = levels + np.tile(ramp[:, None] + ramp[None], count)[..., None] / 2
    return levels.clip(0.02, 0.98)


def save_levels(path: Path, stored: ndarray, alpha: ndarray, spec: Spec, statement: Statement) -> None:
    """Write integer levels with coverage as the specification says."""
    full = np.iinfo(stored.dtype).max
    cover = np.round(alpha * full).astype(stored.dtype)[..., None]
    pixels = stored if spec.alpha in ("none", "palette", "key") else np.concatenate([stored, cover], axis=-1)
    block = b""
    if spec.orientation != 1 or statement.colour_space is not None:
        block = profiles.exif(
            orientation=spec.orientation,
            colour_space=statement.colour_space,
            interoperability=statement.interoperability,
        )
    if spec.format == "png":
        path.write_bytes(_png(pixels, alpha, spec, statement, block))
    elif spec.format == "tiff":
        _tiff(path, pixels, spec, statement)
    elif spec.depth == "10":
        _ten_bit(path, pixels, spec, statement, block)
    else:
        _pillow(path, pixels, spec, statement, block)


def _png(pixels: ndarray, alpha: ndarray, spec: Spec, statement: Statement, block: bytes) -> bytes:
    chunks = list(statement.chunks)
    if block:
        chunks.append(profiles.chunk(b"eXIf", block[6:]))
    if spec.alpha == "key":
        chunks.append(profiles.chunk(b"tRNS", b"\0\0" * pixels.shape[-1]))
    if spec.alpha != "palette":
        return profiles.png(pixels, *chunks)
    shares = [0.0, 128 / 255, 1.0]
    tile = PATCH * spec.scale
    tiles = enlarged(np.arange(12).reshape(HEIGHT // PATCH, WIDTH // PATCH), tile)
    which = np.digitize(alpha, [0.25, 0.75])
    colours = pixels[::tile, ::tile].reshape(12, -1)
    colours = np.broadcast_to(colours, (12, 3)).astype(np.uint8)
    chunks.append(profiles.chunk(b"tRNS", bytes(round(255 * share) for share in shares for _ in range(12))))
    index = (12 * which + tiles).astype(np.uint8)
    return profiles.png(index, *chunks, palette=np.tile(colours, (3, 1)).tobytes())


def _tiff(path: Path, pixels: ndarray, spec: Spec, statement: Statement) -> None:
    import tifffile

    extra = {"straight": ["unassalpha"], "premultiplied": ["assocalpha"]}.get(spec.alpha)
    # Deterministic, and each of the three is met.
    packed = (None, "lzw", "zlib")[(spec.orientation + len(spec.colour)) % 3]
    tifffile.imwrite(
        path,
        pixels[..., 0] if pixels.shape[-1] == 1 else pixels,
        photometric="minisblack" if statement.grey else "rgb",
        extrasamples=extra,
        compression=packed,
        iccprofile=statement.icc or None,
        metadata=None,
        extratags=[(274, 3, 1, spec.orientation, True)],
    )


def _pillow(path: Path, pixels: ndarray, spec: Spec, statement: Statement, block: bytes) -> None:
    image = Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels)
    options: dict = {"icc_profile": statement.icc} if statement.icc else {}
    if block:
        options["exif"] = block
    if spec.format == "jpeg":
        options |= {"quality": 98} | ({} if statement.grey else {"subsampling": 0})
    elif spec.format == "webp":
        options |= {"lossless": True, "exact": True}
    elif spec.format == "avif":
        options |= {"quality": 100, "subsampling": "4:4:4"}
    else:
        from pillow_heif import register_heif_opener

        register_heif_opener()
        options |= {"quality": -1, "chroma": 444}
    buffer = io.BytesIO()
    image.save(buffer, {"heic": "HEIF"}.get(spec.format, spec.format.upper()), **options)
    path.write_bytes(with_code_points(buffer.getvalue(), statement))


def with_code_points(data: bytes, statement: Statement) -> bytes:
    """Return a HEIC or AVIF file with other code points in its nclx box, where some are stated."""
    if statement.nclx is None:
        return data
    at = data.find(b"colrnclx") + 8
    if at < 8:  # beside a profile one of the two writers leaves them out
        return data
    return data[:at] + b"".join(code.to_bytes(2, "big") for code in statement.nclx) + data[at + 4 :]


def _ten_bit(path: Path, pixels: ndarray, spec: Spec, statement: Statement, block: bytes) -> None:
    """Write a HEIC, or an AVIF without turn and profile, with 10 bits of each channel."""
    import pillow_heif

    if spec.format == "avif":
        import imagecodecs

        wide = np.round(pixels.astype(np.float64) * 1023 / 255).astype(np.uint16)
        data = imagecodecs.avif_encode(wide, level=100, bitspersample=10, pixelformat="444")
        path.write_bytes(with_code_points(bytes(data), statement))
        return
    wide = np.ascontiguousarray(pixels.astype(np.uint16) * 257)
    image = pillow_heif.from_bytes(
        mode="RGBA;16" if pixels.shape[-1] == 4 else "RGB;16",
        size=(pixels.shape[1], pixels.shape[0]),
        data=wide.tobytes(),
    )
    if statement.icc:
        image.info["icc_profile"] = statement.icc
        image.info["icc_profile_type"] = "prof"
    buffer = io.BytesIO()
    image.save(buffer, quality=-1, chroma=444, exif=block or None)
    path.write_bytes(with_code_points(buffer.getvalue(), statement))


def _exr(path: Path, light: ndarray, alpha: ndarray, spec: Spec, statement: Statement) -> list[Reading]:
    kind = np.float16 if spec.depth == "half" else np.float32
    light = 4.0 * light**2  # brighter than 1 in places, as light is
    premultiplied = spec.alpha == "premultiplied"
    cover = alpha if premultiplied else np.ones_like(alpha)
    planes = {
        name: (light[..., index] * cover).astype(kind)
        for index, name in enumerate("Y" if statement.grey else "RGB")
    }
    if premultiplied:
        planes["A"] = alpha.astype(kind)
    floats.write_exr(path, planes, space=statement.chromaticities)
    space = statement.means[0]
    shown = light_of(np.broadcast_to(light, (*alpha.shape, 3)), space)
    lost = (2.0**-9 if kind is np.float16 else 2.0**-20) * np.abs(light).max(axis=-1, keepdims=True) * 3.0
    return [
        Reading(light=shown, margin=lost + 1e-3 * np.abs(shown) + np.zeros(3), alpha=cover, alpha_margin=1e-3)
    ]


def _hdr(path: Path, light: ndarray, space: Space, statement: Statement, *, coded: bool) -> list[Reading]:
    pixels = floats.rgbe(2.0 * light**2)
    floats.write_hdr(path, pixels, header=statement.header, rows=statement.rows, coded=coded)
    stored = floats.rgbe_light(pixels)
    shown = light_of(stored, space)
    step = np.ldexp(1.0, pixels[..., 3:].astype(int) - 136)
    # Radiance adds half a step when it decodes, others do not.
    margin = 0.55 * step * np.abs(to_rec709(space)).sum(axis=1) + 1e-3 * np.abs(shown)
    return [Reading(light=shown, margin=margin, alpha=np.ones(light.shape[:2]))]

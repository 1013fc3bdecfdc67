"""Rows of the corpus about what pixels mean: colours, alpha, masks and EXIF's orientation."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from strangers import floats, profiles
from strangers.ball import (
    BALL,
    COVER,
    FOCAL,
    GREY,
    SIDE,
    disc,
    levels,
    masked,
    names_of,
    save_rgba,
    write_masks,
    write_photographs,
    write_transforms,
)
from strangers.colours import SPACES, levels_of
from strangers.masks import MASKS
from strangers.pictures import Spec, save_levels, turned
from strangers.rows import Make, jpeg, posed, row
from strangers.statements import STATEMENTS

# Masks.
for _kind in sorted(set(MASKS) - {"255", "soft", "16 bit soft", "jpeg", "orientation"}):
    _excuse = ("invert", "white is the object") if "inverted" in _kind or "white" in _kind else ()
    row(
        f"a{'09' if 'palette' in _kind else '08'} mask {_kind}",
        masked(MASKS[_kind][1], MASKS[_kind][0]),
        alpha=COVER,
        or_said=_excuse,
    )

# Pictures: colours.


def _stated(kind: str, colour: str, *, full: int = 255) -> Callable:
    """Return a writer of a format with a statement of colours from `STATEMENTS`."""
    statement = STATEMENTS[kind][colour]
    space = statement.means[0] if statement.means else SPACES["rec2020-srgb"]
    spec = Spec(format=kind, colour=colour, depth="16" if full > 255 else "8")

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        save_levels(path, levels(colours, space, full), alpha, spec, statement)

    return save


for _id, _kind, _suffix, _colour in (
    ("a24", "jpeg", ".jpg", "exif r03"),
    ("a24b", "jpeg", ".jpg", "none"),
    ("a24c", "jpeg", ".jpg", "exif uncalibrated"),
    ("a24d", "jpeg", ".jpg", "icc p3 over r03"),
    ("a24e", "jpeg", ".jpg", "icc adobe"),
    ("a24f", "webp", ".webp", "icc prophoto"),
    ("a24g", "tiff", ".tif", "icc adobe"),
    ("a26", "png", ".png", "gama 1"),
    ("a26b", "png", ".png", "gama chrm adobe"),
    ("a26c", "png", ".png", "cicp p3"),
    ("a26d", "png", ".png", "cicp over all"),
    ("a26e", "png", ".png", "iccp over srgb"),
    ("a26f", "png", ".png", "srgb over gama"),
    ("a26g", "png", ".png", "gama chrm linear 2020"),
    ("a29", "heic", ".heic", "nclx p3"),
    ("a29b", "avif", ".avif", "nclx p3"),
    ("a29c", "heic", ".heic", "icc adobe over nclx p3"),
):
    row(
        f"{_id} {_kind} {_colour}",
        posed(_stated(_kind, _colour), _suffix),
        light=BALL,
        or_said=("AVIF",) if _kind == "avif" else ("Adobe RGB",) if "uncalibrated" in _colour else (),
    )
row("a26h png 16 bit p3", posed(_stated("png", "iccp p3", full=65535)), light=BALL)
for _id, _kind, _suffix, _colour, _word in (
    ("a29e", "heic", ".heic", "nclx pq", "PQ"),
    ("a29f", "heic", ".heic", "nclx hlg", "HLG"),
    ("a29g", "avif", ".avif", "nclx pq", "PQ"),
    ("a26i", "png", ".png", "cicp pq", "PQ"),
    ("a26j", "png", ".png", "cicp hlg", "HLG"),
):
    row(f"{_id} {_kind} {_colour}", posed(_stated(_kind, _colour), _suffix), refused=(_word, "000"))


def _radiance(space: str, *header: str, rows: str = "-Y +X", scale: float = 1.0) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        values = levels_of(colours, SPACES[space]) * scale
        lines = (*STATEMENTS["hdr"][space].header, *header)
        floats.write_hdr(path, floats.rgbe(values), header=lines, rows=rows)

    return save


row("a30 hdr", posed(_radiance("linear"), ".hdr"), light=BALL)
row("a30b hdr 2020", posed(_radiance("rec2020-linear"), ".hdr"), light=BALL)
row("a30c hdr exposure", posed(_radiance("linear", "EXPOSURE=2.0", scale=2.0), ".hdr"), light=BALL)

# Pictures: alpha.


def _palette(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    ball, grey = (levels(np.array([value])).tobytes() for value in (BALL, (GREY,) * 3))
    index = (alpha > 0).astype(np.uint8)
    path.write_bytes(profiles.png(index, profiles.chunk(b"tRNS", b"\0\xff"), palette=grey + ball))


def _opaque_palette(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
    ball, grey = (levels(np.array([value])).tobytes() for value in (BALL, (GREY,) * 3))
    path.write_bytes(profiles.png((alpha > 0).astype(np.uint8), palette=grey + ball))


def _key(full: int, *, grey: bool = False) -> Callable:
    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        stored = levels(colours[..., :1] if grey else colours, SPACES["srgb"] if not grey else None, full)
        stored = np.where(alpha[..., None] > 0, stored, full).astype(stored.dtype)
        key = full.to_bytes(2, "big") * stored.shape[-1]
        path.write_bytes(profiles.png(stored, profiles.chunk(b"tRNS", key)))

    return save


_KEPT = {"light": BALL, "alpha": COVER, "lacks": ("scene.no_mask",)}
row("a28 palette with tRNS", posed(_palette), **_KEPT)
row("a28b colour key", posed(_key(255)), **_KEPT)
row("a28c colour key 16 bit", posed(_key(65535)), **_KEPT)
row("a28f palette without tRNS", posed(_opaque_palette), light=BALL, needs=("scene.no_mask",))
row("a28g rgba", posed(save_rgba), **_KEPT)

# Orientation.


_LEFT = np.arange(SIDE)[None] < SIDE / 2
_HEIGHT = SIDE - 16


def _turned(orientation: int) -> Make:
    """Return a writer of photographs with an EXIF orientation whose masks were painted upright.

    They show the left half of the ball, and lack the lower rows.
    """
    block = profiles.exif(orientation=orientation)

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del colours
        jpeg(exif=block)(
            path, np.where(_LEFT[..., None] & (disc() > 0)[..., None], BALL, 0.02)[:_HEIGHT], alpha
        )

    def mask(path: Path, alpha: np.ndarray) -> None:
        MASKS["255"][1](path, turned(np.where(_LEFT, alpha, 0.0)[:_HEIGHT], orientation))

    def make(folder: Path) -> None:
        frame = {"mask_path": lambda index: f"masks/{index:03d}.png"}
        write_transforms(folder, names_of(".jpg"), save, frame=frame)
        write_masks(folder, names_of(folder="masks/"), mask)

    return make


for _orientation in (3, 6, 8):
    row(
        f"a31 orientation {_orientation} with upright masks",
        _turned(_orientation),
        light=BALL,
        alpha=0.1950,
        focal=(FOCAL, FOCAL),
        centre=(SIDE / 2, SIDE / 2 - 8),
    )


def _said_last(folder: Path) -> None:
    """Write PNG whose orientation comes after the pixels, as ImageMagick has it, and upright masks."""

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del colours, alpha
        ball = _LEFT[..., None] & (disc() > 0)[..., None]
        data = profiles.png(levels(np.where(ball, BALL, 0.02)[:_HEIGHT]))
        block = profiles.chunk(b"eXIf", profiles.exif(orientation=3)[6:])
        path.write_bytes(data[:-12] + block + data[-12:])

    def mask(path: Path, alpha: np.ndarray) -> None:
        MASKS["255"][1](path, turned(np.where(_LEFT, alpha, 0.0)[:_HEIGHT], 3))

    write_transforms(folder, names_of(), save, frame={"mask_path": lambda index: f"masks/{index:03d}.png"})
    write_masks(folder, names_of(folder="masks/"), mask)


row(
    "a31c orientation after the pixels of a PNG",
    _said_last,
    light=BALL,
    alpha=0.1950,
    centre=(SIDE / 2, SIDE / 2 - 8),
    or_said=("mask_orientation", "mask_size"),
)


def _mirrored(folder: Path) -> None:
    write_photographs(folder, names_of(".jpg", ""), jpeg(exif=profiles.exif(orientation=2)))


row("a31b mirrored", _mirrored, has_cameras=False, says=("mirror",))

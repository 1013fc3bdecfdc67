"""Tells files apart by their first bytes."""

_HEIF_BRANDS = frozenset({b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1", b"heif"})
_AVIF_BRANDS = frozenset({b"avif", b"avis"})
_ANY_CODEC = frozenset({b"mif1", b"msf1"})
_TIFF_STARTS = frozenset({b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"})
_OTHERS = {
    b"GIF8": "it is a GIF",
    b"BM": "it is a BMP",
    b"8BPS": "it is a Photoshop file",
    b"%PDF": "it is a PDF",
    b"PK\x03\x04": "it is a zip archive",
    b"<!DOC": "it is a web page",
    b"<html": "it is a web page",
    b"<?xml": "it is XML",
    b"<svg": "it is an SVG drawing",
    b"\x00\x05\x16\x07": "it is the shadow file that macOS leaves on other systems",
    b"version https": "it is a pointer of Git LFS",
}


def format_of_bytes(start: bytes) -> str | None:
    """Return JPEG, PNG, WEBP, TIFF, HEIF or AVIF by a file's first 32 bytes, or None for anything else."""
    if start.startswith(b"\xff\xd8\xff"):
        return "JPEG"
    if start.startswith(b"\x89PNG\r\n\x1a\n"):
        return "PNG"
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return "WEBP"
    if start[:4] in _TIFF_STARTS:
        return "TIFF"
    if start[4:8] == b"ftyp":
        # The major brand may be the general one of pictures; the codec is among the compatible ones then.
        if start[8:12] in _AVIF_BRANDS or (start[8:12] in _ANY_CODEC and b"avif" in start[16:]):
            return "AVIF"
        if start[8:12] in _HEIF_BRANDS:
            return "HEIF"
    return None


def description_of_bytes(start: bytes) -> str:
    """Return what a file that is not a picture seems to be, as half a sentence."""
    if not start:
        return "it is empty"
    known = next((what for magic, what in _OTHERS.items() if start.startswith(magic)), None)
    if known is not None:
        return known
    if start[4:8] == b"ftyp":
        return "it is a video"
    if start == b"\0" * len(start):
        return "it holds zeros only"
    if all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in start):
        return "it is text"
    return "it begins like no picture"

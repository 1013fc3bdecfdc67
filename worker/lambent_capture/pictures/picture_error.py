"""The exception raised by everything that opens pictures."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType


class PictureError(Exception):
    """A picture cannot be used; `code` is stable, the text says why and what to do."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


def reason_of(error: Exception) -> str:
    """Return a library's own words, one line without folders, at most 120 characters."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return text.replace("\\", "/").rsplit("/", maxsplit=1)[-1][:120]


def undecodable(error: Exception) -> PictureError:
    """Return what to say of a picture that a decoder has failed on; decoders raise many kinds of errors."""
    return PictureError(
        "scene.image_broken", f"cannot be decoded ({reason_of(error)}); export or copy it again"
    )


def first_bytes(path: Path, count: int) -> bytes:
    """Return the beginning of a picture's file; raises `PictureError` where there is none."""
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    with path.open("rb") as file:
        return file.read(count)


TOO_LARGE = "scene.image_too_large"
STOPPED = "scene.decoder_stopped"
SKIPPED: Mapping[str, str] = MappingProxyType(
    {
        TOO_LARGE: "needs more memory or time than a picture may; export it smaller",
        STOPPED: "made its reader try what no picture needs (the network, another program or other files), "
        "and was stopped; remove it",
    }
)
"""What is said of a picture that has brought a reader down, after its name, by the code of the finding."""

NOTHING_SKIPPED: Mapping[str, str] = MappingProxyType({})
"""Codes of `SKIPPED` by path of the picture: none."""

"""The exception raised by everything that opens pictures."""


class PictureError(Exception):
    """A picture cannot be used; `code` is stable, the text says why and what to do."""

    def __init__(self, code: str, reason: str) -> None:
        super().__init__(reason)
        self.code = code


def reason_of(error: Exception) -> str:
    """Return a library's own words, one line without folders, at most 120 characters."""
    text = str(error).splitlines()[0] if str(error) else type(error).__name__
    return text.replace("\\", "/").rsplit("/", maxsplit=1)[-1][:120]

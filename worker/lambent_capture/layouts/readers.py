"""The module that reads a layout, and what it has."""

from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from lambent_core.layouts import LAYOUTS

from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import Capture


class Reader(Protocol):
    """A module of this package, named as its layout."""

    @staticmethod
    def is_layout(folder: Path, /) -> bool:
        """Return whether a folder has this layout."""

    @staticmethod
    def read_capture(folder: Path, problems: Problems, /, *cameras: Any) -> Capture:
        """Return all that is readable of the capture in `folder`; all problems are added to `problems`.

        `cameras`: for a nested layout the folder of its cameras, relative to `folder`; for photographs that
        of the cameras that were found, or None.
        """

    @staticmethod
    def own_files(folder: Path, /) -> set[Path]:
        """Return the files of a capture that only this layout has; needed where the layout names some."""


def reader_of(layout: str) -> Reader:
    """Return the reader of a layout of `LAYOUTS`."""
    return cast(Reader, import_module(f"lambent_capture.layouts.{LAYOUTS[layout].name}"))

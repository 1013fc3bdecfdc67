"""The rows of the corpus: a capture each, and its right value in numbers.

The first part of a name is that of the report it stands for; letters after it are near kinds. A row either is
read right, or, where `or_said` is given, some finding says in these words why not; a row with `refused` must
be refused in these words.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from strangers.ball import COUNT, FOCAL, SIDE, levels, names_of, save_png, write_transforms

Make = Callable[[Path], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """A capture and what is right about it."""

    make: Make
    light: tuple[float, float, float] | None = None
    """Mean linear Rec. 709 over the object of the first frame."""
    edge: tuple[float, float, float] | None = None
    """The same where it is covered by half."""
    alpha: float | None = None
    """Mean coverage of the first frame."""
    focal: tuple[float, float] = (FOCAL, FOCAL)
    centre: tuple[float, float] = (SIDE / 2, SIDE / 2)
    count: int = COUNT
    has_cameras: bool = True
    needs: tuple[str, ...] = ()
    """Codes of the expected findings."""
    lacks: tuple[str, ...] = ()
    """Codes of findings that are not."""
    or_said: tuple[str, ...] = ()
    """Words of a finding that excuse another reading; any of them."""
    says: tuple[str, ...] = ()
    """Words that findings hold, each."""
    refused: tuple[str, ...] = ()
    """Words of which each is in the error."""


ROWS: dict[str, Row] = {}


def row(name: str, make: Make, **right: object) -> None:
    """Add a row; its name is that of no other."""
    assert name not in ROWS, name
    ROWS[name] = Row(make=make, **right)  # type: ignore[arg-type]


def posed(save: Callable = save_png, suffix: str = ".png", **options: object) -> Make:
    """Return a writer of photographs with a transforms file."""
    return lambda folder: write_transforms(folder, names_of(suffix), save, **options)  # type: ignore[arg-type]


def jpeg(**options: object) -> Callable:
    """Return a writer of JPEG in sRGB."""

    def save(path: Path, colours: np.ndarray, alpha: np.ndarray) -> None:
        del alpha
        Image.fromarray(levels(colours)).save(path, "JPEG", quality=98, subsampling=0, **options)

    return save

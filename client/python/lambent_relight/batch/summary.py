"""A batch in one table and one picture: pictures.csv and contact_sheet.png."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial as given
from pathlib import Path
from types import MappingProxyType

from lambent_core.files import whole_file
from PIL import Image, ImageDraw, ImageFont

from lambent_relight.batch.plan import Failure
from lambent_relight.batch.run import Result
from lambent_relight.batch.tiles import TILE, thumbnail

TABLE = "pictures.csv"
SHEET = "contact_sheet.png"
COLUMNS = (
    "picture",
    "state",
    "asset",
    "environment",
    "quality",
    "camera",
    "width",
    "height",
    "seconds",
    "num_samples",
    "mean_standard_error",
    "relative_standard_error",
    "png",
    "exr",
    "code",
    "message",
)
GAP, MARGIN, LABEL_HEIGHT = 6, 14, 18
TILES_IN_A_ROW = 8
ROWS_OF_A_SHEET = 64
_MOST_LIGHTS = 4
_PAPER, _INK, _FAINT, _FAILED = (255, 255, 255), (34, 34, 34), (110, 110, 110), (247, 222, 218)
TileOf = Callable[[Result], Image.Image | None]
"""Returns a picture small, or None where there is none."""


def write_table(path: Path, results: Iterable[Result]) -> None:
    """Write one line for every picture: its name, state, seconds, noise, files, and why it failed."""
    with whole_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        for result in sorted(results, key=lambda each: each.path):
            table.writerow(_line(result))


def _line(result: Result) -> dict[str, object]:
    record, failure = result.record, result.failure
    line: dict[str, object] = {"picture": result.path, "state": result.state}
    if record is not None:
        names = ("asset", "environment", "quality", "camera", "width", "height", "num_samples")
        line |= {name: getattr(record, name) for name in names}
        line |= {
            "seconds": f"{record.seconds:.3f}",
            "mean_standard_error": f"{record.mean_standard_error:.6g}",
            "relative_standard_error": f"{record.relative_standard_error:.6g}",
        }
        line |= {suffix: made.path for suffix, made in record.files.items() if suffix in COLUMNS}
    if failure is not None:
        line |= {"code": failure.code, "message": failure.message}
    return line


def write_sheets(
    folder: Path,
    results: Sequence[Result],
    *,
    title: str,
    lights: Mapping[str, Image.Image] = MappingProxyType({}),
    tile_of: TileOf | None = None,
) -> list[Path]:
    """Write every picture small and with its name into contact_sheet.png, and return the files.

    Pictures are in the order of their names, one group for every folder; failed ones are empty and say why.
    Above a group stand the `lights` of its pictures, by the names of their environments. Above 64 rows there
    are more sheets: contact_sheet_2.png and so on. Pictures are read from `folder`, one at a time, unless
    `tile_of` has them.
    """
    tile_of = tile_of or given(thumbnail, folder)
    rows = list(_rows(sorted(results, key=lambda each: each.path)))
    pages = [rows[start : start + ROWS_OF_A_SHEET] for start in range(0, len(rows), ROWS_OF_A_SHEET)]
    paths = []
    for number, page in enumerate(pages, 1):
        name = SHEET if number == 1 else SHEET.replace(".", f"_{number}.")
        shown_title = title if len(pages) == 1 else f"{title} ({number} of {len(pages)})"
        path = folder / name
        with whole_file(path) as partial:
            _sheet(page, shown_title, lights, tile_of).save(partial, format="PNG")
        paths.append(path)
    return paths


def _rows(results: Sequence[Result]) -> Iterator[tuple[str, list[Result]]]:
    """Yield rows of tiles with the name of their group, which only its first row shows."""
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.path.rpartition("/")[0], []).append(result)
    for name, members in groups.items():
        for start in range(0, len(members), TILES_IN_A_ROW):
            yield (name if start == 0 else ""), members[start : start + TILES_IN_A_ROW]


def _lights_of(members: Sequence[Result], lights: Mapping[str, Image.Image]) -> list[Image.Image]:
    """Return the pictures of the environments that a row shows, each once, as many as fit."""
    names = dict.fromkeys(each.record.environment for each in members if each.record is not None)
    return [lights[name] for name in names if name in lights][:_MOST_LIGHTS]


def _sheet(
    rows: Sequence[tuple[str, list[Result]]],
    title: str,
    lights: Mapping[str, Image.Image],
    tile_of: TileOf,
) -> Image.Image:
    step = TILE + LABEL_HEIGHT + GAP
    columns = max(len(members) for _, members in rows)
    heads = [_lights_of(members, lights) if name else [] for name, members in rows]
    head_heights = [
        max([LABEL_HEIGHT, *(ball.height + GAP for ball in balls)]) if name else 0
        for (name, _), balls in zip(rows, heads, strict=True)
    ]
    height = 2 * MARGIN + LABEL_HEIGHT + step * len(rows) + sum(head_heights)
    width = max(2 * MARGIN + columns * (TILE + GAP) - GAP, 480)
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font, small = ImageFont.load_default(14), ImageFont.load_default(11)
    draw.text((MARGIN, MARGIN), title, _INK, font=font)
    top = MARGIN + LABEL_HEIGHT
    for (name, members), balls, head_height in zip(rows, heads, head_heights, strict=True):
        left = MARGIN
        for ball in balls:
            sheet.paste(ball, (left, top), ball)
            left += ball.width + GAP
        if name:
            draw.text((left, top + head_height - LABEL_HEIGHT + 2), name, _INK, font=small)
        top += head_height
        for index, result in enumerate(members):
            left = MARGIN + index * (TILE + GAP)
            tile = tile_of(result)
            if tile is None:
                draw.rectangle((left, top, left + TILE, top + TILE), fill=_FAILED)
                draw.text((left + 6, top + 6), _wrapped(result.failure), _INK, font=small)
            else:
                sheet.paste(tile, (left + (TILE - tile.width) // 2, top + (TILE - tile.height) // 2))
            label = result.path.rpartition("/")[2]
            draw.text((left, top + TILE + 2), label[:22], _FAINT, font=small)
        top += step
    return sheet


def _wrapped(failure: Failure | None) -> str:
    words = failure.code.replace(".", ".\n").replace("_", "_\n") if failure is not None else "no picture"
    return f"failed:\n{words}" if failure is not None else words

"""A labelled table of pictures in one PNG."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

TILE = 192
GAP = 6
LABEL_HEIGHT = 22
MARGIN = 14
INK, PAPER, FAINT = (34, 34, 34), (255, 255, 255), (110, 110, 110)


def write_contact_sheet(
    path: Path,
    columns: list[str],
    rows: list[tuple[str, list[NDArray[np.floating]]]],
    *,
    title: str,
    note: str = "",
) -> None:
    """Write rows of display pictures [H, W, 3] in [0, 1] (sRGB-encoded), one column name over each.

    Every tile is 192 pixels wide; row names stand below their rows.
    """
    font, small = ImageFont.load_default(14), ImageFont.load_default(12)
    step = TILE + GAP
    heights = [round(TILE * pictures[0].shape[0] / pictures[0].shape[1]) for _, pictures in rows]
    width = 2 * MARGIN + step * len(columns) - GAP
    height = (
        2 * MARGIN + 2 * LABEL_HEIGHT + sum(h + LABEL_HEIGHT for h in heights) + (LABEL_HEIGHT if note else 0)
    )
    sheet = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN, MARGIN), title, INK, font=font)
    top = MARGIN + LABEL_HEIGHT
    for index, name in enumerate(columns):
        draw.text((MARGIN + index * step, top), name, INK, font=small)
    top += LABEL_HEIGHT
    for (name, pictures), tile_height in zip(rows, heights, strict=True):
        for index, picture in enumerate(pictures):
            pixels = np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
            tile = Image.fromarray(pixels).resize((TILE, tile_height), Image.Resampling.BICUBIC)
            sheet.paste(tile, (MARGIN + index * step, top))
        draw.text((MARGIN, top + tile_height + 3), name, FAINT, font=small)
        top += tile_height + LABEL_HEIGHT
    if note:
        draw.text((MARGIN, top), note, FAINT, font=small)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)

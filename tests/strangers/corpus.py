"""One capture for each kind of thing that strangers brought, with its right value in numbers."""

from strangers import rows_formats, rows_layouts, rows_pixels
from strangers.rows import ROWS

PARTS = (rows_layouts, rows_formats, rows_pixels)
"""Importing them fills `ROWS`."""

__all__ = ["PARTS", "ROWS"]

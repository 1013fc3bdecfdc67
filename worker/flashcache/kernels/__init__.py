"""Interpolation in multi-resolution feature grids: one formula, a reference, and faster equal backends."""

"""Interpolation in multi-resolution feature grids: one formula, a reference, faster ones that equal it."""

"""Interpolation in multi-resolution feature grids: one formula, a reference, faster backends that equal it."""

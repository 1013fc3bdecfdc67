"""Encodings of positions (hash grids) and directions (frequencies, integrated harmonics)."""

"""Relighting by Monte Carlo sampling of directions, to a given standard error."""

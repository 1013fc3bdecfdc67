"""Relighting by sampling directions, to a wanted standard error."""
